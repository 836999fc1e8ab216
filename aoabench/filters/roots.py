"""Covariances as square roots, P = B B^T: symmetric and positive definite despite rounding.

A predicted covariance is a sum of squares with a Cholesky factor; a measurement updates the factor
in Potter's form. Nothing is subtracted from a covariance. When a covariance is formed, its diagonal
is increased by n (n + k) eps. This exceeds the rounding errors of the sums of k terms and of the
Cholesky factor (both are bounded by multiples of sqrt(P_ii P_jj) [Higham 2002, Theorems 10.5,
10.7]).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from aoabench.kernels.limits import NEAREST, ROUNDED
from aoabench.maths.geometry import Array
from aoabench.maths.linalg import cholesky
from aoabench.types import Anchors

EPS = float(np.finfo(float).eps)
INDEFINITE = -1e-9  # eigenvalue of a correlation matrix below which it is not rounding error


def prior_root(P: Array) -> Array:
    """Lower factor B (n, n), read-only, of a positive semidefinite P = B B^T; NaN for any other
    P.
    """
    P = np.ascontiguousarray(P, dtype=float)
    return _prior_root(P.tobytes(), len(P))


@lru_cache(maxsize=32)
def _prior_root(stored: bytes, n: int) -> Array:
    root = _factor(np.frombuffer(stored).reshape(n, n))
    root.flags.writeable = False
    return root


def process_roots(Q: Array) -> Array:
    """Lower factors (..., n, n) of positive definite Q (..., n, n), and 0 where Q is 0, in a step
    that takes no time.
    """
    roots, some = np.zeros(Q.shape), Q.any(axis=(-2, -1))
    roots[some] = np.linalg.cholesky(Q[some])
    return roots


def _factor(P: Array) -> Array:
    """Lower factor (n, n) of P (n, n), as for `prior_root`."""
    if not np.isfinite(P).all():
        return np.full_like(P, np.nan)
    diagonal = np.diag(P)
    scale = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    values, vectors = np.linalg.eigh(P / np.outer(scale, scale))
    with np.errstate(invalid="ignore"):
        root = np.sqrt(np.where(values > INDEFINITE, np.maximum(values, 0.0), np.nan))
    return np.linalg.qr((scale[:, None] * vectors * root).T)[1].T


def covariance(B: Array) -> Array:
    """P (..., n, n) of a factor B (..., n, k)."""
    n, k = B.shape[-2:]
    P = B @ np.swapaxes(B, -1, -2)
    P = 0.5 * (P + np.swapaxes(P, -1, -2))
    P[..., range(n), range(n)] *= 1.0 + n * (n + k) * EPS
    return P


def moved(x: Array, F: Array) -> Array:
    """F x (R, n) of states x (R, n) and F (n, n) or (R, n, n)."""
    return x @ F.T if F.ndim == 2 else np.einsum("rij,rj->ri", F, x)


def predicted(B: Array, F: Array, Q: Array) -> Array:
    """A lower factor (..., n, n) of F P F^T + Q from a factor B (..., n, k) of P, and F and Q
    (n, n) or (..., n, n).
    """
    n, k = B.shape[-2:]
    FB = F @ B
    P = FB @ np.swapaxes(FB, -1, -2) + Q
    P[..., range(n), range(n)] *= 1.0 + n * (n + k) * EPS
    return cholesky(P)


def absorb(x: Array, B: Array, f: Array, v: Array, r: Array) -> tuple[Array, Array, Array]:
    """Mean (R, n) and factor (R, n, k) of x + B z, z ~ N(0, I), given v = f^T z + e, e ~ N(0, r),
    and the normalised innovation squared (R,).

    x (R, n) and B (R, n, k) are mean and factor before the m measurements v; f (R, k, m), v and r
    (R, m), r >= 0; a measurement whose v is NaN is left out. The measurements are processed one
    after the other in Potter's form: with s = r + f^T f, x += B f v / s and
    B -= B f f^T / (s + sqrt(r s)). Each step also replaces v and f of the later measurements by
    their innovations and derivatives at the new x and B, so that the sum of v^2 / s is
    v^T (diag(r) + f^T f)^-1 v. It is returned without ROUNDED times the sum of v^2 / r.
    """
    m, missing = v.shape[1], np.isnan(v)
    f, r = np.where(missing[:, None], 0.0, f), np.where(missing, 1.0, r).T
    t = np.concatenate([np.where(missing, 0.0, -v), x], axis=1)
    E = np.concatenate([np.swapaxes(f, -1, -2), B], axis=1)
    t, E = np.ascontiguousarray(t.T), np.ascontiguousarray(E.transpose(1, 2, 0))  # fastest layout
    nominal = np.where(r > 0, r, np.inf)  # a component without an error of its own rounds nothing
    rounded, S = ROUNDED * (t[:m] ** 2 / nominal).sum(0), np.empty_like(r)
    for j in range(m):
        g, rest = E[j], slice(j + 1, None)
        S[j] = s = r[j] + (g * g).sum(0)
        w = np.einsum("ikr,kr->ir", E[rest], g)
        t[rest] -= w * (t[j] / s)
        E[rest] -= w[:, None] * (g / (s + np.sqrt(r[j] * s)))
    return t[m:].T, E[m:].transpose(2, 0, 1), (t[:m] ** 2 / S).sum(0) - rounded


def near(x: Array, B: Array, anchors: Anchors) -> np.ndarray:
    """Whether an EKF skips an anchor (R, B): it is too near to the predicted position for a
    derivative of its direction.

    x (R, n) and B (R, n, k) are the predicted mean and a factor of its covariance; anchors are
    those of one step. The distance is below NEAREST times the standard deviation of the position.
    """
    apart, root = x[:, None, :3] - anchors.frames[0], B[:, :3]
    variance = np.einsum("rik,rik->r", root, root)
    return np.asarray(np.einsum("rbi,rbi->rb", apart, apart) < NEAREST**2 * variance[:, None])
