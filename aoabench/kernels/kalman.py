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
    deviation,
    direction,
    hide,
    innovation,
    seen_from,
    slopes,
    squared_length,
    variance,
    weigh,
)
from aoabench.kernels.small import AZEL_ADAPTIVE
from aoabench.kernels.square_root import cholesky, conclude, predict, reach, store, update

AVERAGED, CENTRE = range(2)  # the UKF's variances

# Rows of w: A and g, the position's factor; an update's T and z; the sum of squared innovations
A, G, L, T, Z, N, ROWS = 0, 6, 9, 15, 24, 27, 28


# --- linear algebra -------------------------------------------------------------------------------


@inlined_ordered
def subtract(out, a, b):
    """out -= a b."""
    for r in range(TILE):
        out[r] -= a[r] * b[r]


@inlined_ordered
def add(out, a, b):
    """out += a b."""
    for r in range(TILE):
        out[r] += a[r] * b[r]


@inlined_ordered
def eliminate(M, b):
    """Eliminate the first four of seven unknowns from M x = b, M given by its lower half.

    M[4:, 4:] and b[4:] then hold the system of the last three; M[j, j] (j < 4) its reciprocals.
    """
    for j in range(4):
        for r in range(TILE):
            M[j, j, r] = 1.0 / M[j, j, r]
        for i in range(j + 1, 7):
            for r in range(TILE):
                b[i, r] -= M[i, j, r] * M[j, j, r] * b[j, r]
            for l in range(j + 1, i + 1):
                for r in range(TILE):
                    M[i, l, r] -= M[i, j, r] * M[j, j, r] * M[l, j, r]


# --------------------------------------------------------------------------------------------------


