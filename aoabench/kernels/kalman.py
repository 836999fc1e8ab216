"""Kalman filter kernels: EKF and UKF in double precision, vectorised over replications.

The arithmetic of `filters/kalman.py`, written out for states whose first three components are the
position and for the measurement models that are numbered below. In both filters the measurement
enters component by component, and P+ = V^T V with V = G^-1 L^T and G G^T = I + L^T A L is positive
semidefinite by its form.

Arrays have one more axis than in the textbook, the last: `TILE` replications. Whatever is innermost
below is a loop over them, of constant length and without calls, so that the compiler vectorises it.
Angles are computed by a polynomial after halving twice, 4 atan(t) with t <= tan(pi / 8), to the
last bits of double precision.

Kernels may use nothing but this file: the cache on disk sees only its own.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numba import njit, types

TILE = 64
UNIT_VECTOR, AZEL, AZEL_ADAPTIVE = range(3)  # measurement models
AVERAGED, CENTRE = range(2)  # the UKF's variances

OPTIONS: dict[str, Any] = {"fastmath": {"contract"}, "error_model": "numpy"}
TURN, DEGREES = 2.0 * math.pi, 180.0 / math.pi
RHO2_FLOOR, NEAREST = 1e-12, 1e-12  # m^2, m: as in the measurement models
TINY = 1e-300


def kernel(signature: Any) -> Callable[[Callable], Callable]:
    """Compile now, or take it from the cache on disk; without the cache where its folder cannot be
    written.
    """

    def compile_(function: Callable) -> Callable:
        try:
            return njit(signature, cache=True, nogil=True, **OPTIONS)(function)
        except RuntimeError:
            return njit(signature, nogil=True, **OPTIONS)(function)

    return compile_


inlined = njit(forceinline=True, **OPTIONS)

# --------------------------------------------------------------------------------------------------

_A0, _A1, _A2, _A3 = (
    1.0 - 3.3e-17,
    -0.333333333333286125,
    0.199999999988882964,
    -0.142857141834355388,
)
_A4, _A5, _A6, _A7 = (
    0.111111062730520832,
    -0.0909077507849640526,
    0.0768997990214833756,
    -0.0664044937578105326,
)
_A8, _A9, _A10 = 0.0568941176226270065, -0.0435095403193050827, 0.0211690605246042418


@inlined
def arctan(t):
    """atan(t), 0 <= t <= 1; relative error below 5e-16."""
    s = t / (1.0 + math.sqrt(1.0 + t * t))
    u = s * s
    p = _A5 + u * (_A6 + u * (_A7 + u * (_A8 + u * (_A9 + u * _A10))))
    return 2.0 * s * (_A0 + u * (_A1 + u * (_A2 + u * (_A3 + u * (_A4 + u * p)))))


@inlined
def angle(y, x, length):
    """atan2(y, x), where length = hypot(x, y); 0 where both are 0."""
    a = 2.0 * arctan(abs(y) / (length + abs(x) + TINY))
    return math.copysign(a if x >= 0.0 else math.pi - a, y)


@inlined
def wrapped(a):
    """An angle brought into (-pi, pi]."""
    a -= TURN * np.rint(a / TURN)
    return a if a > -math.pi else math.pi


# -------------------------------------------------------------------------------------------- measu


@inlined
def seen_from(x, s, R, out):
    """R (x - s) into out (3, TILE)."""
    for i in range(3):
        for r in range(TILE):
            dx, dy, dz = x[0, r] - s[0, r], x[1, r] - s[1, r], x[2, r] - s[2, r]
            out[i, r] = R[i, 0, r] * dx + R[i, 1, r] * dy + R[i, 2, r] * dz


@inlined
def direction(kind, p, out):
    """What is measured of p (3, TILE) in the anchor's frame: unit vector, or azimuth and elevation."""
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


@inlined
def slopes(kind, p, c, R, out):
    """Derivatives of `direction` by the position, one row after the other, into out (3, 3, TILE)."""
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


@inlined
def variance(kind, l, elevation, nominal, table, out):
    """Variances of component l (TILE,) where the expected elevations are these."""
    if kind == AZEL_ADAPTIVE:
        for r in range(TILE):
            degree = np.rint(elevation[r] * DEGREES + 90.0)
            out[r] = table[int(degree) if 0.0 <= degree <= 180.0 else 90, l]
    else:
        for r in range(TILE):
            out[r] = nominal[r]


