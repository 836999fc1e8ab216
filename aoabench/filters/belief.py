"""The belief of a filter: its prior, and its motion model over the steps of a batch."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from aoabench.errors import BadValue
from aoabench.maths.geometry import Array
from aoabench.maths.times import elapsed
from aoabench.roles import Scenario
from aoabench.types import Batch


class Belief(NamedTuple):
    """Prior of a filter before the first step, and its motion model x_k = F x_{k-1} + N(0, Q)."""

    mean: Array  # (R, n)
    covariance: Array  # (n, n)
    F: Array  # (R|1, T|1, n, n)
    Q: Array  # (R|1, T|1, n, n)

    @property
    def size(self) -> int:
        """The number n of the state's components."""
        return int(self.mean.shape[1])

    def of(self, i: int) -> Belief:
        """The belief about one replication, in arrays (1, ...)."""
        F, Q = (A if len(A) == 1 else A[i : i + 1] for A in (self.F, self.Q))
        return Belief(self.mean[i : i + 1], self.covariance, F, Q)

    def at(self, k: int) -> tuple[Array, Array]:
        """F and Q of step k, each (n, n) if it is that of all replications, else (R, n, n)."""
        F, Q = (A[:, min(k, A.shape[1] - 1)] for A in (self.F, self.Q))
        return F[0] if len(F) == 1 else F, Q[0] if len(Q) == 1 else Q


def believed(batch: Batch, scenario: Scenario) -> Belief:
    """Return the prior of the batch, and the scenario's motion over the batch's steps; raises
    BadValue if one is missing, and ValueError for a motion that takes no arrays or for times that
    decrease.
    """
    if scenario.motion is None or batch.prior_mean is None or batch.prior_cov is None:
        raise BadValue("scenario", type(scenario).__name__, "one with a motion model and a prior")
    dt = _intervals(batch, scenario)
    matrices = [np.asarray(A) for A in scenario.motion.matrices(dt)]
    n = batch.prior_mean.shape[1]
    for A in matrices:
        if A.shape[-2:] != (n, n) or not _stretches(A.shape[:-2], np.shape(dt)):
            name = type(scenario.motion).__name__
            wanted = f"F and Q (..., {n}, {n}) for intervals {np.shape(dt)}"
            raise ValueError(f"{name}.matrices must return {wanted}, not an array {A.shape}")
    F, Q = (A.reshape((1,) * (4 - A.ndim) + A.shape) for A in matrices)
    return Belief(batch.prior_mean, batch.prior_cov, F, Q)


def _stretches(shape: tuple[int, ...], to: tuple[int, ...]) -> bool:
    """Whether NumPy stretches an array of the first shape to the second."""
    same = zip(reversed(shape), reversed(to))
    return len(shape) <= len(to) and all(a in (1, b) for a, b in same)


def _intervals(batch: Batch, scenario: Scenario) -> float | Array:
    """The time in s before each step, (R|1, T); one number where all steps have the scenario's dt.

    A replication without times has steps of dt.
    """
    time = batch.time
    if time is None or np.array_equal(time, scenario.dt * np.arange(1.0, time.shape[1] + 1)[None]):
        return scenario.dt
    unknown = np.isnan(time).all(axis=1, keepdims=True)
    if unknown.all():
        return scenario.dt
    return np.where(unknown, scenario.dt, elapsed(time, scenario.start_s))
