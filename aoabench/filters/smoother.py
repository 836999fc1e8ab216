"""Smoother of Rauch, Tung and Striebel (RTS): the estimate of each step from the measurements of
the whole track.

A Kalman filter gives mean m_k and covariance P_k of each step from the measurements up to it. With
the motion x_{k+1} = F x_k + w, w ~ N(0, Q), and the smoothed mean s_{k+1} and covariance C_{k+1} of
the next step,

    G = P_k F^T (F P_k F^T + Q)^-1
    s_k = m_k + G (s_{k+1} - F m_k)
    C_k = (I - G F) P_k (I - G F)^T + G (C_{k+1} + Q) G^T,

backward from s_T = m_T [Rauch, Tung and Striebel 1965]. C_k is a sum of squares: nothing is
subtracted from a covariance. Where the measurements are linear, it is the exact posterior.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from aoabench.filters.belief import Belief
from aoabench.filters.recursion import GaussianFilter
from aoabench.filters.roots import EPS
from aoabench.kernels.loading import load, prepare
from aoabench.maths.geometry import Array
from aoabench.maths.linalg import cholesky
from aoabench.params import param
from aoabench.roles import Estimator, Noise, Scenario
from aoabench.streams import Streams
from aoabench.types import Batch, Estimates

KERNELS = "kernels.smoother"


@dataclass(frozen=True)
class RTSSmoother(Estimator):
    """RTS smoother after a Kalman filter. Not causal: each fix uses the later measurements too.

    Its fixes have the outcomes and reasons of `filters.divergence`, by the smoothed positions and
    covariances and by the filter's innovations.
    """

    filter: GaussianFilter = param(
        help="Kalman filter of the forward pass",
        kind=GaussianFilter,
        allowed="a Kalman filter, such as aoabench.filters.kalman.EKF",
    )
    causal = False

    @property
    def tile(self) -> int | None:  # type: ignore[override]
        return self.filter.tile

    @property
    def by_replication(self) -> bool:  # type: ignore[override]
        return self.filter.by_replication

    @property
    def heard_only(self) -> bool:  # type: ignore[override]
        return self.filter.heard_only

    @property
    def needs(self) -> frozenset[str]:
        return self.filter.needs

    @property
    def uses(self) -> frozenset[str] | None:  # type: ignore[override]
        return self.filter.uses

    def check(self, scenario: Scenario, noise: Noise) -> None:
        self.filter.check(scenario, noise)

    def prepare(self, say: Callable[[str], None]) -> None:
        self.filter.prepare(say)
        if self.filter.engine == "auto":
            prepare(KERNELS, say, ("backward",))

    def __call__(self, batch: Batch, scenario: Scenario, streams: Streams) -> Estimates:
        """Smoothed positions (R, T, 3) m and covariances (R, T, 3, 3) m^2."""
        filtered, belief = self.filter.recursion(batch, scenario, whole=True)
        x, P = smoothed(filtered.position, filtered.covariance, belief, self.filter.engine)
        position, C = (np.ascontiguousarray(a) for a in (x[..., :3], P[..., :3, :3]))
        found = filtered._replace(position=position, covariance=C)
        return self.filter.outcomes(found, None, batch.layout, belief)

    def trace(self, batch: Batch, scenario: Scenario, streams: Streams) -> dict[str, Array]:
        """The columns of the filter."""
        return self.filter.trace(batch, scenario, streams)


def smoothed(x: Array, P: Array, belief: Belief, engine: str = "auto") -> tuple[Array, Array]:
    """Smoothed states (R, T, n) and covariances (R, T, n, n) from the filtered ones, which are
    overwritten.

    Where the next step is not finite, as after the end of a track, the filtered state remains.
    """
    x, P = np.ascontiguousarray(x), np.ascontiguousarray(P)
    F, Q = np.ascontiguousarray(belief.F), np.ascontiguousarray(belief.Q)
    kernels = load(KERNELS) if engine == "auto" else None
    if kernels is None:
        return backward_pass(x, P, F, Q)
    kernels.backward(np.arange(len(x)), F, Q, x, P)
    return x, P


def backward_pass(x: Array, P: Array, F: Array, Q: Array) -> tuple[Array, Array]:
    """`smoothed` in NumPy; F, Q (R|1, T|1, n, n)."""
    with np.errstate(all="ignore"):
        for k in range(x.shape[1] - 2, -1, -1):
            later, later_cov = x[:, k + 1], P[:, k + 1]
            matrices = at_step(F, k + 1), at_step(Q, k + 1)
            s, C = backward_step(x[:, k], P[:, k], later, later_cov, *matrices)
            known = finite(later, 1) & finite(later_cov, 2)
            x[:, k] = np.where(known[:, None], s, x[:, k])
            P[:, k] = np.where(known[:, None, None], C, P[:, k])
    return x, P


def finite(array: Array, axes: int) -> np.ndarray:
    """Whether all numbers along the last `axes` axes are finite."""
    return np.asarray(np.isfinite(array).all(tuple(range(-axes, 0))))


def at_step(matrix: Array, k: int) -> Array:
    """F or Q (R|1, n, n) of the way to step k, from (R|1, T|1, n, n)."""
    return matrix[:, min(k, matrix.shape[1] - 1)]


def predicted(P: Array, F: Array, Q: Array) -> Array:
    """F P F^T + Q (R, n, n) with an increased diagonal, so that it is positive definite."""
    n = P.shape[-1]
    S = F @ P @ np.swapaxes(F, -1, -2) + Q
    S = 0.5 * (S + np.swapaxes(S, -1, -2))
    S[..., range(n), range(n)] *= 1.0 + 2 * n * n * EPS
    return S


def backward_step(
    m: Array, P: Array, later: Array, later_cov: Array, F: Array, Q: Array
) -> tuple[Array, Array]:
    """Smoothed mean (R, n) and covariance (R, n, n) of a step from its filtered ones, m and P, and
    the smoothed ones of the next step; F, Q (R|1, n, n) lead to the next step.
    """
    L = cholesky(predicted(P, F, Q))
    G = np.linalg.solve(np.swapaxes(L, -1, -2), np.linalg.solve(L, F @ P))
    G = np.swapaxes(G, -1, -2)
    s = m + (G @ (later[..., None] - F @ m[..., None]))[..., 0]
    D = np.eye(P.shape[-1]) - G @ F
    C = D @ P @ np.swapaxes(D, -1, -2) + G @ (later_cov + Q) @ np.swapaxes(G, -1, -2)
    return s, 0.5 * (C + np.swapaxes(C, -1, -2))
