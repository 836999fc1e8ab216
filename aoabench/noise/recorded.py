"""Measurements that a scenario brings along: nothing is drawn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aoabench.errors import BadValue
from aoabench.maths.geometry import Array
from aoabench.roles import Noise, Scenario
from aoabench.types import Measurements


@dataclass(frozen=True)
class Recorded(Noise):
    """The scenario's own recording; takes the place of the noise that a run names where the
    scenario has one.
    """

    def sample(self, rng: np.random.Generator, scenario: Scenario, truth: Array) -> Measurements:
        """The recorded measurements (T, B)."""
        if scenario.recorded is None:
            raise BadValue("noise", "recorded", "a scenario that has a recording")
        return scenario.recorded

    def offers(self) -> frozenset[str]:
        """Nothing of its own: the scenario says what was measured."""
        return frozenset()
