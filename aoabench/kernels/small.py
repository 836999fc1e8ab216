"""Constants and small functions that several kernels share: codes, linear equations, sets."""

from __future__ import annotations

from aoabench.kernels.compile import inlined
from aoabench.types import Outcome

OK, REJECTED, OSCILLATED, DIVERGED, FAILED = (
    int(Outcome[name]) for name in ("OK", "REJECTED", "OSCILLATED", "DIVERGED", "FAILED")
)
UNIT_VECTOR, AZEL, AZEL_ADAPTIVE = range(3)  # measurement models, as in filters.compiled
SINGULAR = 1e-12  # least ratio of a pivot to its diagonal element


@inlined
def solve(a00, a10, a11, a20, a21, a22, g0, g1, g2):
    """A^-1 g by Cholesky, A symmetric (3, 3), and whether A is positive definite."""
    l10, l20 = a10 / a00, a20 / a00
    d1 = a11 - l10 * a10
    e = a21 - l20 * a10
    l21 = e / d1
    d2 = a22 - l20 * a20 - l21 * e
    y1 = g1 - l10 * g0
    z = (g2 - l20 * g0 - l21 * y1) / d2
    y = y1 / d1 - l21 * z
    x = g0 / a00 - l10 * y - l20 * z
    return x, y, z, (a00 > 0.0) & (d1 > SINGULAR * a11) & (d2 > SINGULAR * a22)


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
