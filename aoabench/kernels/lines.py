"""Kernel of the point nearest to all measured lines, with and without discarding anchors.

The arithmetic of `estimators/lines.py`, one fix after the other.
"""

from __future__ import annotations

import math

import numpy as np
from numba import types

from aoabench.kernels.compile import given, inlined, kernel
from aoabench.kernels.planes import fill, sandwich
from aoabench.kernels.rays import (
    UNKNOWN,
    cast,
    centred,
    distances,
    drop,
    lies_behind,
    nearest,
    projectors,
    residual_variance,
    several_places,
)
from aoabench.kernels.small import (
    BEHIND,
    DIVERGED,
    FAILED,
    NO_MEASUREMENT,
    NONE,
    OK,
    ONE_PLACE,
    TOO_FEW_ANCHORS,
    UNDETERMINED,
    inverse,
)

LANES = 4


@inlined
def spread(x, y, z, level, A, stated, va, ve, q, R, v, line, plane, cosine, d, weight, P):
    """Covariance into P (3, 3) of the point (x, y, z) nearest to the rays with the sum A of
    projectors; d, weight (B,): distances from the rays, and space for weights.
    """
    rows = n = 0.0
    for j in range(len(line)):
        a, b, c = x - q[0, j], y - q[1, j], z - q[2, j]
        along = R[2, 0, j] * a + R[2, 1, j] * b + R[2, 2, j] * c
        r2 = a * a + b * b + c * c - plane[j] * along * along
        used = line[j] + plane[j]
        both = 0.5 * (va[j] * cosine[j] * cosine[j] + ve[j])
        variance = both if (stated > 1) & (line[j] > 0.0) else va[j]
        weight[j] = (variance * r2 if stated > 0 else r2) if used > 0.0 else 0.0
        rows += line[j] + used
        n += used
    inner = inverse(*A)
    p00, p10, p11, p20, p21, p22 = sandwich(inner, *projectors(weight, v, line, plane))
    scale = 1.0
    if stated == 0:
        squares = 0.0
        for j in range(len(line)):
            weight[j] = 1.0 / weight[j] if weight[j] > 0.0 else 0.0
            squares += d[j] * d[j] * weight[j]
        n00, n10, n11, n20, n21, n22 = projectors(weight, v, line, plane)
        unknowns = 2.0 if level else 3.0
        taken = p00 * n00 + p11 * n11 + p22 * n22 + 2.0 * (p10 * n10 + p20 * n20 + p21 * n21)
        used_up = 2.0 * unknowns - taken + (1.0 if level else 0.0)
        scale = residual_variance(squares, rows - used_up if rows > unknowns else 0.0)
    fill(P, scale, p00, p10, p11, p20, p21, p22)
    if level:
        P[2, :] = UNKNOWN
        P[:, 2] = UNKNOWN


@kernel(
    types.void(
        types.float64,
        types.intp,
        types.intp,
        given(2),
        *(given(d) for d in (2, 2, 2, 2, 3, 4)),
        types.float64[:, ::1],
        types.float64[:, :, ::1],
        types.int8[::1],
        types.int8[::1],
        *(types.float64[::1] for _ in range(2)),
    )
)
def nearest_points(
    threshold, B, stated, bounds, phi, theta, va, ve, s, R, x, P, outcome, reason, score, used
):
    """Position x (N, 3), covariance P (N, 3, 3), outcome, reason, root mean square distance and
    number of anchors used (N,) of each fix from its angles (N, B), NaN where not measured.

    Anchors are discarded until the root mean square distance is at most `threshold`. B: number of
    anchors, without padding; va, ve (N, B): the stated variances, of no angle, of azimuths alone or
    of both for `stated` = 0, 1, 2; s (N|1, 3, B) anchors, R (N|1, 3, 3, B); bounds (2, 2) of x, y.
    """
    width = phi.shape[1]
    q, ahead, v = np.empty((3, width)), np.empty((3, width)), np.empty((3, width))
    line, plane, cosine, d = np.empty(width), np.empty(width), np.empty(width), np.empty(width)
    weight, one = np.empty(width), np.ones(width)
    cx = cy = cz = 0.0
    for n in range(len(phi)):
        i, j = min(n, len(s) - 1), min(n, len(R) - 1)
        if n == 0 or i > 0:
            cx, cy, cz = centred(B, s[i], q)
        cast(phi[n], theta[n], R[j], ahead, v, line, plane, cosine)
        m = line.sum() + plane.sum()
        while True:
            a, b, c, sound, level, A = nearest(q, v, line, plane, one)
            if not sound:
                a, b = -cx, -cy
            c = c if sound and not level else -cz  # the origin, as in NumPy
            squares = distances(a, b, c, q, ahead, v, plane, d)
            if not (m > 2.0 and squares > m * threshold * threshold):
                break
            drop(np.argmax(d), ahead, v, line, plane)
            m -= 1.0
        distinct = several_places(q, line, plane, 0.0 if level else 1.0)
        used[n], outcome[n], reason[n] = m, OK, NONE
        if not (sound and distinct and m > 1.0):
            x[n], P[n], score[n], outcome[n] = UNKNOWN, UNKNOWN, UNKNOWN, FAILED
            reason[n] = UNDETERMINED if distinct else ONE_PLACE
            if m < 2.0:
                reason[n] = TOO_FEW_ANCHORS if m > 0.0 else NO_MEASUREMENT
            continue
        score[n] = math.sqrt(squares / m)
        spread(
            a, b, c, level, A, stated, va[n], ve[n], q, R[j], v, line, plane, cosine, d, weight,
            P[n],
        )  # fmt: skip
        x[n, 0] = min(max(a + cx, bounds[0, 0]), bounds[1, 0])
        x[n, 1] = min(max(b + cy, bounds[0, 1]), bounds[1, 1])
        x[n, 2] = UNKNOWN if level else c + cz
        if lies_behind(x[n, 0] - cx, x[n, 1] - cy, c, not level, q, ahead):
            outcome[n], reason[n] = DIVERGED, BEHIND
