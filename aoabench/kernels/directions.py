"""Directions seen from anchors, their derivatives and innovations, for a tile of replications.

The measurement models of `kernels/small.py`, written out for the Kalman filters. The last axis of
every array has the length TILE.
"""

from __future__ import annotations

import math

import numpy as np

from aoabench.kernels.angles import angle, wrapped
from aoabench.kernels.compile import inlined_ordered
from aoabench.kernels.limits import ROUNDED
from aoabench.kernels.small import AZEL_ADAPTIVE, UNIT_VECTOR

TILE = 64
DEGREES = 180.0 / math.pi
RHO2_FLOOR, NEAREST = 1e-12, 1e-12  # m^2, m: as in the measurement models
SURE = 1.0 - ROUNDED


@inlined_ordered
def seen_from(x, s, R, out):
    """R (x - s) into out (3, TILE)."""
    for i in range(3):
        for r in range(TILE):
            dx, dy, dz = x[0, r] - s[0, r], x[1, r] - s[1, r], x[2, r] - s[2, r]
            out[i, r] = R[i, 0, r] * dx + R[i, 1, r] * dy + R[i, 2, r] * dz


@inlined_ordered
def direction(kind, p, out):
    """Unit vector, or azimuth and elevation, of p (3, TILE) in the anchor's frame, into out."""
    if kind == UNIT_VECTOR:
        for r in range(TILE):
            d = max(math.sqrt(p[0, r] * p[0, r] + p[1, r] * p[1, r] + p[2, r] * p[2, r]), NEAREST)
            out[0, r], out[1, r], out[2, r] = p[0, r] / d, p[1, r] / d, p[2, r] / d
    else:
        for r in range(TILE):
            u, v, w = p[0, r], p[1, r], p[2, r]
            rho2 = u * u + v * v
            rho = math.sqrt(rho2)
            out[0, r] = angle(v, u, rho)
            out[1, r] = angle(w, rho, math.sqrt(rho2 + w * w))


@inlined_ordered
def slopes(kind, p, c, R, out):
    """Derivatives of `direction` by the position, row after row, into out (3, 3, TILE)."""
    if kind == UNIT_VECTOR:  # (I - c c^T) R / distance
        for q in range(3):
            for r in range(TILE):
                d = max(
                    math.sqrt(p[0, r] * p[0, r] + p[1, r] * p[1, r] + p[2, r] * p[2, r]), NEAREST
                )
                e = c[0, r] * R[0, q, r] + c[1, r] * R[1, q, r] + c[2, r] * R[2, q, r]
                out[0, q, r] = (R[0, q, r] - c[0, r] * e) / d
                out[1, q, r] = (R[1, q, r] - c[1, r] * e) / d
                out[2, q, r] = (R[2, q, r] - c[2, r] * e) / d
    else:
        for q in range(3):
            for r in range(TILE):
                u, v, w = p[0, r], p[1, r], p[2, r]
                rho2 = max(u * u + v * v, RHO2_FLOOR)
                rho, r2 = math.sqrt(rho2), rho2 + w * w
                along = u * R[0, q, r] + v * R[1, q, r]
                out[0, q, r] = (u * R[1, q, r] - v * R[0, q, r]) / rho2
                out[1, q, r] = (rho * R[2, q, r] - w / rho * along) / r2


@inlined_ordered
def variance(kind, l, elevation, nominal, table, out):
    """Variances of component l at the expected elevations (TILE,) rad, into out (TILE,)."""
    if kind == AZEL_ADAPTIVE:
        for r in range(TILE):
            degree = np.rint(elevation[r] * DEGREES + 90.0)
            out[r] = table[int(degree) if 0.0 <= degree <= 180.0 else 90, l]
    else:
        for r in range(TILE):
            out[r] = nominal[r]


@inlined_ordered
def innovation(kind, l, y, expected, var, v, W):
    """y - expected, wrapped, and 1 / variance; both 0 where y is not measured (NaN)."""
    for r in range(TILE):
        d = y[r] - expected[r]
        if kind != UNIT_VECTOR and l == 0:
            d = wrapped(d)
        v[r] = 0.0 if math.isnan(y[r]) else d
        W[r] = 0.0 if math.isnan(y[r]) else 1.0 / var[r]


@inlined_ordered
def squared_length(p, out):
    """Squares of the lengths of p (3, TILE) into out (TILE,)."""
    for r in range(TILE):
        out[r] = p[0, r] * p[0, r] + p[1, r] * p[1, r] + p[2, r] * p[2, r]


@inlined_ordered
def hide(distance2, least, y):
    """NaN into y (TILE,) where the squared distance is below the least at which an EKF can use the
    anchor.
    """
    for r in range(TILE):
        y[r] = math.nan if distance2[r] < least[r] else y[r]


@inlined_ordered
def weigh(v, W, out):
    """Add the squares of the innovations v, divided by their variances, to `out`."""
    for r in range(TILE):
        out[r] += SURE * W[r] * v[r] * v[r]


@inlined_ordered
def deviation(kind, l, a, b, out):
    """a - b of component l, wrapped."""
    for r in range(TILE):
        d = a[r] - b[r]
        out[r] = wrapped(d) if kind != UNIT_VECTOR and l == 0 else d
