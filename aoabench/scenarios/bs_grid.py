"""A mobile at random positions in an area with columns of base stations: one fix at each position
[Le 2021, IV-B].
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from aoabench.errors import UserError
from aoabench.maths.geometry import Array
from aoabench.params import param
from aoabench.roles import Scenario
from aoabench.scenarios.layout import AnchorLayout
from aoabench.scenarios.parameters import dt_param, layout_param, name_param, size_param
from aoabench.types import Anchors

ZONES = ("strip", "disc", "ring", "none")


@dataclass(frozen=True)
class BsGrid(Scenario):
    """Points uniform over the box from 0 to `size_m`, the same in every replication.

    `zone` keeps the points away from the base stations (x_i, y_i): `strip` requires |x - x_i| and
    |y - y_i| of at least `clearance_m`, `disc` a horizontal distance of at least `clearance_m`,
    `none` nothing. `ring` puts each point at a horizontal distance of exactly `clearance_m` from
    one base station, to study the pole. Fixes are independent: no motion and no prior.
    """

    name: str = name_param()
    anchors: AnchorLayout = layout_param()
    positions: int = param(1000, "number of points", least=1, most=1_000_000)
    size_m: tuple[float, float, float] = size_param((1000.0, 1000.0, 20.0))
    zone: str = param(
        "strip",
        "zone around each base station: strip and disc contain no points, the ring all points",
        choices=ZONES,
    )
    clearance_m: float = param(
        20.0,
        "least distance in x and in y (strip), least (disc) or exact (ring) horizontal distance",
        unit="m",
        least=0,
        most=1e6,
    )
    dt: float = dt_param(1.0)
    motion: None = param(None, "none: fixes are independent")
    shares_positions = True  # the positions depend on the seed alone

    @cached_property
    def true_anchors(self) -> Anchors:
        """The true base stations (1, 1, B, ...)."""
        return self.anchors.known

    def truth(self, rng: np.random.Generator) -> Array:
        """Positions (T, 3) m; raises UserError if the zone leaves (almost) no area."""
        size, stations = np.array(self.size_m), self.true_anchors.position[0, 0]
        if self.zone == "ring":
            around = stations[rng.integers(len(stations), size=self.positions)]
            turn = rng.uniform(0, 2 * np.pi, self.positions)
            x, y = (
                around[:, :2] + self.clearance_m * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
            ).T
            return np.stack([x, y, rng.uniform(0, size[2], self.positions)], axis=-1)
        kept, drawn = np.empty((0, 3)), 0
        while len(kept) < self.positions:
            points = size * rng.random((self.positions, 3))
            kept, drawn = (
                np.concatenate([kept, points[self.allowed(points)]]),
                drawn + self.positions,
            )
            if drawn >= 1000 * self.positions:
                raise UserError(
                    f"scenario.clearance_m={self.clearance_m:g}: a {self.zone} of that width "
                    "leaves less than a thousandth of the area; allowed: a smaller clearance_m"
                )
        return kept[: self.positions]

    def allowed(self, points: Array) -> np.ndarray:
        """Mask (N,) of the points (N, 3) m that the zone allows."""
        d = np.abs(points[:, None, :2] - self.true_anchors.position[0, 0, None, :, :2])
        far = {"strip": d.min(axis=-1), "disc": np.hypot(d[..., 0], d[..., 1])}
        return (
            (far[self.zone] >= self.clearance_m).all(axis=1)
            if self.zone in far
            else np.ones(len(points), dtype=bool)
        )
