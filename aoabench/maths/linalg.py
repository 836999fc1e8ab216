"""Many small systems of equations at once; a singular one gives NaN and no exception."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from aoabench.maths.geometry import Array

EPS = float(np.finfo(float).eps)
SINGULAR = 64 * EPS  # of the smallest eigenvalue relative to the trace: it is rounding error below
ONE_PLACE = 1e-12  # of squared distances relative to the squared distances from the origin


_CLEARLY = 1.001  # factor on a limit beyond which rounding does not matter
BLOCK = 4096  # matrices at once, few enough for the processor's cache


class _Factors(NamedTuple):
    """A = L D L^T with a unit lower L, and whether A is certainly positive definite."""

    l10: Array
    l20: Array
    l21: Array
    d0: Array
    d1: Array
    d2: Array
    sound: np.ndarray


def _factors(A: Array, least: float = SINGULAR) -> _Factors:
    """Factors of each symmetric A (..., 3, 3).

    With eigenvalues p <= q <= r, the invariants e1 = p + q + r, e2 = p q + p r + q r and e3 = p q r
    give e3 / e2 between p / 3 and p. A is sound beyond e3 = least e1 e2, so that p > least r. This
    rule does not depend on the axes; a pivot's rounding error does.
    """
    a00, a10, a11 = A[..., 0, 0], A[..., 1, 0], A[..., 1, 1]
    a20, a21, a22 = A[..., 2, 0], A[..., 2, 1], A[..., 2, 2]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        l10, l20 = a10 / a00, a20 / a00
        d1 = a11 - l10 * a10
        e = a21 - l20 * a10
        l21 = e / d1
        d2 = a22 - l20 * a20 - l21 * e
        e1 = a00 + a11 + a22
        e2 = (a00 * a11 - a10 * a10) + (a00 * a22 - a20 * a20) + (a11 * a22 - a21 * a21)
        whole = a00 * d1 * d2 > least * e1 * e2
    return _Factors(l10, l20, l21, a00, d1, d2, whole & (a00 > 0) & (d1 > 0) & (d2 > 0))


def blocks(shape: Sequence[int]) -> Iterator[slice]:
    """Parts of the first axis of an array of matrices (*shape, n, n), each with up to 4 BLOCK
    matrices or with one index: elementwise operations on a part stay in the processor's cache.
    """
    some = max(4 * BLOCK // max(math.prod(shape[1:]), 1), 1)
    return (slice(first, first + some) for first in range(0, shape[0], some))


def solve(A: Array, g: Array) -> Array:
    """A^-1 g (..., 3) of symmetric A (..., 3, 3) and g (..., 3), by Cholesky; NaN where A is not
    positive definite.
    """
    f = _factors(A)
    with np.errstate(divide="ignore", invalid="ignore"):
        y1 = g[..., 1] - f.l10 * g[..., 0]
        y2 = g[..., 2] - f.l20 * g[..., 0] - f.l21 * y1
        z = y2 / f.d2
        y = y1 / f.d1 - f.l21 * z
        x = g[..., 0] / f.d0 - f.l10 * y - f.l20 * z
    return np.where(f.sound[..., None], np.stack([x, y, z], axis=-1), np.nan)


def quadratic(A: Array, g: Array, least: float) -> Array:
    """g^T A^-1 g (N,) of symmetric A (N, 3, 3) and g (N, 3), by Cholesky; NaN where A is not finite
    or its smallest eigenvalue is not above `least` times the largest.
    """
    found = np.empty(len(A))
    for start in range(0, len(A), BLOCK):
        some = slice(start, start + BLOCK)
        found[some] = _quadratic(A[some], g[some], least)
    return found


def _quadratic(A: Array, g: Array, least: float) -> Array:
    f = _factors(A, _CLEARLY * least)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        sound = f.sound & np.isfinite(A[:, 0, 1] + A[:, 0, 2] + A[:, 1, 2])
        y1 = g[:, 1] - f.l10 * g[:, 0]
        y2 = g[:, 2] - f.l20 * g[:, 0] - f.l21 * y1
        value = g[:, 0] * g[:, 0] / f.d0 + y1 * y1 / f.d1 + y2 * y2 / f.d2
    if not sound.all():
        doubtful = np.flatnonzero(~sound)
        sound[doubtful] = _exceeds(A[doubtful], least)
    return np.where(sound, value, np.nan)


def _exceeds(A: Array, least: float) -> np.ndarray:
    """Whether each symmetric A (K, 3, 3) is finite and its smallest eigenvalue exceeds `least`
    times the largest.
    """
    finite = np.asarray(np.isfinite(A).all((-1, -2)))
    spread = np.linalg.eigvalsh(np.where(finite[:, None, None], A, 0.0))
    return np.asarray(spread[:, 0] > least * spread[:, -1])


def inverse(A: Array) -> Array:
    """A^-1 (..., 3, 3) of symmetric A (..., 3, 3), symmetric; NaN where A is not positive
    definite.
    """
    f = _factors(A)
    found = np.empty(A.shape)
    with np.errstate(divide="ignore", invalid="ignore"):
        m20 = f.l10 * f.l21 - f.l20
        i0, i1, i2 = (np.where(f.sound, 1.0 / d, np.nan) for d in (f.d0, f.d1, f.d2))
        found[..., 0, 0] = i0 + f.l10 * f.l10 * i1 + m20 * m20 * i2
        found[..., 1, 0] = found[..., 0, 1] = -f.l10 * i1 - m20 * f.l21 * i2
        found[..., 1, 1] = i1 + f.l21 * f.l21 * i2
        found[..., 2, 0] = found[..., 0, 2] = m20 * i2
        found[..., 2, 1] = found[..., 1, 2] = -f.l21 * i2
        found[..., 2, 2] = i2
    return found


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
