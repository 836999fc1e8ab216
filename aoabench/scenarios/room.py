"""A room at whose reference points a node sends packets: one fix for each packet [Boquet 2024,
6.4].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from aoabench.errors import UserError, check_array, check_number
from aoabench.maths.geometry import Array
from aoabench.roles import Scenario
from aoabench.scenarios.layout import AnchorLayout
from aoabench.types import Anchors


@dataclass(frozen=True)
class Room(Scenario):
    """A box from 0 to `size_m` with `points_m` (N, 2), each visited for `packets` packets,
    `height_m` above the floor.

    The packets of a point are spread evenly over `days` days, in order. A replication is one
    campaign: every packet of every point, point by point. There is no motion and no prior;
    estimators know the height and the room's sides.
    """

    name: str
    anchors: AnchorLayout
    points_m: Sequence[Sequence[float]]
    size_m: tuple[float, float, float] = (7.2, 8.5, 3.0)
    height_m: float = 1.0
    packets: int = 100
    days: int = 1
    dt: float = 0.1
    motion: None = None
    shares_positions = True

    def __post_init__(self) -> None:
        size = check_array("size_m", self.size_m, (3,))
        if not np.all(size > 0):
            raise UserError(f"size_m={list(self.size_m)}: allowed: three numbers > 0")
        points = check_array("points_m", self.points_m, (None, 2))
        for i in np.flatnonzero(((points < 0) | (points > size[:2])).any(axis=1)):
            raise UserError(
                f"points_m[{i}]={points[i].tolist()}: "
                f"allowed: points in the room, {list(self.size_m)} m"
            )
        check_number("height_m", self.height_m, least=0, most=float(size[2]))
        check_number("packets", self.packets, least=1, most=1_000_000, integer=True)
        check_number("days", self.days, least=1, most=self.packets, integer=True)
        check_number("dt", self.dt, above=0)

    @cached_property
    def true_anchors(self) -> Anchors:
        """The anchors as they are."""
        return self.anchors.known

    @property
    def bounds_m(self) -> Array:
        """Lower and upper corner (2, 2) m of where the node can be."""
        return np.array([[0.0, 0.0], self.size_m[:2]])

    @property
    def known_height_m(self) -> float:
        """The height of the node above the floor."""
        return self.height_m

    def day_of(self, steps: int) -> np.ndarray:
        """The number (T,) of the day that each packet belongs to, from 0."""
        return np.tile(np.arange(self.packets) * self.days // self.packets, len(self.points_m))

    def truth(self, rng: np.random.Generator) -> Array:
        """Positions (T, 3) m."""
        points = np.repeat(np.array(self.points_m, dtype=float), self.packets, axis=0)
        return np.concatenate([points, np.full((len(points), 1), self.height_m)], axis=1)
