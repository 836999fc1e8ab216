"""Kalman filter kernels: EKF and UKF in double precision, vectorised over replications.

The arithmetic of `filters/kalman.py`, written out for states whose first three components are the
position and for the measurement models of `kernels/directions.py`. Both filters carry a square root
of the covariance. A measurement's information on the position is summed component by component, as
A (3, 3) and g (3,); these amount to three scalar measurements, which shrink the square root.

Arrays have one more axis than in the textbook, the last: `TILE` replications. Each innermost loop
runs over them, has a constant length and calls nothing, so that the compiler vectorises it.
"""

from __future__ import annotations

import math

import numpy as np
from numba import types

from aoabench.kernels.compile import ORDERED, given, inlined_ordered, kernel
from aoabench.kernels.directions import (
    TILE,
    at_elevation,
    components,
    copy,
    deviation,
    direction,
    fetch,
    fetch_angles,
    hide,
    inform,
    innovation,
    precise,
    put,
    seen_from,
    tally,
    weigh,
)
from aoabench.kernels.small import AZEL_ADAPTIVE, UNIT_VECTOR
from aoabench.kernels.square_root import advance, conclude, reach, store, update

AHEAD = 4  # steps whose angles are fetched at a time
AVERAGED, CENTRE = range(2)  # the UKF's variances

# Rows of w: A and g, the position's factor; an update's T and z; the sum of squared innovations
A, G, L, T, Z, N, ROWS = 0, 6, 9, 15, 24, 27, 28


# --- linear algebra -------------------------------------------------------------------------------


@inlined_ordered
def accumulate(z, W, v, wz, M, b):
    """M += z W z^T, its lower half, and b += z W v for the deviations z (d, 6, TILE) of d
    components, their precisions W and innovations v (d, TILE); wz (d, TILE) is workspace.
    """
    d = len(z)
    for i in range(6):
        for l in range(d):
            for r in range(TILE):
                wz[l, r] = W[l, r] * z[l, i, r]
                b[i, r] += wz[l, r] * v[l, r]
        for q in range(i + 1):
            if d == 2:
                for r in range(TILE):
                    M[i, q, r] += wz[0, r] * z[0, q, r] + wz[1, r] * z[1, q, r]
            else:
                for r in range(TILE):
                    M[i, q, r] += (
                        wz[0, r] * z[0, q, r] + wz[1, r] * z[1, q, r] + wz[2, r] * z[2, q, r]
                    )


@inlined_ordered
def eliminate(M, b):
    """Eliminate the first three of six unknowns from M x = b, M given by its lower half.

    M[3:, 3:] and b[3:] then hold the system of the last three; M[j, j] (j < 3) its reciprocals.
    """
    for j in range(3):
        for r in range(TILE):
            M[j, j, r] = 1.0 / M[j, j, r]
        for i in range(j + 1, 6):
            for r in range(TILE):
                b[i, r] -= M[i, j, r] * M[j, j, r] * b[j, r]
            for l in range(j + 1, i + 1):
                for r in range(TILE):
                    M[i, l, r] -= M[i, j, r] * M[j, j, r] * M[l, j, r]


# --------------------------------------------------------------------------------------------------


