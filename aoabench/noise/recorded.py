"""Measurements recorded in the scenario; nothing is drawn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aoabench.errors import BadValue
from aoabench.maths.geometry import Array
from aoabench.roles import Noise, Scenario
from aoabench.types import Measurements


@dataclass(frozen=True)
class Recorded(Noise):
    """The scenario's own recording; replaces the noise of a run if the scenario has a recording."""

    def sample(self, rng: np.random.Generator, scenario: Scenario, truth: Array) -> Measurements:
        """The recorded measurements (F, B) of all tracks."""
        tracks = scenario.tracks
        if tracks is None:
            raise BadValue("noise", "recorded", "another noise, or a scenario with a recording")
        return tracks.measured

    def offers(self) -> frozenset[str]:
        """The empty set, because the scenario offers its measurements."""
        return frozenset()
