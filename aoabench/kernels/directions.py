"""Measured and expected directions, and what they tell about the position, for a tile of
replications.

The measurement models of `kernels/small.py`, written out for the Kalman filters. The last axis of
every array has the length TILE. Measured components are NaN, and their precisions 0, where nothing
is measured.
"""

from __future__ import annotations

import math

import numpy as np

from aoabench.kernels.angles import direction_angle, sine_cosine, wrapped
from aoabench.kernels.compile import inlined_ordered
from aoabench.kernels.limits import ROUNDED
from aoabench.kernels.small import UNIT_VECTOR

TILE = 64
DEGREES = 180.0 / math.pi
# as in the measurement models: m, m, rad^2 and the largest concentration
RHO_FLOOR, NEAREST, LEAST_VARIANCE, KAPPA_MOST = 1e-6, 1e-12, 1e-32, 1e15
SURE = 1.0 - ROUNDED


# numba compiles a loop in a tenth of the time that it takes for an assignment to a part of an array


@inlined_ordered
def put(value, out):
    """Put a number into every place of out (TILE,)."""
    for r in range(TILE):
        out[r] = value


@inlined_ordered
def copy(row, out):
    """Copy row (TILE,) into out (TILE,)."""
    for r in range(TILE):
        out[r] = row[r]


# --- what is measured -----------------------------------------------------------------------------


@inlined_ordered
def fetch(source, start, k, out):
    """Copy step k of the replications start ... of source (R|1, T|1, ...) into out (..., TILE); the
    last replication fills up the tile.
    """
    last, step = len(source) - 1, min(k, source.shape[1] - 1)
    a, b = out.reshape(-1, TILE), source.reshape(source.shape[0], source.shape[1], -1)
    for r in range(TILE):
        row = b[min(start + r, last), step]
        for i in range(len(a)):
            a[i, r] = row[i]


@inlined_ordered
def fetch_angles(source, start, k, i, out):
    """Copy steps k ... of source (R, T, B) into out[:, :, i] (AHEAD, B, TILE), as `fetch` does it:
    several steps at a time, because they share lines of the processor's cache.
    """
    last, steps = len(source) - 1, min(len(out), source.shape[1] - k)
    for r in range(TILE):
        for t in range(steps):
            row = source[min(start + r, last), k + t]
            for j in range(out.shape[1]):
                out[t, j, i, r] = row[j]


@inlined_ordered
def precise(kind, w):
    """Replace the deviations w (2, TILE) of azimuth and elevation by precisions, 1 / variance; a
    deviation that is not finite or 0 gives 0. A unit vector has one precision, of the larger.
    """
    if kind == UNIT_VECTOR:
        for r in range(TILE):
            p, q = w[0, r] * w[0, r], w[1, r] * w[1, r]
            kappa = 1.0 / (q if (q > p) | math.isnan(q) else p)
            w[0, r] = w[1, r] = min(kappa, KAPPA_MOST) if kappa < math.inf else 0.0
    else:
        for l in range(2):
            for r in range(TILE):
                p = w[l, r] * w[l, r]
                known = (p > 0.0) & (p < math.inf)
                w[l, r] = 1.0 / max(p, LEAST_VARIANCE) if known else 0.0


@inlined_ordered
def components(kind, angles, precision, y):
    """Measured components into y (3, TILE) or (2, TILE), from azimuth and elevation (2, TILE) rad
    and their precisions (2, TILE).
    """
    if kind == UNIT_VECTOR:
        for r in range(TILE):
            sine, cosine = sine_cosine(angles[0, r])
            z, level = sine_cosine(angles[1, r])
            known = precision[0, r] > 0.0
            y[0, r] = cosine * level if known else math.nan
            y[1, r] = sine * level if known else math.nan
            y[2, r] = z if known else math.nan
    else:
        for l in range(2):
            for r in range(TILE):
                y[l, r] = angles[l, r] if precision[l, r] > 0.0 else math.nan


@inlined_ordered
def tally(d, y, count):
    """Add the numbers of measured components y (d, TILE) to count (TILE,); return whether there is
    one.
    """
    found = 0
    for l in range(d):
        for r in range(TILE):
            one = 0 if math.isnan(y[l, r]) else 1
            count[r] += one
            found += one
    return found > 0


# --- what is expected -----------------------------------------------------------------------------


@inlined_ordered
def seen_from(x, s, R, out):
    """R (x - s) into out (3, TILE)."""
    for r in range(TILE):
        dx, dy, dz = x[0, r] - s[0, r], x[1, r] - s[1, r], x[2, r] - s[2, r]
        out[0, r] = R[0, 0, r] * dx + R[0, 1, r] * dy + R[0, 2, r] * dz
        out[1, r] = R[1, 0, r] * dx + R[1, 1, r] * dy + R[1, 2, r] * dz
        out[2, r] = R[2, 0, r] * dx + R[2, 1, r] * dy + R[2, 2, r] * dz


@inlined_ordered
def direction(kind, p, out):
    """Unit vector, or azimuth and elevation, of p (3, TILE) in the anchor's frame, into out."""
    if kind == UNIT_VECTOR:
        for r in range(TILE):
            u, v, w = p[0, r], p[1, r], p[2, r]
            i = 1.0 / max(math.sqrt(u * u + v * v + w * w), NEAREST)
            out[0, r], out[1, r], out[2, r] = u * i, v * i, w * i
    else:
        for r in range(TILE):
            u, v = p[0, r], p[1, r]
            out[0, r] = direction_angle(v, u)
            out[1, r] = direction_angle(p[2, r], math.sqrt(u * u + v * v))


