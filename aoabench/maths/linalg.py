"""Many small systems of equations at once; a singular one gives NaN and no exception."""

from __future__ import annotations

from contextlib import suppress

import numpy as np

from aoabench.maths.geometry import Array

SINGULAR = 1e-12  # least ratio of a pivot to its diagonal element


def solve(A: Array, g: Array) -> Array:
    """A^-1 g, A symmetric (..., 3, 3), g (..., 3), by Cholesky; NaN where a pivot vanishes."""
    d0 = A[..., 0, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        l10, l20 = A[..., 1, 0] / d0, A[..., 2, 0] / d0
        d1 = A[..., 1, 1] - l10 * A[..., 1, 0]
        e = A[..., 2, 1] - l20 * A[..., 1, 0]
        l21 = e / d1
        d2 = A[..., 2, 2] - l20 * A[..., 2, 0] - l21 * e
        y1 = g[..., 1] - l10 * g[..., 0]
        y2 = g[..., 2] - l20 * g[..., 0] - l21 * y1
        z = y2 / d2
        y = y1 / d1 - l21 * z
        x = g[..., 0] / d0 - l10 * y - l20 * z
    sound = (d0 > 0) & (d1 > SINGULAR * A[..., 1, 1]) & (d2 > SINGULAR * A[..., 2, 2])
    return np.where(sound[..., None], np.stack([x, y, z], axis=-1), np.nan)


def cholesky(A: Array) -> Array:
    """Lower factor (R, n, n) of each A (R, n, n); NaN where A is not positive definite.

    numpy.linalg.cholesky raises for the whole stack if a single matrix is not positive definite.
    """
    try:
        return np.asarray(np.linalg.cholesky(A), dtype=float)
    except np.linalg.LinAlgError:
        L = np.full_like(A, np.nan)
        for one, factor in zip(A, L):
            with suppress(np.linalg.LinAlgError):
                factor[:] = np.linalg.cholesky(one)
        return L
