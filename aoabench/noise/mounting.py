"""Anchors whose true orientation differs from the known one."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass, replace
from typing import Any

import numpy as np

from aoabench.maths.geometry import euler
from aoabench.params import param
from aoabench.roles import Noise, Scenario
from aoabench.types import Anchors


def _mounting(axis: str) -> Any:
    help = f"standard deviation of the error of each anchor's known rotation about its {axis} axis"
    return param(0.0, help, unit="deg", least=0, most=180)


@dataclass(frozen=True)
class MountedNoise(Noise):
    """A noise with errors of the anchors' known rotations.

    The errors are drawn once per replication for each anchor: yaw about its z axis, then pitch
    about its y axis, then roll about its x axis.
    """

    _: KW_ONLY
    mounting_yaw_deg: float = _mounting("z")
    mounting_pitch_deg: float = _mounting("y")
    mounting_roll_deg: float = _mounting("x")

    def known_anchors(self, rng: np.random.Generator, scenario: Scenario) -> Anchors:
        """The true anchors (1, T|1, B, ...) with this replication's errors of the rotations."""
        return self.mounted(rng, scenario.true_anchors)

    def mounted(self, rng: np.random.Generator, anchors: Anchors) -> Anchors:
        """The anchors with errors of their rotations; no draws if all deviations are 0."""
        deviation = np.deg2rad(
            [self.mounting_roll_deg, self.mounting_pitch_deg, self.mounting_yaw_deg]
        )
        if not deviation.any():
            return anchors
        angles = deviation * rng.standard_normal((anchors.count, 3))
        turns = np.stack([euler(angle) for angle in angles])
        return replace(anchors, rotation=np.swapaxes(turns, -1, -2) @ anchors.rotation)