@inlined_ordered
def at_elevation(elevation, table, l, out):
    """Variances of component l at expected elevations (TILE,) rad, into out (TILE,)."""
    for r in range(TILE):
        degree = np.rint(elevation[r] * DEGREES + 90.0)
        out[r] = table[int(degree) if 0.0 <= degree <= 180.0 else 90, l]


@inlined_ordered
def deviation(kind, l, a, b, out):
    """a - b of component l, wrapped."""
    for r in range(TILE):
        d = a[r] - b[r]
        out[r] = wrapped(d) if kind != UNIT_VECTOR and l == 0 else d


@inlined_ordered
def innovation(kind, l, y, expected, precision, v, W):
    """y - expected, wrapped, and the precision; both 0 where y is not measured."""
    for r in range(TILE):
        d = y[r] - expected[r]
        if kind != UNIT_VECTOR and l == 0:
            d = wrapped(d)
        v[r] = 0.0 if math.isnan(y[r]) else d
        W[r] = 0.0 if math.isnan(y[r]) else precision[r]


@inlined_ordered
def weigh(v, W, out):
    """Add the squares of the innovations v, multiplied by their precisions, to `out`."""
    for r in range(TILE):
        out[r] += SURE * W[r] * v[r] * v[r]


# --- information on the position ------------------------------------------------------------------


@inlined_ordered
def hide(p, least, W):
    """Precision 0 into W (d, TILE) where the squared length of p (3, TILE) is below the least at
    which an EKF can use the anchor.
    """
    for l in range(len(W)):
        for r in range(TILE):
            apart = p[0, r] * p[0, r] + p[1, r] * p[1, r] + p[2, r] * p[2, r]
            W[l, r] = 0.0 if apart < least[r] else W[l, r]


@inlined_ordered
def gather(w, A, r, W, v, a, b, c):
    """Add W h h^T and W h v, h = (a, b, c), to the sums A and g of replication r in w."""
    p, q, s = W * a, W * b, W * c
    w[A, r] += p * a
    w[A + 1, r] += q * a
    w[A + 2, r] += q * b
    w[A + 3, r] += s * a
    w[A + 4, r] += s * b
    w[A + 5, r] += s * c
    w[A + 6, r] += p * v
    w[A + 7, r] += q * v
    w[A + 8, r] += s * v


@inlined_ordered
def inform(kind, p, c, R, v, W, w, A):
    """Add the information of innovations v with precisions W (d, TILE) to the sums of w.

    p (3, TILE) is the position in the anchor's frame, c its `direction`. The derivatives of an
    azimuth and an elevation, or of a unit vector, (I - c c^T) R / distance, are formed row by row.
    """
    if kind == UNIT_VECTOR:
        for r in range(TILE):
            x, y, z = c[0, r], c[1, r], c[2, r]
            length = math.sqrt(p[0, r] * p[0, r] + p[1, r] * p[1, r] + p[2, r] * p[2, r])
            i = 1.0 / max(length, NEAREST)
            d = x * R[0, 0, r] + y * R[1, 0, r] + z * R[2, 0, r]
            e = x * R[0, 1, r] + y * R[1, 1, r] + z * R[2, 1, r]
            f = x * R[0, 2, r] + y * R[1, 2, r] + z * R[2, 2, r]
            a, b, g = i * (R[0, 0, r] - x * d), i * (R[0, 1, r] - x * e), i * (R[0, 2, r] - x * f)
            gather(w, A, r, W[0, r], v[0, r], a, b, g)
            a, b, g = i * (R[1, 0, r] - y * d), i * (R[1, 1, r] - y * e), i * (R[1, 2, r] - y * f)
            gather(w, A, r, W[1, r], v[1, r], a, b, g)
            a, b, g = i * (R[2, 0, r] - z * d), i * (R[2, 1, r] - z * e), i * (R[2, 2, r] - z * f)
            gather(w, A, r, W[2, r], v[2, r], a, b, g)
    else:
        for r in range(TILE):
            rho = max(math.sqrt(p[0, r] * p[0, r] + p[1, r] * p[1, r]), RHO_FLOOR)
            i = 1.0 / (rho * rho)
            x, y = p[0, r] * i, p[1, r] * i
            gather(
                w, A, r, W[0, r], v[0, r],
                x * R[1, 0, r] - y * R[0, 0, r],
                x * R[1, 1, r] - y * R[0, 1, r],
                x * R[1, 2, r] - y * R[0, 2, r],
            )  # fmt: skip
            j = 1.0 / (rho * rho + p[2, r] * p[2, r])
            up, out = rho * j, p[2, r] * rho * j
            gather(
                w, A, r, W[1, r], v[1, r],
                up * R[2, 0, r] - out * (x * R[0, 0, r] + y * R[1, 0, r]),
                up * R[2, 1, r] - out * (x * R[0, 1, r] + y * R[1, 1, r]),
                up * R[2, 2, r] - out * (x * R[0, 2, r] + y * R[1, 2, r]),
            )  # fmt: skip
