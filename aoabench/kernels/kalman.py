"""Kalman filter kernels: EKF and UKF in double precision, vectorised over replications.

The arithmetic of `filters/kalman.py`, written out for states whose first three components are the
position and for the measurement models that are numbered below. Both filters carry a square root of
the covariance. What the measurement says of the position is summed component by component, as
A (3, 3) and g (3,); these amount to three scalar measurements, which shrink the square root.

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
EPS = 2.0**-52
LOST = 32.0 * EPS  # of a diagonal element: what is left of it is rounding
# Rows of w: A and g, the position's factor; an update's T and z
A, G, L, T, Z, ROWS = 0, 6, 9, 15, 24, 27


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


# --- measurement models ---------------------------------------------------------------------------


@inlined
def seen_from(x, s, R, out):
    """R (x - s) into out (3, TILE)."""
    for i in range(3):
        for r in range(TILE):
            dx, dy, dz = x[0, r] - s[0, r], x[1, r] - s[1, r], x[2, r] - s[2, r]
            out[i, r] = R[i, 0, r] * dx + R[i, 1, r] * dy + R[i, 2, r] * dz


@inlined
def direction(kind, p, out):
    """What is measured of p (3, TILE) in the anchor's frame: unit vector or azimuth, elevation."""
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


# --- linear algebra -------------------------------------------------------------------------------


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
def predict(x, root, F, Q, P, FR, Fx):
    """x = F x and the lower half of P = F root (F root)^T + Q, raised so that it has a factor.

    The diagonal grows by more than the sums, and their Cholesky factor, lose in rounding.
    """
    n = len(x)
    raised = 1.0 + 2.0 * n * n * EPS
    for i in range(n):
        Fx[i] = 0.0
        for j in range(n):
            FR[i, j] = 0.0
        for l in range(n):
            f = F[i, l]
            if f != 0.0:
                for r in range(TILE):
                    Fx[i, r] += f * x[l, r]
                for j in range(max(l + 1, 3)):
                    for r in range(TILE):
                        FR[i, j, r] += f * root[l, j, r]
    for i in range(n):
        x[i] = Fx[i]
        for j in range(i + 1):
            P[i, j] = Q[i, j]
            for l in range(n):
                add(P[i, j], FR[i, l], FR[j, l])
        for r in range(TILE):
            P[i, i, r] *= raised


@inlined
def cholesky(P, L):
    """Lower factor of P into L; NaN where P is not positive definite."""
    n = len(P)
    for j in range(n):
        for i in range(j, n):
            L[i, j] = P[i, j]
            for l in range(j):
                subtract(L[i, j], L[i, l], L[j, l])
        for r in range(TILE):
            L[j, j, r] = math.sqrt(L[j, j, r] if L[j, j, r] > 0.0 else math.nan)
        for i in range(j + 1, n):
            for r in range(TILE):
                L[i, j, r] /= L[j, j, r]


@inlined
def eliminate(M, b):
    """M x = b for its last three unknowns: M (7, 7), its lower half, and b (7,) freed from four."""
    for j in range(4):
        for r in range(TILE):
            M[j, j, r] = 1.0 / M[j, j, r]
        for i in range(j + 1, 7):
            for r in range(TILE):
                b[i, r] -= M[i, j, r] * M[j, j, r] * b[j, r]
            for l in range(j + 1, i + 1):
                for r in range(TILE):
                    M[i, l, r] -= M[i, j, r] * M[j, j, r] * M[l, j, r]


@inlined
def turned(h, M):
    """M^T h with M (9,) row by row."""
    return (
        M[0] * h[0] + M[3] * h[1] + M[6] * h[2],
        M[1] * h[0] + M[4] * h[1] + M[7] * h[2],
        M[2] * h[0] + M[5] * h[1] + M[8] * h[2],
    )


@inlined
def swapped(swap, a, b):
    """(b, a) if `swap`, else (a, b)."""
    return b if swap else a, a if swap else b


@inlined
def inverse_root(p, least):
    """1 / sqrt(p); 0 where p is not above `least`."""
    return 1.0 / math.sqrt(math.inf if p <= least else p)


@inlined
def back(first, second, third, c):
    """c (3,) with the swaps undone."""
    x, y, z = c
    y, z = swapped(third, y, z)
    x, z = swapped(second, x, z)
    x, y = swapped(first, x, y)
    return x, y, z


