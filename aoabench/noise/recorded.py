"""Measurements that a scenario brings along: nothing is drawn."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from aoabench.maths.geometry import Array
from aoabench.types import Measurements


@dataclass(frozen=True)
class Recorded:
    """The scenario's own recording; takes the place of the noise that a run names where the
    scenario has one.
    """

    def sample(self, rng: np.random.Generator, scenario: Any, truth: Array) -> Measurements:
        """The recorded measurements (T, B)."""
        measured: Measurements = scenario.recorded
        return measured