@inlined
def innovation(kind, l, y, expected, var, v, W):
    """y - expected, wrapped, and 1 / variance; both 0 where y is not measured (NaN)."""
    for r in range(TILE):
        d = y[r] - expected[r]
        if kind != UNIT_VECTOR and l == 0:
            d = wrapped(d)
        v[r] = 0.0 if math.isnan(y[r]) else d
        W[r] = 0.0 if math.isnan(y[r]) else 1.0 / var[r]


@inlined
def deviation(kind, l, a, b, out):
    """a - b of component l, wrapped."""
    for r in range(TILE):
        d = a[r] - b[r]
        out[r] = wrapped(d) if kind != UNIT_VECTOR and l == 0 else d


# ----------------------------------------------------------------------------------------- linear a


@inlined
def subtract(out, a, b):
    """out -= a b."""
    for r in range(TILE):
        out[r] -= a[r] * b[r]


@inlined
def add(out, a, b):
    """out += a b."""
    for r in range(TILE):
        out[r] += a[r] * b[r]


@inlined
def predict(x, P, F, Q, FP, Fx):
    """x = F x, P = F P F^T + Q."""
    n = len(x)
    for i in range(n):
        Fx[i] = 0.0
        for j in range(n):
            FP[i, j] = 0.0
        for l in range(n):
            f = F[i, l]
            if f != 0.0:
                for r in range(TILE):
                    Fx[i, r] += f * x[l, r]
                for j in range(n):
                    for r in range(TILE):
                        FP[i, j, r] += f * P[l, j, r]
    for i in range(n):
        x[i] = Fx[i]
        for j in range(n):
            P[i, j] = Q[i, j]
            for l in range(n):
                f = F[j, l]
                if f != 0.0:
                    for r in range(TILE):
                        P[i, j, r] += f * FP[i, l, r]


@inlined
def cholesky(A, L):
    """Lower factor of A into L; NaN where A is not positive definite. The diagonal is left as its
    inverse.
    """
    n = len(A)
    for j in range(n):
        L[j, j] = A[j, j]
        for l in range(j):
            subtract(L[j, j], L[j, l], L[j, l])
        for r in range(TILE):
            L[j, j, r] = 1.0 / math.sqrt(L[j, j, r] if L[j, j, r] > 0.0 else math.nan)
        for i in range(j + 1, n):
            L[i, j] = A[i, j]
            for l in range(j):
                subtract(L[i, j], L[i, l], L[j, l])
            for r in range(TILE):
                L[i, j, r] *= L[j, j, r]


@inlined
def transposed(L, out):
    """L^T from what `cholesky` gives."""
    n = len(L)
    for i in range(n):
        for j in range(n):
            if j > i:
                out[i, j] = L[j, i]
            else:
                out[i, j] = 0.0
        for r in range(TILE):
            out[i, i, r] = 1.0 / L[i, i, r]


@inlined
def forward(G, V, b):
    """V = G^-1 V and b = G^-1 b in place, G (m, m) from `cholesky`, V (m, n), b (m,)."""
    m, n = V.shape[0], V.shape[1]
    for i in range(m):
        for j in range(i):
            subtract(b[i], G[i, j], b[j])
            for c in range(n):
                subtract(V[i, c], G[i, j], V[j, c])
        for r in range(TILE):
            b[i, r] *= G[i, i, r]
        for c in range(n):
            for r in range(TILE):
                V[i, c, r] *= G[i, i, r]


@inlined
def conclude(x, P, V, b):
    """x += V^T b, P = V^T V."""
    m, n = V.shape[0], V.shape[1]
    for i in range(n):
        for l in range(m):
            add(x[i], V[l, i], b[l])
        for j in range(i + 1):
            P[i, j] = 0.0
            for l in range(m):
                add(P[i, j], V[l, i], V[l, j])
            if i != j:
                P[j, i] = P[i, j]


# --------------------------------------------------------------------------------------------------