@inlined
def columns(w, r):
    """c0, u0, c1, u1, c2, u2 with A = sum c c^T and g = sum u c: three scalar measurements, c (3,).

    A Cholesky factor of A, the largest pivot first. A pivot that is lost in the rounding of A's
    diagonal is no information: its column is 0.
    """
    a00, a10, a11 = w[A, r], w[A + 1, r], w[A + 2, r]
    a20, a21, a22 = w[A + 3, r], w[A + 4, r], w[A + 5, r]
    g0, g1, g2 = w[G, r], w[G + 1, r], w[G + 2, r]
    first = a11 > a00
    a00, a11 = swapped(first, a00, a11)
    a20, a21 = swapped(first, a20, a21)
    g0, g1 = swapped(first, g0, g1)
    second = a22 > a00
    a00, a22 = swapped(second, a00, a22)
    a10, a21 = swapped(second, a10, a21)
    g0, g2 = swapped(second, g0, g2)
    i = inverse_root(a00, 0.0)
    x0, y0, z0, u0 = a00 * i, a10 * i, a20 * i, g0 * i
    b11, b21, b22 = a11 - y0 * y0, a21 - y0 * z0, a22 - z0 * z0
    g1, g2 = g1 - y0 * u0, g2 - z0 * u0
    third = b22 > b11
    a11, a22 = swapped(third, a11, a22)
    b11, b22 = swapped(third, b11, b22)
    y0, z0 = swapped(third, y0, z0)
    g1, g2 = swapped(third, g1, g2)
    i = inverse_root(b11, LOST * a11)
    y1, z1, u1 = b11 * i, b21 * i, g1 * i
    b22, g2 = b22 - z1 * z1, g2 - z1 * u1
    i = inverse_root(b22, LOST * a22)
    c0 = back(first, second, third, (x0, y0, z0))
    c1 = back(first, second, third, (0.0, y1, z1))
    c2 = back(first, second, third, (0.0, 0.0, b22 * i))
    return c0, u0, c1, u1, c2, g2 * i


@inlined
def absorb(M, z, h, u):
    """M and z after one more measurement u = h^T z + e, e ~ N(0, 1), in Potter's form.

    z ~ N(z, M M^T), M (9,) row by row. With f = M^T h and s = 1 + f^T f, z += M f (u - h^T z) / s
    and M -= M f f^T / (s + sqrt(s)), which shrinks M and never more than to 0.
    """
    f = turned(h, M)
    s = 1.0 + f[0] * f[0] + f[1] * f[1] + f[2] * f[2]
    t = math.sqrt(s)
    k = 1.0 / (s + t)
    a = M[0] * f[0] + M[1] * f[1] + M[2] * f[2]
    b = M[3] * f[0] + M[4] * f[1] + M[5] * f[2]
    c = M[6] * f[0] + M[7] * f[1] + M[8] * f[2]
    e = k * (1.0 + t)  # 1 / sqrt(s)
    e *= e * (u - h[0] * z[0] - h[1] * z[1] - h[2] * z[2])
    z = z[0] + a * e, z[1] + b * e, z[2] + c * e
    a, b, c = k * a, k * b, k * c
    row0 = M[0] - a * f[0], M[1] - a * f[1], M[2] - a * f[2]
    row1 = M[3] - b * f[0], M[4] - b * f[1], M[5] - b * f[2]
    row2 = M[6] - c * f[0], M[7] - c * f[1], M[8] - c * f[2]
    return (*row0, *row1, *row2), z


@inlined
def update(w):
    """T (3, 3) and z (3,): A and g turn x into x + L z and the factor L of P_pp into L T."""
    for r in range(TILE):
        l00, l10, l11 = w[L, r], w[L + 1, r], w[L + 2, r]
        l20, l21, l22 = w[L + 3, r], w[L + 4, r], w[L + 5, r]
        c0, u0, c1, u1, c2, u2 = columns(w, r)
        M, z = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0), (0.0, 0.0, 0.0)
        h = l00 * c0[0] + l10 * c0[1] + l20 * c0[2], l11 * c0[1] + l21 * c0[2], l22 * c0[2]
        M, z = absorb(M, z, h, u0)
        h = l00 * c1[0] + l10 * c1[1] + l20 * c1[2], l11 * c1[1] + l21 * c1[2], l22 * c1[2]
        M, z = absorb(M, z, h, u1)
        h = l00 * c2[0] + l10 * c2[1] + l20 * c2[2], l11 * c2[1] + l21 * c2[2], l22 * c2[2]
        M, z = absorb(M, z, h, u2)
        w[T, r], w[T + 1, r], w[T + 2, r] = M[0], M[1], M[2]
        w[T + 3, r], w[T + 4, r], w[T + 5, r] = M[3], M[4], M[5]
        w[T + 6, r], w[T + 7, r], w[T + 8, r] = M[6], M[7], M[8]
        w[Z, r], w[Z + 1, r], w[Z + 2, r] = z[0], z[1], z[2]


