"""Losses of robust likelihoods: what a deviation costs, and the weight it leaves an angle."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from aoabench.kernels.robust_limits import STEEP, TINY
from aoabench.maths.geometry import Array

NORMAL, STUDENT, HUBER, TRUNCATED = range(4)


class Loss(NamedTuple):
    """rho(s) of a squared deviation s, and its derivative, the weight.

    normal      s
    student     (k + 1) log(1 + s / k)                       k degrees of freedom
    huber       s up to k^2, then 2 k sqrt(s) - k^2
    truncated   s up to k^2 m / (m + 1), k^2 from k^2 (m + 1) / m, between them
                2 k sqrt(s m (m + 1)) - m (k^2 + s)          [Yang 2020, (10)]

    m is the steepness of the truncated loss, which the others ignore.
    """

    kind: int
    k: float

    def of(self, s: Array, m: Array | float = STEEP) -> Array:
        """rho(s) (...) of squared deviations (...)."""
        k = self.k
        if self.kind == STUDENT:
            return (k + 1.0) * np.log1p(s / k)
        if self.kind == HUBER:
            return np.where(s <= k * k, s, 2.0 * k * np.sqrt(s) - k * k)
        if self.kind == TRUNCATED:
            between = 2.0 * k * np.sqrt(s * m * (m + 1.0)) - m * (k * k + s)
            above = s >= k * k * (m + 1.0) / m
            return np.where(s <= k * k * m / (m + 1.0), s, np.where(above, k * k, between))
        return s

    def weight(self, s: Array, m: Array | float = STEEP) -> Array:
        """d rho / ds (...) at squared deviations (...); at most 1, but (k + 1) / k for student."""
        k = self.k
        if self.kind == STUDENT:
            return (k + 1.0) / (k + s)
        root = np.sqrt(np.maximum(s, TINY))
        if self.kind == HUBER:
            return np.minimum(1.0, k / root)
        if self.kind == TRUNCATED:
            return np.clip(k * np.sqrt(m * (m + 1.0)) / root - m, 0.0, 1.0)
        return np.ones_like(s)

    @property
    def spread(self) -> float:
        """The variance of the maximum likelihood estimate under the loss's own model, times the
        mean of the weighted normal matrix: (k + 3) / (k + 1) for student's distribution.
        """
        return (self.k + 3.0) / (self.k + 1.0) if self.kind == STUDENT else 1.0
