"""Kernel of the weighted centroid: double precision, `TILE` steps of a replication at once.

The kernel computes the sums of `estimators/centroid.py`. The last axis of `w` runs over the steps;
loops over it contain no calls, and all their arrays are rows of `w`, so that they vectorise.
"""

from __future__ import annotations

import math

import numpy as np
from numba import types

from aoabench.kernels.angles import angle, sine_cosine
from aoabench.kernels.compile import ORDERED, given, inlined_ordered, kernel
from aoabench.kernels.small import BEHIND, DIVERGED, FAILED, NO_MEASUREMENT, NONE, OK, UNDETERMINED
from aoabench.maths.geometry import LIGHT

TILE = 32

# First rows of w: Y delay, azimuth and elevation, V their deviations, S anchor's position, M its
# rotation, C deviations of its position, A its ray; sums over the anchors: W weights, P weighted
# positions, E weighted covariances (6), N anchors used; B whether the fix is behind an anchor
Y, V, S, M, C, A, W, P, E, N, B, ROWS = 0, 3, 6, 9, 18, 21, 24, 25, 28, 34, 35, 36


@inlined_ordered
def anchor(w, r, start, m, position, rotation, sigma):
    """Copy the anchor at place m into w: position, rotation and deviations of the position."""
    p, q, s = min(r, len(position) - 1), min(r, len(rotation) - 1), min(r, len(sigma) - 1)
    for k in range(TILE):
        at = min(start + k, position.shape[1] - 1)
        turn = min(start + k, rotation.shape[1] - 1)
        known = min(start + k, sigma.shape[1] - 1)
        for i in range(3):
            w[S + i, k] = position[p, at, m, i]
            w[C + i, k] = sigma[s, known, m, i]
            for j in range(3):
                w[M + 3 * i + j, k] = rotation[q, turn, m, i, j]


@inlined_ordered
def copy(w, row, values, r, start, m):
    """Copy the values at place m into a row of w; return whether one is a number."""
    found, last = False, values.shape[1] - 1
    for k in range(TILE):
        value = values[r, min(start + k, last), m]
        w[row, k] = value
        found |= not math.isnan(value)
    return found


@inlined_ordered
def usable(value, sigma):
    """Whether a value is finite and its deviation a positive number."""
    return (abs(value) < math.inf) & (sigma > 0.0) & (sigma < math.inf)


@inlined_ordered
def scaled(f, u):
    """f u for u (3,)."""
    return f * u[0], f * u[1], f * u[2]


@inlined_ordered
def add(w, printed):
    """Add the anchor in w to the sums, where it measured a time and both angles."""
    for k in range(TILE):
        d, a, e = w[Y, k], w[Y + 1, k], w[Y + 2, k]
        sd, sa, se = w[V, k], w[V + 1, k], w[V + 2, k]
        good = usable(d, sd) & usable(a, sa) & usable(e, se)
        x = w[M, k], w[M + 1, k], w[M + 2, k]
        y = w[M + 3, k], w[M + 4, k], w[M + 5, k]
        z = w[M + 6, k], w[M + 7, k], w[M + 8, k]
        if printed:
            a += angle(x[1], x[0], math.sqrt(x[0] * x[0] + x[1] * x[1]))
        sin_a, cos_a = sine_cosine(a)
        sin_e, cos_e = sine_cosine(e)
        d *= LIGHT
        out = (
            cos_a * x[0] + sin_a * y[0],
            cos_a * x[1] + sin_a * y[1],
            cos_a * x[2] + sin_a * y[2],
        )
        left = (
            cos_a * y[0] - sin_a * x[0],
            cos_a * y[1] - sin_a * x[1],
            cos_a * y[2] - sin_a * x[2],
        )
        ahead = (
            cos_e * out[0] + sin_e * z[0],
            cos_e * out[1] + sin_e * z[1],
            cos_e * out[2] + sin_e * z[2],
        )
        up = (
            cos_e * z[0] - sin_e * out[0],
            cos_e * z[1] - sin_e * out[1],
            cos_e * z[2] - sin_e * out[2],
        )
        ray = scaled(d, ahead)
        f, g, h = scaled(LIGHT * sd, ahead), scaled(sa * d * cos_e, left), scaled(se * d, up)
        weight = 1.0 / (sd * sd)
        v = weight * weight
        w[W, k] += weight if good else 0.0
        w[N, k] += 1.0 if good else 0.0
        for i in range(3):
            w[P + i, k] += weight * (w[S + i, k] + ray[i]) if good else 0.0
            w[A + i, k] = ray[i] if good else 0.0
        w[E, k] += v * (f[0] * f[0] + g[0] * g[0] + h[0] * h[0] + w[C, k] ** 2) if good else 0.0
        w[E + 1, k] += v * (f[1] * f[0] + g[1] * g[0] + h[1] * h[0]) if good else 0.0
        w[E + 2, k] += (
            v * (f[1] * f[1] + g[1] * g[1] + h[1] * h[1] + w[C + 1, k] ** 2) if good else 0.0
        )
        w[E + 3, k] += v * (f[2] * f[0] + g[2] * g[0] + h[2] * h[0]) if good else 0.0
        w[E + 4, k] += v * (f[2] * f[1] + g[2] * g[1] + h[2] * h[1]) if good else 0.0
        w[E + 5, k] += (
            v * (f[2] * f[2] + g[2] * g[2] + h[2] * h[2] + w[C + 2, k] ** 2) if good else 0.0
        )


