"""Constants and small functions that several kernels share: codes, linear equations, sets."""

from __future__ import annotations

from aoabench.kernels.compile import inlined
from aoabench.types import Outcome, Reason

OK, REJECTED, OSCILLATED, DIVERGED, FAILED = (
    int(Outcome[name]) for name in ("OK", "REJECTED", "OSCILLATED", "DIVERGED", "FAILED")
)
NONE, NO_MEASUREMENT, TOO_FEW_ANCHORS, ONE_PLACE, UNDETERMINED = (
    int(Reason[name])
    for name in ("NONE", "NO_MEASUREMENT", "TOO_FEW_ANCHORS", "ONE_PLACE", "UNDETERMINED")
)
BEHIND, TOO_FAR, NO_CONVERGENCE, NO_DESCENT, NO_AGREEMENT = (
    int(Reason[name])
    for name in ("BEHIND", "TOO_FAR", "NO_CONVERGENCE", "NO_DESCENT", "NO_AGREEMENT")
)
UNIT_VECTOR, AZEL, AZEL_ADAPTIVE = range(3)  # measurement models, as in filters.compiled
SINGULAR = 64 * 2.0**-52  # as in maths.linalg: of the smallest eigenvalue relative to the trace


@inlined
def solve(a00, a10, a11, a20, a21, a22, g0, g1, g2):
    """A^-1 g by Cholesky, and whether A is positive definite beyond rounding, by the rule of
    maths.linalg.
    """
    l10, l20 = a10 / a00, a20 / a00
    d1 = a11 - l10 * a10
    e = a21 - l20 * a10
    l21 = e / d1
    d2 = a22 - l20 * a20 - l21 * e
    y1 = g1 - l10 * g0
    z = (g2 - l20 * g0 - l21 * y1) / d2
    y = y1 / d1 - l21 * z
    x = g0 / a00 - l10 * y - l20 * z
    e1 = a00 + a11 + a22
    e2 = (a00 * a11 - a10 * a10) + (a00 * a22 - a20 * a20) + (a11 * a22 - a21 * a21)
    whole = a00 * d1 * d2 > SINGULAR * e1 * e2
    return x, y, z, whole & (a00 > 0.0) & (d1 > 0.0) & (d2 > 0.0)


@inlined
def inverse(a00, a10, a11, a20, a21, a22):
    """The elements 00, 10, 11, 20, 21, 22 of A^-1 for a positive definite A."""
    l10, l20 = a10 / a00, a20 / a00
    d1 = a11 - l10 * a10
    e = a21 - l20 * a10
    l21 = e / d1
    i0, i1, i2 = 1.0 / a00, 1.0 / d1, 1.0 / (a22 - l20 * a20 - l21 * e)
    m20 = l10 * l21 - l20
    return (
        i0 + l10 * l10 * i1 + m20 * m20 * i2,
        -l10 * i1 - m20 * l21 * i2,
        i1 + l21 * l21 * i2,
        m20 * i2,
        -l21 * i2,
        i2,
    )


@inlined
def has(M, i, n):
    """Whether the set M contains the i-th of n anchors."""
    return (M >> (n - 1 - i)) & 1 == 1


@inlined
def ascending(x, m):
    """Sort the first m numbers of x."""
    for i in range(1, m):
        value, k = x[i], i
        while k > 0 and x[k - 1] > value:
            x[k] = x[k - 1]
            k -= 1
        x[k] = value