@inlined
def load(source, start, out):
    """out (..., TILE) from the replications start ... of source (R|1, ...); the last one fills up
    the tile.
    """
    last = len(source) - 1
    a, b = out.reshape(-1, TILE), source.reshape(len(source), -1)
    for i in range(len(a)):
        for r in range(TILE):
            a[i, r] = b[min(start + r, last), i]


@inlined
def load_step(source, start, k, c, out):
    """out (TILE,) from component c of step k, as `load` does it."""
    last = len(source) - 1
    for r in range(TILE):
        out[r] = source[min(start + r, last), k, c]


@inlined
def store(x, P, start, k, means, covariances):
    """Position and its covariance at step k."""
    for r in range(min(TILE, len(means) - start)):
        for p in range(3):
            means[start + r, k, p] = x[p, r]
            for q in range(3):
                covariances[start + r, k, p, q] = P[p, q, r]


def given(dimensions: int) -> types.Array:
    """The type of an array of doubles that is only read."""
    return types.Array(types.float64, dimensions, "C", readonly=True)


ARGUMENTS = (
    types.intp,
    *(given(dimensions) for dimensions in (2, 2, 2, 2, 3, 3, 3, 4, 2)),
    types.float64[:, :, ::1],
    types.float64[:, :, :, ::1],
)


@kernel(types.void(*ARGUMENTS))
def ekf(kind, x0, P0, F, Q, Y, quality, position, rotation, table, means, covariances):
    """EKF of each replication: means (R, T, 3) and covariances (R, T, 3, 3) from measurements Y (R,
    T, m).

    x0 (R, n), P0, F, Q (n, n); quality (R, T, m) nominal variances; anchors (R|1, B, ...); `table`
    (181, 2) of variances for AZEL_ADAPTIVE.
    """
    (R, T, m), (B, n) = Y.shape, (position.shape[1], x0.shape[1])
    d = m // B
    x, Fx, b = np.empty((n, TILE)), np.empty((n, TILE)), np.empty((n, TILE))
    P, FP, M, V = (
        np.empty((n, n, TILE)),
        np.empty((n, n, TILE)),
        np.empty((n, n, TILE)),
        np.empty((n, n, TILE)),
    )
    L, G = np.empty((n, n, TILE)), np.empty((n, n, TILE))
    s, rot = np.empty((B, 3, TILE)), np.empty((B, 3, 3, TILE))
    local, c, h = np.empty((3, TILE)), np.empty((3, TILE)), np.empty((3, 3, TILE))
    A, g, AL = np.empty((3, 3, TILE)), np.empty((3, TILE)), np.empty((3, n, TILE))
    y, nominal, var, v, W = (
        np.empty(TILE),
        np.empty(TILE),
        np.empty(TILE),
        np.empty(TILE),
        np.empty(TILE),
    )
    for start in range(0, R, TILE):
        load(x0, start, x)
        load(position, start, s)
        load(rotation, start, rot)
        for i in range(n):
            for j in range(n):
                P[i, j] = P0[i, j]
        for k in range(T):
            predict(x, P, F, Q, FP, Fx)
            A[:] = 0.0
            g[:] = 0.0
            for j in range(B):
                seen_from(x, s[j], rot[j], local)
                direction(kind, local, c)
                slopes(kind, local, c, rot[j], h)
                for l in range(d):
                    load_step(Y, start, k, d * j + l, y)
                    load_step(quality, start, k, d * j + l, nominal)
                    variance(kind, l, c[1], nominal, table, var)
                    innovation(kind, l, y, c[l], var, v, W)
                    for p in range(3):
                        for r in range(TILE):
                            g[p, r] += W[r] * h[l, p, r] * v[r]
                        for q in range(p, 3):
                            for r in range(TILE):
                                A[p, q, r] += W[r] * h[l, p, r] * h[l, q, r]
            cholesky(P, L)
            transposed(L, V)
            for i in range(n):  # b = L^T g, A L, M = I + L^T A L
                b[i] = 0.0
                for p in range(3):
                    add(b[i], V[i, p], g[p])
                    AL[p, i] = 0.0
                    for q in range(3):
                        add(AL[p, i], A[min(p, q), max(p, q)], V[i, q])
            for i in range(n):
                for j in range(i + 1):
                    M[i, j] = 1.0 if i == j else 0.0
                    for p in range(3):
                        add(M[i, j], V[i, p], AL[p, j])
            cholesky(M, G)
            forward(G, V, b)
            conclude(x, P, V, b)
            store(x, P, start, k, means, covariances)