@inlined_ordered
def remaining(M, b, w):
    """Rows A, g and L of w for the three unknowns left by `eliminate`, and N without the share of
    the other three.
    """
    for i in range(3):
        for r in range(TILE):
            w[N, r] -= M[i, i, r] * b[i, r] * b[i, r]
    for i in range(3):
        copy(b[3 + i], w[G + i])
        for j in range(i + 1):
            copy(M[3 + i, 3 + j], w[A + i * (i + 1) // 2 + j])
            put(1.0 if i == j else 0.0, w[L + i * (i + 1) // 2 + j])


@inlined_ordered
def points(x, root, s, R, spread, out):
    """Seven sigma points in an anchor's frame into out (7, 3, TILE): the position x, and x plus and
    minus `spread` times the columns of the position's factor.
    """
    seen_from(x, s, R, out[0])
    for l in range(3):
        for i in range(3):
            for r in range(TILE):
                a = R[i, 2, r] * root[2, l, r]
                if l < 2:
                    a += R[i, 1, r] * root[1, l, r]
                if l < 1:
                    a += R[i, 0, r] * root[0, l, r]
                out[1 + l, i, r] = out[0, i, r] + spread * a
                out[4 + l, i, r] = out[0, i, r] - spread * a


@inlined_ordered
def begin(start, x0, root0, x, root):
    """Prior x (n, TILE) and root (n, n, TILE) of the replications start ...; the last one fills up
    the tile.
    """
    for i in range(len(x)):
        for r in range(TILE):
            x[i, r] = x0[min(start + r, len(x0) - 1), i]
        for j in range(len(x)):
            put(root0[i, j], root[i, j])


@inlined_ordered
def arrive(kind, measured, frames, start, k, seen, precision, s, rot):
    """Fetch the angles of step k and of the next ones into seen (AHEAD, B, 2, TILE), and precisions
    (AHEAD|1, B, 2, TILE) and anchors if they change with the step.
    """
    azimuth, elevation, azimuth_sigma, elevation_sigma = measured
    if k % AHEAD == 0:
        fetch_angles(azimuth, start, k, 0, seen)
        fetch_angles(elevation, start, k, 1, seen)
        if k < azimuth_sigma.shape[1]:
            fetch_angles(azimuth_sigma, start, k, 0, precision)
            fetch_angles(elevation_sigma, start, k, 1, precision)
            for t in range(len(precision)):
                for j in range(len(s)):
                    precise(kind, precision[t, j])
    if k < frames[0].shape[1]:
        fetch(frames[0], start, k, s)
    if k < frames[1].shape[1]:
        fetch(frames[1], start, k, rot)


@inlined_ordered
def keep(root, w):
    """Row L of w: the factor of the position's covariance."""
    for i in range(3):
        for j in range(i + 1):
            copy(root[i, j], w[L + i * (i + 1) // 2 + j])


@inlined_ordered
def note(start, k, count, measured):
    """Store the numbers of measured components at step k."""
    for r in range(min(TILE, len(measured) - start)):
        measured[start + r, k] = count[r]


ARGUMENTS = (
    types.intp,
    *(given(dimensions) for dimensions in (2, 2, 4, 4, 3, 3, 3, 3, 4, 5, 2)),
    types.float64[:, :, ::1],
    types.float64[:, :, :, ::1],
    types.float64[:, ::1],
    types.int64[:, ::1],
)


@kernel(types.void(*ARGUMENTS), ORDERED)
def ekf(
    kind, x0, root0, F, Q, azimuth, elevation, azimuth_sigma, elevation_sigma, position, rotation,
    table, means, covariances, nis, measured,
):  # fmt: skip
    """EKF of each replication: means (R, T, 3|n), their covariances, normalised innovations
    squared (R, T) and numbers of measured components (R, T) from angles (R, T, B) and their
    deviations (R|1, T|1, B) in rad.

    x0 (R, n); root0 (n, n), a lower factor of the prior's covariance; F, Q (R|1, T|1, n, n);
    anchors (R|1, T|1, B, ...); `table` (181, 2) of variances for AZEL_ADAPTIVE, which takes from
    the deviations only whether they are known.
    """
    (R, steps, B), n, d = azimuth.shape, x0.shape[1], 3 if kind == UNIT_VECTOR else 2
    x, Fx, w = np.empty((n, TILE)), np.empty((n, TILE)), np.empty((ROWS, TILE))
    P, FR, root = np.empty((n, n, TILE)), np.empty((n, n, TILE)), np.empty((n, n, TILE))
    moves = np.empty((2, n, n, TILE))
    s, rot = np.empty((B, 3, TILE)), np.empty((B, 3, 3, TILE))
    seen = np.empty((AHEAD, B, 2, TILE))
    known = min(AHEAD, azimuth_sigma.shape[1])
    precision = np.zeros((known, B, 2, TILE))
    local, c, y = np.empty((3, TILE)), np.empty((3, TILE)), np.empty((d, TILE))
    v, W, var = np.empty((d, TILE)), np.empty((d, TILE)), np.empty(TILE)
    least, count = np.empty(TILE), np.empty(TILE, np.int64)
    observed = azimuth, elevation, azimuth_sigma, elevation_sigma
    for start in range(0, R, TILE):
        begin(start, x0, root0, x, root)
        for k in range(steps):
            arrive(kind, observed, (position, rotation), start, k, seen, precision, s, rot)
            now, weight = seen[k % AHEAD], precision[k % known]
            advance(TILE, start, k, x, root, F, Q, moves, P, FR, Fx)
            reach(TILE, P, least)
            for i in range(A, G + 3):
                put(0.0, w[i])
            put(0.0, w[N])
            put(0, count)
            for j in range(B):
                components(kind, now[j], weight[j], y)
                if not tally(d, y, count):
                    continue
                seen_from(x, s[j], rot[j], local)
                direction(kind, local, c)
                for l in range(d):
                    if kind == AZEL_ADAPTIVE:
                        at_elevation(c[1], table, l, var)
                        for r in range(TILE):
                            var[r] = 1.0 / var[r]
                    else:
                        copy(weight[j, min(l, 1)], var)
                    innovation(kind, l, y[l], c[l], var, v[l], W[l])
                hide(local, least, W)
                for l in range(d):
                    weigh(v[l], W[l], w[N])
                inform(kind, local, c, rot[j], v, W, w, A)
            keep(root, w)
            update(TILE, w, A, L, T, Z, N)
            conclude(TILE, x, root, w, T, Z)
            store(TILE, x, root, w[N], start, k, means, covariances, nis)
            note(start, k, count, measured)


@kernel(types.void(*ARGUMENTS, types.float64, types.intp), ORDERED)
def ukf(
    kind, x0, root0, F, Q, azimuth, elevation, azimuth_sigma, elevation_sigma, position, rotation,
    table, means, covariances, nis, measured, lambda_, form,
):  # fmt: skip
    """UKF of each replication with 2 n + 1 sigma points; `form` AVERAGED or CENTRE, the rest as for
    `ekf`.

    Seven points are computed: the others have the centre's position, and their weights are added to
    the centre's. With the sums S_i and differences D_i of the deviations of three pairs, the
    predicted measurement's covariance is the sum of D_i D_i^T and E_i E_i^T, times each / 2, where
    E_i = S_i + shared (S_1 + S_2 + S_3) includes the deviation of their mean. Only the differences
    deviate in the state; the other three unknowns are eliminated, which leaves the update of the
    state.
    """
    (R, steps, B), n, d = azimuth.shape, x0.shape[1], 3 if kind == UNIT_VECTOR else 2
    x, Fx, w = np.empty((n, TILE)), np.empty((n, TILE)), np.empty((ROWS, TILE))
    P, FR, root = np.empty((n, n, TILE)), np.empty((n, n, TILE)), np.empty((n, n, TILE))
    moves = np.empty((2, n, n, TILE))
    local, image, z = np.empty((7, 3, TILE)), np.empty((7, 3, TILE)), np.empty((d, 6, TILE))
    M, b = np.empty((6, 6, TILE)), np.empty((6, TILE))
    s, rot = np.empty((B, 3, TILE)), np.empty((B, 3, 3, TILE))
    seen = np.empty((AHEAD, B, 2, TILE))
    known = min(AHEAD, azimuth_sigma.shape[1])
    precision = np.zeros((known, B, 2, TILE))
    y, v, W = np.empty((d, TILE)), np.empty((d, TILE)), np.empty((d, TILE))
    wz, var = np.empty((d, TILE)), np.empty(TILE)
    one, expected = np.empty(TILE), np.empty(TILE)
    count = np.empty(TILE, np.int64)
    observed = azimuth, elevation, azimuth_sigma, elevation_sigma
    each, spread = 0.5 / (n + lambda_), math.sqrt(n + lambda_)
    centre = (lambda_ + n - 3.0) / (n + lambda_)
    half, shared = math.sqrt(0.5 * each), (math.sqrt(centre) - 1.0) / 3.0
    for start in range(0, R, TILE):
        begin(start, x0, root0, x, root)
        for k in range(steps):
            arrive(kind, observed, (position, rotation), start, k, seen, precision, s, rot)
            now, weight = seen[k % AHEAD], precision[k % known]
            advance(TILE, start, k, x, root, F, Q, moves, P, FR, Fx)
            for i in range(6):
                put(0.0, b[i])
                for l in range(6):
                    put(1.0 if i == l and i < 3 else 0.0, M[i, l])
            put(0.0, w[N])
            put(0, count)
            for j in range(B):
                components(kind, now[j], weight[j], y)
                if not tally(d, y, count):
                    continue
                points(x, root, s[j], rot[j], spread, local)
                for i in range(7):
                    direction(kind, local[i], image[i])
                for l in range(d):
                    for i in range(6):
                        deviation(kind, l, image[1 + i, l], image[0, l], z[l, i])
                    if kind != AZEL_ADAPTIVE:
                        copy(weight[j, min(l, 1)], var)
                    else:
                        at_elevation(image[0, 1], table, l, var)
                        if form == AVERAGED:
                            for r in range(TILE):
                                var[r] *= centre
                            for i in range(1, 7):
                                at_elevation(image[i, 1], table, l, one)
                                for r in range(TILE):
                                    var[r] += each * one[r]
                        for r in range(TILE):
                            var[r] = 1.0 / var[r]
                    for r in range(TILE):
                        a, e, f = z[l, 0, r], z[l, 1, r], z[l, 2, r]
                        p, q, t = z[l, 3, r], z[l, 4, r], z[l, 5, r]
                        total = a + e + f + p + q + t
                        expected[r] = image[0, l, r] + each * total
                        total *= shared
                        z[l, 0, r], z[l, 3, r] = half * (a + p + total), half * (a - p)
                        z[l, 1, r], z[l, 4, r] = half * (e + q + total), half * (e - q)
                        z[l, 2, r], z[l, 5, r] = half * (f + t + total), half * (f - t)
                    innovation(kind, l, y[l], expected, var, v[l], W[l])
                    weigh(v[l], W[l], w[N])
                accumulate(z, W, v, wz, M, b)
            eliminate(M, b)
            remaining(M, b, w)
            update(TILE, w, A, L, T, Z, N)
            conclude(TILE, x, root, w, T, Z)
            store(TILE, x, root, w[N], start, k, means, covariances, nis)
            note(start, k, count, measured)
