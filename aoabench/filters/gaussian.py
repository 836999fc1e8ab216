"""Normal distributions of a state, as mean and square root of the covariance."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from aoabench.filters.roots import absorb, covariance, near
from aoabench.maths.geometry import Array
from aoabench.types import Anchors


class Gaussian(NamedTuple):
    """N(mean, root root^T) of each replication.

    mean (R, n); root (R, n, k) of the covariance: of a predicted state it is the lower Cholesky
    factor (R, n, n). nis (R,): the normalised innovation squared of the measurements that led to
    this distribution, 0 before the first.
    """

    mean: Array
    root: Array
    nis: Array | float = 0.0

    @property
    def covariance(self) -> Array:
        """The covariance (R, n, n), symmetric and positive definite despite rounding."""
        return covariance(self.root)

    def given(self, v: Array, H: Array, r: Array) -> Gaussian:
        """Return the distribution of the state x given v = H (x - mean) + e, e ~ N(0, diag(r)).

        v (R, m), NaN where nothing was measured; H (R, m, n); variances r (R, m) >= 0. This is the
        update of a Kalman filter by the innovations v.
        """
        return self.given_root(v, np.swapaxes(H @ self.root, -1, -2), r)

    def given_root(self, v: Array, f: Array, r: Array) -> Gaussian:
        """Return the distribution of the state x = mean + root z given v = f^T z + e, z ~ N(0, I),
        e ~ N(0, diag(r)); f (R, k, m), the others as for `given`.
        """
        return Gaussian(*absorb(self.mean, self.root, f, v, r))

    def near(self, anchors: Anchors) -> np.ndarray:
        """Whether an anchor (R, B) of one step is nearer to the mean than 0.001 standard deviations
        of the position: its direction has no meaningful derivative there.
        """
        return near(self.mean, self.root, anchors)