@inlined_ordered
def conclude(w):
    """Divide the sums of positions and covariances by those of the weights."""
    for k in range(TILE):
        total = w[W, k]
        square = total * total
        for i in range(3):
            w[P + i, k] /= total
        for i in range(6):
            w[E + i, k] /= square


@inlined_ordered
def behind(w, seen):
    """Mark the fixes behind an anchor; seen (6, TILE) are its ray and its position."""
    for k in range(TILE):
        along = seen[0, k] * (w[P, k] - seen[3, k]) + seen[1, k] * (w[P + 1, k] - seen[4, k])
        along += seen[2, k] * (w[P + 2, k] - seen[5, k])
        w[B, k] = 1.0 if along < 0.0 else w[B, k]


@inlined_ordered
def store(w, r, start, positions, covariances, used, outcome, reason):
    """Store the fixes of the steps from `start` on, with outcomes and reasons."""
    for k in range(min(TILE, positions.shape[1] - start)):
        at, found = start + k, True
        for i in range(3):
            positions[r, at, i] = w[P + i, k]
            found &= abs(w[P + i, k]) < math.inf
            for j in range(i + 1):
                c = w[E + i * (i + 1) // 2 + j, k]
                covariances[r, at, i, j] = covariances[r, at, j, i] = c
        used[r, at] = w[N, k]
        if found:
            outcome[r, at] = DIVERGED if w[B, k] > 0.0 else OK
            reason[r, at] = BEHIND if w[B, k] > 0.0 else NONE
        else:
            outcome[r, at] = FAILED
            reason[r, at] = UNDETERMINED if w[N, k] > 0.0 else NO_MEASUREMENT


@kernel(
    types.void(
        *(given(3) for _ in range(6)), given(4), given(5), given(4), types.boolean,
        types.float64[:, :, ::1], types.float64[:, :, :, ::1], types.float64[:, ::1],
        types.int8[:, ::1], types.int8[:, ::1],
    ),
    ORDERED,
)  # fmt: skip
def centroid(
    delay,
    azimuth,
    elevation,
    delay_sigma,
    azimuth_sigma,
    elevation_sigma,
    position,
    rotation,
    sigma,
    printed,
    positions,
    covariances,
    used,
    outcome,
    reason,
):
    """Positions (R, T, 3) m, covariances (R, T, 3, 3) m^2, numbers (R, T) of the anchors used,
    outcomes and reasons (R, T), into the last five arguments.

    delay s ... elevation_sigma rad (R, T, K): measurements and their deviations, NaN = not
    measured; position, sigma (R|1, T|1, K, 3) m, rotation (R|1, T|1, K, 3, 3): the anchors and the
    deviations of their positions; printed: whether the orientation stays in the azimuth.
    """
    R, T, K = azimuth.shape
    w, seen = np.empty((ROWS, TILE)), np.empty((K, 6, TILE))
    for r in range(R):
        for start in range(0, T, TILE):
            for i in range(W, ROWS):
                for k in range(TILE):
                    w[i, k] = 0.0
            n = 0
            for m in range(K):
                if not copy(w, Y + 1, azimuth, r, start, m):
                    continue
                copy(w, Y, delay, r, start, m)
                copy(w, Y + 2, elevation, r, start, m)
                copy(w, V, delay_sigma, r, start, m)
                copy(w, V + 1, azimuth_sigma, r, start, m)
                copy(w, V + 2, elevation_sigma, r, start, m)
                anchor(w, r, start, m, position, rotation, sigma)
                add(w, printed)
                for i in range(3):
                    for k in range(TILE):
                        seen[n, i, k], seen[n, 3 + i, k] = w[A + i, k], w[S + i, k]
                n += 1
            conclude(w)
            for m in range(n):
                behind(w, seen[m])
            store(w, r, start, positions, covariances, used, outcome, reason)


def run(batch, printed):
    """Positions (R, T, 3) m, covariances (R, T, 3, 3) m^2, numbers (R, T) of the anchors used,
    outcomes and reasons (R, T).

    printed: whether the orientation stays in the azimuth. Deviations that are not stated count as
    usable; the covariances are then not valid.
    """
    R, T, K = batch.azimuth.shape
    own, anchors = batch.anchors.position_sigma, batch.anchors
    sigmas = batch.delay_sigma, batch.azimuth_sigma, batch.elevation_sigma
    arrays = (
        batch.delay, batch.azimuth, batch.elevation,
        *(batch.delay_sigma if sigma is None else sigma for sigma in sigmas),
        anchors.position, anchors.rotation, np.zeros((1, 1, K, 3)) if own is None else own,
    )  # fmt: skip
    out = (
        np.empty((R, T, 3)), np.empty((R, T, 3, 3)), np.empty((R, T)),
        np.empty((R, T), np.int8), np.empty((R, T), np.int8),
    )  # fmt: skip
    centroid(*(np.ascontiguousarray(a, dtype=float) for a in arrays), printed, *out)
    return out