@inlined
def conclude(x, root, w):
    """x += L_:p z and L_:p = L_:p T; the other columns of the factor stay."""
    for i in range(len(x)):
        for r in range(TILE):
            a = root[i, 0, r]
            b, c = root[i, 1, r] if i > 0 else 0.0, root[i, 2, r] if i > 1 else 0.0
            x[i, r] += a * w[Z, r] + b * w[Z + 1, r] + c * w[Z + 2, r]
            root[i, 0, r] = a * w[T, r] + b * w[T + 3, r] + c * w[T + 6, r]
            root[i, 1, r] = a * w[T + 1, r] + b * w[T + 4, r] + c * w[T + 7, r]
            root[i, 2, r] = a * w[T + 2, r] + b * w[T + 5, r] + c * w[T + 8, r]


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
def store(x, root, start, k, means, covariances):
    """Position and its covariance at step k; its diagonal raised, as in `predict`."""
    for r in range(min(TILE, len(means) - start)):
        for p in range(3):
            means[start + r, k, p] = x[p, r]
            for q in range(p + 1):
                c = root[p, 0, r] * root[q, 0, r] + root[p, 1, r] * root[q, 1, r]
                c += root[p, 2, r] * root[q, 2, r]
                covariances[start + r, k, p, q] = covariances[start + r, k, q, p] = c
            covariances[start + r, k, p, p] *= 1.0 + 18.0 * EPS


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
def ekf(kind, x0, root0, F, Q, Y, quality, position, rotation, table, means, covariances):
    """EKF of each replication: means (R, T, 3) and covariances (R, T, 3, 3) from measurements Y (R,
    T, m).

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
                root[i, j] = root0[i, j]
        for k in range(steps):
            predict(x, root, F, Q, P, FR, Fx)
            cholesky(P, root)
            w[A : G + 3] = 0.0
            for j in range(B):
                seen_from(x, s[j], rot[j], local)
                direction(kind, local, c)
                slopes(kind, local, c, rot[j], h)
                for l in range(d):
                    load_step(Y, start, k, d * j + l, y)
                    load_step(quality, start, k, d * j + l, nominal)
                    variance(kind, l, c[1], nominal, table, var)
                    innovation(kind, l, y, c[l], var, v, W)
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
            update(w)
            conclude(x, root, w)
            store(x, root, start, k, means, covariances)


@kernel(types.void(*ARGUMENTS, types.float64, types.intp))
def ukf(
    kind, x0, root0, F, Q, Y, quality, position, rotation, table, means, covariances, lambda_, form
):
    """UKF of each replication with 2 n + 1 sigma points; `form` AVERAGED or CENTRE, the rest as for
    `ekf`.

    Seven points are computed: the others differ from the centre in no position and count with it.
    Each pair of points gives a half sum and a half difference. Only the differences deviate in the
    state, and the update of the state is what remains of the equations without the others.
    """
    (R, steps, m), (B, n) = Y.shape, (position.shape[1], x0.shape[1])
    d = m // B
    x, Fx, w = np.empty((n, TILE)), np.empty((n, TILE)), np.empty((ROWS, TILE))
    P, FR, root = np.empty((n, n, TILE)), np.empty((n, n, TILE)), np.empty((n, n, TILE))
    point, image, z = np.empty((7, 3, TILE)), np.empty((7, 3, TILE)), np.empty((7, TILE))
    M, b = np.empty((7, 7, TILE)), np.empty((7, TILE))
    s, rot, local = np.empty((B, 3, TILE)), np.empty((B, 3, 3, TILE)), np.empty((3, TILE))
    y, nominal, var, v, W = (
        np.empty(TILE),
        np.empty(TILE),
        np.empty(TILE),
        np.empty(TILE),
        np.empty(TILE),
    )
    one, mean, expected = np.empty(TILE), np.empty(TILE), np.empty(TILE)
    each, spread = 0.5 / (n + lambda_), math.sqrt(n + lambda_)
    centre = (lambda_ + n - 3.0) / (n + lambda_)
    half, still = math.sqrt(0.5 * each), math.sqrt(centre)
    for start in range(0, R, TILE):
        load(x0, start, x)
        load(position, start, s)
        load(rotation, start, rot)
        for i in range(n):
            for j in range(n):
                root[i, j] = root0[i, j]
        for k in range(steps):
            predict(x, root, F, Q, P, FR, Fx)
            cholesky(P, root)
            for i in range(3):
                point[0, i] = x[i]
                for l in range(3):
                    for r in range(TILE):
                        step = spread * root[i, l, r] if l <= i else 0.0
                        point[1 + l, i, r], point[4 + l, i, r] = x[i, r] + step, x[i, r] - step
            b[:] = 0.0
            M[:] = 0.0
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
                    for i in range(7):
                        for r in range(TILE):
                            one[r] = z[i, r] * W[r]
                        add(b[i], one, v)
                        for q in range(i + 1):
                            add(M[i, q], one, z[q])
            eliminate(M, b)
            for i in range(3):
                w[G + i] = b[4 + i]
                for j in range(i + 1):
                    w[A + i * (i + 1) // 2 + j] = M[4 + i, 4 + j]
                    w[L + i * (i + 1) // 2 + j] = 1.0 if i == j else 0.0
            update(w)
            conclude(x, root, w)
            store(x, root, start, k, means, covariances)
