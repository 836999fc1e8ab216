"""Kernel of the EKF at access nodes (ANs): double precision, `TILE` replications at once.

The arithmetic of `filters/access_nodes.py`. The last axis of every array is the replications;
innermost loops run over them, of constant length and without calls. Eight are few: the compiler
unrolls such loops instead of vectorising them. With sixteen it vectorises and a step takes 0.6 of
the time, but a tile of measurements at a hundred ANs then takes twice the memory.

Kernels may use nothing but this file: the cache on disk sees only its own.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numba import njit, types

TILE = 8

OPTIONS: dict[str, Any] = {"fastmath": {"contract"}, "error_model": "numpy"}
TURN = 2.0 * math.pi
RHO2_FLOOR = 1e-12  # m^2, as in access_nodes
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
    """An angle brought into [-pi, pi]."""
    return a - TURN * np.rint(a / TURN)


@inlined
def expected(x, s, R, jacobian, h, H):
    """Range, azimuth, elevation h (3, TILE) at positions x (n, TILE) and their derivatives H (3, 3,
    TILE).
    """
    for r in range(TILE):
        dx, dy, dz = x[0, r] - s[0, r], x[1, r] - s[1, r], x[2, r] - s[2, r]
        u = R[0, 0] * dx + R[0, 1] * dy + R[0, 2] * dz
        v = R[1, 0] * dx + R[1, 1] * dy + R[1, 2] * dz
        w = R[2, 0] * dx + R[2, 1] * dy + R[2, 2] * dz
        rho2 = max(u * u + v * v, RHO2_FLOOR)
        rho, d2 = math.sqrt(rho2), rho2 + w * w
        d = math.sqrt(d2)
        h[0, r], h[1, r], h[2, r] = d, angle(v, u, rho), angle(w, rho, d)
        ia = 1.0 / (rho if jacobian else rho2)
        ie = 1.0 / (rho2 if jacobian else d2)
        t = w * ie if jacobian else w / rho * ie
        for q in range(3):
            H[0, q, r] = (R[0, q] * u + R[1, q] * v + R[2, q] * w) / d
            H[1, q, r] = (R[1, q] * u - R[0, q] * v) * ia
            H[2, q, r] = R[2, q] * rho * ie - (R[0, q] * u + R[1, q] * v) * t


@inlined
def accumulate(first, last, H, v, S, A, g):
    """A += H^T S^-1 H and g += H^T S^-1 v over the rows first ... last-1 of one AN; S in place
    becomes its factor.

    A square-root-free Cholesky factor: rows are freed from those before them and then divided by
    their pivot.
    """
    for i in range(first, last):
        for j in range(first, i):
            for r in range(TILE):
                f = S[i, j, r] / S[j, j, r]
                v[i, r] -= f * v[j, r]
                for q in range(3):
                    H[i, q, r] -= f * H[j, q, r]
                for l in range(i, last):
                    S[l, i, r] -= f * S[l, j, r]
    for i in range(first, last):
        for r in range(TILE):
            f = 1.0 / S[i, i, r]
            for p in range(3):
                a = f * H[i, p, r]
                g[p, r] += a * v[i, r]
                for q in range(p + 1):
                    A[p, q, r] += a * H[i, q, r]


@inlined
def spread(A, g, C):
    """A (I + C A)^-1 and (I + A C)^-1 g in place: one more error of the position with variances C
    (3,).
    """
    for r in range(TILE):
        a, b, c, d, e, f = A[0, 0, r], A[1, 0, r], A[1, 1, r], A[2, 0, r], A[2, 1, r], A[2, 2, r]
        m00, m01, m02 = 1.0 + a * C[0], b * C[1], d * C[2]
        m10, m11, m12 = b * C[0], 1.0 + c * C[1], e * C[2]
        m20, m21, m22 = d * C[0], e * C[1], 1.0 + f * C[2]
        i00, i01, i02 = m11 * m22 - m12 * m21, m02 * m21 - m01 * m22, m01 * m12 - m02 * m11
        i10, i11, i12 = m12 * m20 - m10 * m22, m00 * m22 - m02 * m20, m02 * m10 - m00 * m12
        i20, i21, i22 = m10 * m21 - m11 * m20, m01 * m20 - m00 * m21, m00 * m11 - m01 * m10
        s = 1.0 / (m00 * i00 + m01 * i10 + m02 * i20)
        A[0, 0, r] = s * (i00 * a + i01 * b + i02 * d)
        A[1, 0, r] = s * (i10 * a + i11 * b + i12 * d)
        A[1, 1, r] = s * (i10 * b + i11 * c + i12 * e)
        A[2, 0, r] = s * (i20 * a + i21 * b + i22 * d)
        A[2, 1, r] = s * (i20 * b + i21 * c + i22 * e)
        A[2, 2, r] = s * (i20 * d + i21 * e + i22 * f)
        x, y, z = g[0, r], g[1, r], g[2, r]
        g[0, r] = s * (i00 * x + i01 * y + i02 * z)
        g[1, r] = s * (i10 * x + i11 * y + i12 * z)
        g[2, r] = s * (i20 * x + i21 * y + i22 * z)


@inlined
def update(x, P, A, g, W, b):
    """x += P_:p (I + A P_pp)^-1 g and P -= P_:p (I + A P_pp)^-1 A P_p:, with the lower half of A
    (3, 3, TILE).
    """
    for r in range(TILE):
        a, c, e = A[0, 0, r], A[1, 1, r], A[2, 2, r]
        f, h, i = A[1, 0, r], A[2, 0, r], A[2, 1, r]
        p00, p10, p11, p20, p21, p22 = (
            P[0, 0, r],
            P[1, 0, r],
            P[1, 1, r],
            P[2, 0, r],
            P[2, 1, r],
            P[2, 2, r],
        )
        m00, m01, m02 = (
            1.0 + a * p00 + f * p10 + h * p20,
            a * p10 + f * p11 + h * p21,
            a * p20 + f * p21 + h * p22,
        )
        m10, m11, m12 = (
            f * p00 + c * p10 + i * p20,
            1.0 + f * p10 + c * p11 + i * p21,
            f * p20 + c * p21 + i * p22,
        )
        m20, m21, m22 = (
            h * p00 + i * p10 + e * p20,
            h * p10 + i * p11 + e * p21,
            1.0 + h * p20 + i * p21 + e * p22,
        )
        i00, i01, i02 = m11 * m22 - m12 * m21, m02 * m21 - m01 * m22, m01 * m12 - m02 * m11
        i10, i11, i12 = m12 * m20 - m10 * m22, m00 * m22 - m02 * m20, m02 * m10 - m00 * m12
        i20, i21, i22 = m10 * m21 - m11 * m20, m01 * m20 - m00 * m21, m00 * m11 - m01 * m10
        s = 1.0 / (m00 * i00 + m01 * i10 + m02 * i20)
        W[0, 0, r] = s * (i00 * a + i01 * f + i02 * h)
        W[1, 0, r] = s * (i10 * a + i11 * f + i12 * h)
        W[1, 1, r] = s * (i10 * f + i11 * c + i12 * i)
        W[2, 0, r] = s * (i20 * a + i21 * f + i22 * h)
        W[2, 1, r] = s * (i20 * f + i21 * c + i22 * i)
        W[2, 2, r] = s * (i20 * h + i21 * i + i22 * e)
        u, v, w = g[0, r], g[1, r], g[2, r]
        b[0, r] = s * (i00 * u + i01 * v + i02 * w)
        b[1, r] = s * (i10 * u + i11 * v + i12 * w)
        b[2, r] = s * (i20 * u + i21 * v + i22 * w)


@inlined
def conclude(x, P, W, b, column, moved):
    """The rest of `update`; column (n, 3, TILE) keeps P_:p, moved (3, TILE) is scratch."""
    n = len(x)
    for i in range(n):
        for q in range(3):
            for r in range(TILE):
                column[i, q, r] = P[i, q, r]
    for i in range(n):
        for r in range(TILE):
            u, v, w = column[i, 0, r], column[i, 1, r], column[i, 2, r]
            x[i, r] += u * b[0, r] + v * b[1, r] + w * b[2, r]
            moved[0, r] = u * W[0, 0, r] + v * W[1, 0, r] + w * W[2, 0, r]
            moved[1, r] = u * W[1, 0, r] + v * W[1, 1, r] + w * W[2, 1, r]
            moved[2, r] = u * W[2, 0, r] + v * W[2, 1, r] + w * W[2, 2, r]
        for j in range(i + 1):
            for r in range(TILE):
                d = (
                    moved[0, r] * column[j, 0, r]
                    + moved[1, r] * column[j, 1, r]
                    + moved[2, r] * column[j, 2, r]
                )
                P[i, j, r] -= d
        for j in range(i):
            for r in range(TILE):
                P[j, i, r] = P[i, j, r]


@inlined
def predict(x, P, F, Q, FP, Fx):
    """x = F x, P = F P F^T + Q."""
    n = len(x)
    for i in range(n):
        for r in range(TILE):
            Fx[i, r] = 0.0
        for j in range(n):
            for r in range(TILE):
                FP[i, j, r] = 0.0
        for l in range(n):
            f = F[i, l]
            if f != 0.0:
                for r in range(TILE):
                    Fx[i, r] += f * x[l, r]
                for j in range(n):
                    for r in range(TILE):
                        FP[i, j, r] += f * P[l, j, r]
    for i in range(n):
        for r in range(TILE):
            x[i, r] = Fx[i, r]
        for j in range(i + 1):
            for r in range(TILE):
                P[i, j, r] = Q[i, j]
            for l in range(n):
                f = F[j, l]
                if f != 0.0:
                    for r in range(TILE):
                        P[i, j, r] += f * FP[i, l, r]
            for r in range(TILE):
                P[j, i, r] = P[i, j, r]


def given(dimensions: int, dtype: Any = types.float64) -> types.Array:
    """The type of an array that is only read."""
    return types.Array(dtype, dimensions, "C", readonly=True)


@kernel(
    types.void(
        *(given(d) for d in (2, 2, 2, 2, 4, 4)), given(2, types.int64), *(given(d) for d in (3, 3, 2)),
        *[types.boolean] * 4, types.float64[:, :, ::1], types.float64[:, :, :, ::1],
    )
)  # fmt: skip
def ekf(
    x0,
    P0,
    F,
    Q,
    Y,
    q,
    heard,
    position,
    rotation,
    C,
    jacobian,
    unwrapped,
    shared,
    apart,
    means,
    covariances,
):
    """EKF of replications: means (R, T, 3) and covariances (R, T, 3, 3) from Y, q (R, T, K, 3), R
    at most TILE.

    x0 (R, n), P0, F, Q (n, n); `heard` (T, K) names the ANs of each step, -1 for none; position (R,
    B, 3), rotation (B, 3, 3); C (B, 3) variances of the ANs' positions. The flags run errata as
    printed.
    """
    (T, K), (R, n) = heard.shape, x0.shape
    last = R - 1
    x, Fx = np.empty((n, TILE)), np.empty((n, TILE))
    P, FP, column = np.empty((n, n, TILE)), np.empty((n, n, TILE)), np.empty((n, 3, TILE))
    s, h, v, H, S = (
        np.empty((3, TILE)),
        np.empty((3, TILE)),
        np.empty((3, TILE)),
        np.empty((3, 3, TILE)),
        np.empty((3, 3, TILE)),
    )
    A, g, W, b = (
        np.empty((3, 3, TILE)),
        np.empty((3, TILE)),
        np.empty((3, 3, TILE)),
        np.empty((3, TILE)),
    )
    A2, g2, moved = np.empty((3, 3, TILE)), np.empty((3, TILE)), np.empty((3, TILE))
    for i in range(n):
        for r in range(TILE):
            x[i, r] = x0[min(r, last), i]
        for j in range(n):
            for r in range(TILE):
                P[i, j, r] = P0[i, j]
    for k in range(T):
        predict(x, P, F, Q, FP, Fx)
        A[:] = 0.0
        g[:] = 0.0
        A2[:] = 0.0
        g2[:] = 0.0
        for m in range(K):
            a = heard[k, m]
            if a < 0:
                break
            for i in range(3):
                for r in range(TILE):
                    s[i, r] = position[min(r, last), a, i]
            expected(x, s, rotation[a], jacobian, h, H)
            ahead, left = rotation[a, 0, 0], rotation[a, 0, 1]
            turn = angle(left, ahead, math.sqrt(ahead * ahead + left * left)) if unwrapped else 0.0
            for i in range(3):
                for r in range(TILE):
                    y = Y[min(r, last), k, m, i]
                    d = y - h[i, r]
                    if i == 1:
                        d = wrapped(y + turn) - wrapped(h[i, r] + turn) if unwrapped else wrapped(d)
                    known = not math.isnan(y)
                    v[i, r] = d if known else 0.0
                    S[i, i, r] = q[min(r, last), k, m, i] if known else 1.0
                    for p in range(3):
                        H[i, p, r] = H[i, p, r] if known else 0.0
            for i in range(3):
                for j in range(i + 1):
                    for r in range(TILE):
                        c = 0.0
                        if not shared and not (apart and i != j and j == 0):
                            c = (
                                H[i, 0, r] * H[j, 0, r] * C[a, 0]
                                + H[i, 1, r] * H[j, 1, r] * C[a, 1]
                            )
                            c += H[i, 2, r] * H[j, 2, r] * C[a, 2]
                        S[i, j, r] = S[i, j, r] + c if i == j else c
            if shared and apart:
                accumulate(0, 1, H, v, S, A2, g2)
                accumulate(1, 3, H, v, S, A, g)
            else:
                accumulate(0, 3, H, v, S, A, g)
        if shared:
            spread(A, g, C[0])
            if apart:
                spread(A2, g2, C[0])
                for i in range(3):
                    for r in range(TILE):
                        g[i, r] += g2[i, r]
                    for j in range(3):
                        for r in range(TILE):
                            A[i, j, r] += A2[i, j, r]
        update(x, P, A, g, W, b)
        conclude(x, P, W, b, column, moved)
        for r in range(R):
            for i in range(3):
                means[r, k, i] = x[i, r]
                for j in range(3):
                    covariances[r, k, i, j] = P[i, j, r]


def run(mean, P, F, Q, y, q, heard, anchors, C, flags):
    """Tile by tile: positions (R, T, 3) and covariances (R, T, 3, 3)."""
    R, T = y.shape[:2]
    places, rotation = anchors.frames
    places = np.broadcast_to(places, (R, *places.shape[1:]))
    position, covariance = np.empty((R, T, 3)), np.empty((R, T, 3, 3))
    # a tile shares orientations and stated deviations: where these differ it is one replication
    size = TILE if len(rotation) == len(C) == 1 else 1
    for start in range(0, R, size):
        of = slice(start, min(start + size, R))
        turned, known = (a[start if len(a) > 1 else 0] for a in (rotation, C))
        first = [np.ascontiguousarray(a, dtype=float) for a in (mean[of], P, F, Q, y[of], q[of])]
        more = [np.ascontiguousarray(a, dtype=float) for a in (places[of], turned, known)]
        ekf(*first, np.ascontiguousarray(heard), *more, *flags, position[of], covariance[of])
    return position, covariance