@kernel(types.void(*ARGUMENTS, types.float64, types.intp))
def ukf(
    kind, x0, P0, F, Q, Y, quality, position, rotation, table, means, covariances, lambda_, form
):
    """UKF of each replication with 2 n + 1 sigma points; `form` AVERAGED or CENTRE, the rest as for
    `ekf`.
    """
    (R, T, m), (B, n) = Y.shape, (position.shape[1], x0.shape[1])
    d, S = m // B, 2 * n + 1
    x, Fx = np.empty((n, TILE)), np.empty((n, TILE))
    P, FP, L, Lt = (
        np.empty((n, n, TILE)),
        np.empty((n, n, TILE)),
        np.empty((n, n, TILE)),
        np.empty((n, n, TILE)),
    )
    point, V, b = np.empty((S, n, TILE)), np.empty((S, n, TILE)), np.empty((S, TILE))
    M, G, image, z = (
        np.empty((S, S, TILE)),
        np.empty((S, S, TILE)),
        np.empty((S, 3, TILE)),
        np.empty((S, TILE)),
    )
    s, rot, local = np.empty((B, 3, TILE)), np.empty((B, 3, 3, TILE)), np.empty((3, TILE))
    y, nominal, var, v, W = (
        np.empty(TILE),
        np.empty(TILE),
        np.empty(TILE),
        np.empty(TILE),
        np.empty(TILE),
    )
    one, mean, expected = np.empty(TILE), np.empty(TILE), np.empty(TILE)
    weight = np.full(S, 0.5 / (n + lambda_))
    weight[0] = lambda_ / (n + lambda_)
    root, spread = np.sqrt(weight), math.sqrt(n + lambda_)
    for start in range(0, R, TILE):
        load(x0, start, x)
        load(position, start, s)
        load(rotation, start, rot)
        for i in range(n):
            for j in range(n):
                P[i, j] = P0[i, j]
        for k in range(T):
            predict(x, P, F, Q, FP, Fx)
            cholesky(P, L)
            transposed(L, Lt)
            for i in range(n):
                point[0, i] = x[i]
                V[0, i] = 0.0
                for l in range(n):
                    for r in range(TILE):
                        step = spread * Lt[l, i, r]
                        point[1 + l, i, r], point[1 + n + l, i, r] = x[i, r] + step, x[i, r] - step
                        V[1 + l, i, r], V[1 + n + l, i, r] = root[1] * step, -root[1] * step
            b[:] = 0.0
            M[:] = 0.0
            for i in range(S):
                M[i, i] = 1.0
            for j in range(B):
                for i in range(S):
                    seen_from(point[i], s[j], rot[j], local)
                    direction(kind, local, image[i])
                for l in range(d):
                    load_step(Y, start, k, d * j + l, y)
                    load_step(quality, start, k, d * j + l, nominal)
                    mean[:] = 0.0
                    for i in range(S):
                        deviation(kind, l, image[i, l], image[0, l], z[i])
                        for r in range(TILE):
                            mean[r] += weight[i] * z[i, r]
                    if form == CENTRE or kind != AZEL_ADAPTIVE:
                        variance(kind, l, image[0, 1], nominal, table, var)
                    else:
                        var[:] = 0.0
                        for i in range(S):
                            variance(kind, l, image[i, 1], nominal, table, one)
                            for r in range(TILE):
                                var[r] += weight[i] * one[r]
                    for r in range(TILE):
                        expected[r] = image[0, l, r] + mean[r]
                    innovation(kind, l, y, expected, var, v, W)
                    for i in range(S):
                        for r in range(TILE):
                            z[i, r] = root[i] * (z[i, r] - mean[r])
                    for i in range(S):
                        for r in range(TILE):
                            one[r] = z[i, r] * W[r]
                        add(b[i], one, v)
                        for q in range(i + 1):
                            add(M[i, q], one, z[q])
            cholesky(M, G)
            forward(G, V, b)
            conclude(x, P, V, b)
            store(x, P, start, k, means, covariances)