@inlined_ordered
def remaining(M, b, w):
    """Rows A, g and L of w for the three unknowns left by `eliminate`, and N without the share of
    the other four.
    """
    for i in range(4):
        for r in range(TILE):
            w[N, r] -= M[i, i, r] * b[i, r] * b[i, r]
    for i in range(3):
        w[G + i] = b[4 + i]
        for j in range(i + 1):
            w[A + i * (i + 1) // 2 + j] = M[4 + i, 4 + j]
            w[L + i * (i + 1) // 2 + j] = 1.0 if i == j else 0.0


@inlined_ordered
def load(source, start, out):
    """Copy replications start ... of source (R|1, ...) into out (..., TILE); the last one fills up
    the tile.
    """
    last = len(source) - 1
    a, b = out.reshape(-1, TILE), source.reshape(len(source), -1)
    for i in range(len(a)):
        for r in range(TILE):
            a[i, r] = b[min(start + r, last), i]


@inlined_ordered
def load_step(source, start, k, c, out):
    """Copy component c of step k into out (TILE,), as `load` does it."""
    last = len(source) - 1
    for r in range(TILE):
        out[r] = source[min(start + r, last), k, c]


@inlined_ordered
def begin(start, x0, root0, position, rotation, x, root, s, rot):
    """Prior x (n, TILE), root (n, n, TILE) and anchors s, rot of the replications start ..."""
    load(x0, start, x)
    load(position, start, s)
    load(rotation, start, rot)
    for i in range(len(x)):
        for j in range(len(x)):
            root[i, j] = root0[i, j]


ARGUMENTS = (
    types.intp,
    *(given(dimensions) for dimensions in (2, 2, 2, 2, 3, 3, 3, 4, 2)),
    types.float64[:, :, ::1],
    types.float64[:, :, :, ::1],
    types.float64[:, ::1],
)


@kernel(types.void(*ARGUMENTS), ORDERED)
def ekf(kind, x0, root0, F, Q, Y, quality, position, rotation, table, means, covariances, nis):
    """EKF of each replication: means (R, T, 3), covariances (R, T, 3, 3) and normalised innovations
    squared (R, T) from measurements Y (R, T, m).

    x0 (R, n), root0, F, Q (n, n), where root0 is a lower factor of the prior's covariance; quality
    (R, T, m) nominal variances; anchors (R|1, B, ...); `table` (181, 2) of variances for
    AZEL_ADAPTIVE.
    """
    (R, steps, m), (B, n) = Y.shape, (position.shape[1], x0.shape[1])
    d = m // B
    x, Fx, w = np.empty((n, TILE)), np.empty((n, TILE)), np.empty((ROWS, TILE))
    P, FR, root = np.empty((n, n, TILE)), np.empty((n, n, TILE)), np.empty((n, n, TILE))
    s, rot = np.empty((B, 3, TILE)), np.empty((B, 3, 3, TILE))
    local, c, h = np.empty((3, TILE)), np.empty((3, TILE)), np.empty((3, 3, TILE))
    y, nominal, var = np.empty(TILE), np.empty(TILE), np.empty(TILE)
    v, W, d2, least = np.empty(TILE), np.empty(TILE), np.empty(TILE), np.empty(TILE)
    for start in range(0, R, TILE):
        begin(start, x0, root0, position, rotation, x, root, s, rot)
        for k in range(steps):
            predict(TILE, x, root, F, Q, P, FR, Fx)
            cholesky(TILE, P, root)
            reach(TILE, P, least)
            w[A : G + 3] = 0.0
            w[N] = 0.0
            for j in range(B):
                seen_from(x, s[j], rot[j], local)
                direction(kind, local, c)
                slopes(kind, local, c, rot[j], h)
                squared_length(local, d2)
                for l in range(d):
                    load_step(Y, start, k, d * j + l, y)
                    hide(d2, least, y)
                    load_step(quality, start, k, d * j + l, nominal)
                    variance(kind, l, c[1], nominal, table, var)
                    innovation(kind, l, y, c[l], var, v, W)
                    weigh(v, W, w[N])
                    for r in range(TILE):
                        a, b, e = W[r] * h[l, 0, r], W[r] * h[l, 1, r], W[r] * h[l, 2, r]
                        w[A, r] += a * h[l, 0, r]
                        w[A + 1, r] += b * h[l, 0, r]
                        w[A + 2, r] += b * h[l, 1, r]
                        w[A + 3, r] += e * h[l, 0, r]
                        w[A + 4, r] += e * h[l, 1, r]
                        w[A + 5, r] += e * h[l, 2, r]
                        w[G, r] += a * v[r]
                        w[G + 1, r] += b * v[r]
                        w[G + 2, r] += e * v[r]
            for i in range(3):
                for j in range(i + 1):
                    w[L + i * (i + 1) // 2 + j] = root[i, j]
            update(TILE, w, A, L, T, Z, N)
            conclude(TILE, x, root, w, T, Z)
            store(TILE, x, root, w[N], start, k, means, covariances, nis)


@kernel(types.void(*ARGUMENTS, types.float64, types.intp), ORDERED)
def ukf(
    kind, x0, root0, F, Q, Y, quality, position, rotation, table, means, covariances, nis,
    lambda_, form,
):  # fmt: skip
    """UKF of each replication with 2 n + 1 sigma points; `form` AVERAGED or CENTRE, the rest as for
    `ekf`.

    Seven points are computed: the others have the centre's position, and their weights are added to
    the centre's. Each pair of points gives a half sum and a half difference. Only the differences
    deviate in the state; the other four unknowns are eliminated, which leaves the update of the
    state.
    """
    (R, steps, m), (B, n) = Y.shape, (position.shape[1], x0.shape[1])
    d = m // B
    x, Fx, w = np.empty((n, TILE)), np.empty((n, TILE)), np.empty((ROWS, TILE))
    P, FR, root = np.empty((n, n, TILE)), np.empty((n, n, TILE)), np.empty((n, n, TILE))
    point, image, z = np.empty((7, 3, TILE)), np.empty((7, 3, TILE)), np.empty((7, TILE))
    M, b = np.empty((7, 7, TILE)), np.empty((7, TILE))
    s, rot, local = np.empty((B, 3, TILE)), np.empty((B, 3, 3, TILE)), np.empty((3, TILE))
    y, nominal, var = np.empty(TILE), np.empty(TILE), np.empty(TILE)
    v, W = np.empty(TILE), np.empty(TILE)
    one, mean, expected = np.empty(TILE), np.empty(TILE), np.empty(TILE)
    each, spread = 0.5 / (n + lambda_), math.sqrt(n + lambda_)
    centre = (lambda_ + n - 3.0) / (n + lambda_)
    half, still = math.sqrt(0.5 * each), math.sqrt(centre)
    for start in range(0, R, TILE):
        begin(start, x0, root0, position, rotation, x, root, s, rot)
        for k in range(steps):
            predict(TILE, x, root, F, Q, P, FR, Fx)
            cholesky(TILE, P, root)
            for i in range(3):
                point[0, i] = x[i]
                for l in range(3):
                    for r in range(TILE):
                        step = spread * root[i, l, r] if l <= i else 0.0
                        point[1 + l, i, r], point[4 + l, i, r] = x[i, r] + step, x[i, r] - step
            b[:] = 0.0
            M[:] = 0.0
            w[N] = 0.0
            for i in range(4):
                M[i, i] = 1.0
            for j in range(B):
                for i in range(7):
                    seen_from(point[i], s[j], rot[j], local)
                    direction(kind, local, image[i])
                for l in range(d):
                    load_step(Y, start, k, d * j + l, y)
                    load_step(quality, start, k, d * j + l, nominal)
                    mean[:] = 0.0
                    for i in range(1, 7):
                        deviation(kind, l, image[i, l], image[0, l], z[i])
                        for r in range(TILE):
                            mean[r] += each * z[i, r]
                    if form == CENTRE or kind != AZEL_ADAPTIVE:
                        variance(kind, l, image[0, 1], nominal, table, var)
                    else:
                        var[:] = 0.0
                        for i in range(7):
                            variance(kind, l, image[i, 1], nominal, table, one)
                            for r in range(TILE):
                                var[r] += (each if i else centre) * one[r]
                    for r in range(TILE):
                        expected[r] = image[0, l, r] + mean[r]
                        z[0, r] = -still * mean[r]
                    for i in range(1, 4):
                        for r in range(TILE):
                            p, q = z[i, r], z[3 + i, r]
                            z[i, r], z[3 + i, r] = half * (p + q - 2.0 * mean[r]), half * (p - q)
                    innovation(kind, l, y, expected, var, v, W)
                    weigh(v, W, w[N])
                    for i in range(7):
                        for r in range(TILE):
                            one[r] = z[i, r] * W[r]
                        add(b[i], one, v)
                        for q in range(i + 1):
                            add(M[i, q], one, z[q])
            eliminate(M, b)
            remaining(M, b, w)
            update(TILE, w, A, L, T, Z, N)
            conclude(TILE, x, root, w, T, Z)
            store(TILE, x, root, w[N], start, k, means, covariances, nis)
