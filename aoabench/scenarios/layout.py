"""Anchor layouts in a scenario's YAML."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from aoabench.errors import BadValue, check_array
from aoabench.maths.geometry import euler, facing
from aoabench.params import CheckedParams, param
from aoabench.types import Anchors


@dataclass(frozen=True)
class AnchorLayout(CheckedParams):
    """B anchors; `frame_rpy_deg` is a rotation G of all anchor frames: R_j becomes G R_j."""

    position_m: Sequence[Sequence[float]] = param(
        help="positions, a row for each anchor", unit="m", shape=(None, 3)
    )
    facing: Sequence[Sequence[float]] | None = param(
        None,
        "direction of the pole (elevation 90 deg), a row for each anchor; null: up, "
        "with the axes of the global frame",
        shape=(None, 3),
    )
    frame_rpy_deg: Sequence[float] = param(
        (0.0, 0.0, 0.0),
        "roll, pitch and yaw of one further rotation of all anchor frames",
        unit="deg",
        shape=(3,),
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.facing is not None:
            direction = check_array("facing", self.facing, (None, 3))
            if len(direction) != len(self.position_m):
                raise BadValue(
                    "facing",
                    f"{len(direction)} rows",
                    f"one row per anchor: {len(self.position_m)} rows",
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
