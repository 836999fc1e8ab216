"""Anchor layouts as a scenario's YAML gives them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from aoabench.errors import BadValue, check_array
from aoabench.maths.geometry import euler, facing
from aoabench.types import Anchors


@dataclass(frozen=True)
class AnchorLayout:
    """B anchors: `position_m` (B, 3) and `facing` (B, 3), where each anchor's pole (elevation 90
    deg) looks.

    `facing: null` leaves every frame equal to the global one (pole up). `frame_rpy_deg` (roll,
    pitch, yaw) turns all anchor frames by one further rotation G: R_j becomes G R_j.
    """

    position_m: Sequence[Sequence[float]]
    facing: Sequence[Sequence[float]] | None = None
    frame_rpy_deg: Sequence[float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        position = check_array("position_m", self.position_m, (None, 3))
        check_array("frame_rpy_deg", self.frame_rpy_deg, (3,))
        if self.facing is not None:
            direction = check_array("facing", self.facing, (None, 3))
            if len(direction) != len(position):
                raise BadValue(
                    "facing",
                    f"{len(direction)} rows",
                    f"one row per anchor, that is {len(position)}",
                )
            if not np.all(np.linalg.norm(direction, axis=1) > 0):
                raise BadValue("facing", [0, 0, 0], "a direction of length > 0")

    @property
    def known(self) -> Anchors:
        """The anchors (1, 1, B, ...)."""
        position = np.array(self.position_m, dtype=float)
        R = (
            np.broadcast_to(np.eye(3), (len(position), 3, 3))
            if self.facing is None
            else facing(self.facing)
        )
        if any(self.frame_rpy_deg):
            R = euler(np.deg2rad(self.frame_rpy_deg)) @ R
        return Anchors(position, np.array(R))
