"""A node that sends packets at reference points of a room; one fix per packet [Boquet 2024, 6.4].

A replication is a measurement campaign.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from aoabench.errors import BadValue, check_array, check_number
from aoabench.maths.geometry import Array
from aoabench.params import param
from aoabench.roles import Scenario
from aoabench.scenarios.layout import AnchorLayout
from aoabench.scenarios.parameters import dt_param, layout_param, name_param, size_param
from aoabench.types import Anchors


@dataclass(frozen=True)
class Room(Scenario):
    """A box from 0 to `size_m` with reference points, each visited for some packets.

    A replication is one campaign: all packets of the first point, then of the second, and so on.
    The scenario has no motion and no prior. Estimators know the height and the room's sides.
    """

    name: str = name_param()
    anchors: AnchorLayout = layout_param()
    points_m: Sequence[Sequence[float]] = param(
        help="reference points, a row x, y for each", unit="m", shape=(None, 2)
    )
    size_m: tuple[float, float, float] = size_param((7.2, 8.5, 3.0))
    height_m: float = param(
        1.0, "height of the node above the floor, which estimators know", unit="m", least=0
    )
    packets: int = param(
        100, "number of packets at each point in a replication", least=1, most=1_000_000
    )
    days: int = param(
        1, "number of days; a point's packets are spread over them evenly and in order", least=1
    )
    dt: float = dt_param(0.1)
    motion: None = param(None, "none: fixes are independent")
    shares_positions = True

    def __post_init__(self) -> None:
        super().__post_init__()
        points = check_array("points_m", self.points_m, (None, 2))
        for i in np.flatnonzero(((points < 0) | (points > self.size_m[:2])).any(axis=1)):
            raise BadValue(
                f"points_m[{i}]",
                points[i].tolist(),
                f"a point [x, y] inside the room of {list(self.size_m)} m",
            )
        check_number("height_m", self.height_m, least=0, most=float(self.size_m[2]))
        check_number("days", self.days, least=1, most=self.packets, integer=True)

    @cached_property
    def true_anchors(self) -> Anchors:
        """The true anchors (1, 1, B, ...)."""
        return self.anchors.known

    @property
    def bounds_m(self) -> Array:
        """Lower and upper corner (2, 2) m of the node's area."""
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
