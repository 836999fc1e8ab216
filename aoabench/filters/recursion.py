"""The role of Kalman filters, whose results smoothers take."""

from __future__ import annotations

from dataclasses import dataclass

from aoabench.filters.belief import Belief
from aoabench.filters.divergence import Filtered, InnovationBound
from aoabench.kernels.loading import Compiled
from aoabench.roles import Estimator, Scenario
from aoabench.types import Batch

Recursion = tuple[Filtered, Belief]


@dataclass(frozen=True)
class KalmanFilter(InnovationBound, Compiled, Estimator):
    """A filter whose belief is a normal distribution of the state."""

    def recursion(self, batch: Batch, scenario: Scenario, whole: bool = False) -> Recursion:
        """Positions, or whole states, with the prior and the motion that the filter assumed."""
        raise NotImplementedError
