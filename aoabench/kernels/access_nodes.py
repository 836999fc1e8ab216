"""Kernel of the EKF at access nodes (ANs): double precision, `TILE` replications at once.

The arithmetic of `filters/access_nodes.py`. The last axis of every array is the replications; the
innermost loops run over them and call nothing. The compiler vectorises a loop of eight only where
it sees that its arrays do not overlap. So what an update needs lies in the rows of one array `w`,
and all the work on one AN is one loop.

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
EPS = 2.0**-52
LOST = 32.0 * EPS  # of a diagonal element: what is left of it is rounding
# Rows of w: position, AN's position, measured, their variances; A and g of all and of the times
# alone; the position's factor; an update's T and z
X, S, Y, V, A, A2, L, T, Z, ROWS = 0, 3, 6, 9, 12, 21, 30, 36, 45, 48


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
def expected(u, v, w, jacobian):
    """Range, azimuth, elevation at (u, v, w) in the AN's frame and the derivatives of each."""
    rho2 = max(u * u + v * v, RHO2_FLOOR)
    rho, d2 = math.sqrt(rho2), rho2 + w * w
    d = math.sqrt(d2)
    i, j, k = 1.0 / d, 1.0 / (rho if jacobian else rho2), 1.0 / (rho2 if jacobian else d2)
    t = w * k if jacobian else w / rho * k
    h = d, angle(v, u, rho), angle(w, rho, d)
    return h, (u * i, v * i, w * i), (-v * j, u * j, 0.0), (-u * t, -v * t, rho * k)


@inlined
def turned(h, M):
    """M^T h with M (9,) row by row."""
    return (
        M[0] * h[0] + M[3] * h[1] + M[6] * h[2],
        M[1] * h[0] + M[4] * h[1] + M[7] * h[2],
        M[2] * h[0] + M[5] * h[1] + M[8] * h[2],
    )


@inlined
def measured(y, d, q, h):
    """Residual, variance and derivatives of a component; 0, 1 and 0 where its y is NaN."""
    if math.isnan(y):
        return 0.0, 1.0, (0.0, 0.0, 0.0)
    return d, q, h


@inlined
def product(a, C, b):
    """a^T diag(C) b."""
    return a[0] * C[0] * b[0] + a[1] * C[1] * b[1] + a[2] * C[2] * b[2]


@inlined
def less(f, d, h, e, k):
    """d - f e and h - f k: a row of the measurement, less another one."""
    return d - f * e, (h[0] - f * k[0], h[1] - f * k[1], h[2] - f * k[2])


@inlined
def add(w, a, r, f, d, h):
    """A += f h h^T and g += f h d, in the rows a ... of w."""
    x, y, z = f * h[0], f * h[1], f * h[2]
    w[a, r] += x * h[0]
    w[a + 1, r] += y * h[0]
    w[a + 2, r] += y * h[1]
    w[a + 3, r] += z * h[0]
    w[a + 4, r] += z * h[1]
    w[a + 5, r] += z * h[2]
    w[a + 6, r] += x * d
    w[a + 7, r] += y * d
    w[a + 8, r] += z * d


@inlined
def observe(w, R, c, turn, jacobian, unwrapped, linked, first):
    """A += H^T S^-1 H, g += H^T S^-1 v of one AN; what its time says goes to the rows `first` ...

    R (3, 3) is its rotation, c (3,) are the variances of its position; `linked` is 0 where its time
    and angles are to be independent. The rows of H and v are freed from those before them and then
    divided by their pivot.
    """
    M = R[0, 0], R[0, 1], R[0, 2], R[1, 0], R[1, 1], R[1, 2], R[2, 0], R[2, 1], R[2, 2]
    C = c[0], c[1], c[2]
    for r in range(TILE):
        x, y, z = w[X, r] - w[S, r], w[X + 1, r] - w[S + 1, r], w[X + 2, r] - w[S + 2, r]
        h, hd, ha, he = expected(
            M[0] * x + M[1] * y + M[2] * z,
            M[3] * x + M[4] * y + M[5] * z,
            M[6] * x + M[7] * y + M[8] * z,
            jacobian,
        )
        d, a, e = w[Y, r] - h[0], w[Y + 1, r] - h[1], w[Y + 2, r] - h[2]
        a = wrapped(w[Y + 1, r] + turn) - wrapped(h[1] + turn) if unwrapped else wrapped(a)
        d, sd, hd = measured(w[Y, r], d, w[V, r], turned(hd, M))
        a, sa, ha = measured(w[Y + 1, r], a, w[V + 1, r], turned(ha, M))
        e, se, he = measured(w[Y + 2, r], e, w[V + 2, r], turned(he, M))
        sd, sa, se = sd + product(hd, C, hd), sa + product(ha, C, ha), se + product(he, C, he)
        ad, ed, ea = linked * product(ha, C, hd), linked * product(he, C, hd), product(he, C, ha)
        i = 1.0 / sd
        f, k = ad * i, ed * i
        a, ha = less(f, a, ha, d, hd)
        e, he = less(k, e, he, d, hd)
        sa, ea, se = sa - f * ad, ea - f * ed, se - k * ed
        j = 1.0 / sa
        f = ea * j
        e, he = less(f, e, he, a, ha)
        add(w, first, r, i, d, hd)
        add(w, A, r, j, a, ha)
        add(w, A, r, 1.0 / (se - f * ea), e, he)


@inlined
def predict(x, root, F, Q, P, FR, Fx):
    """x = F x and the lower half of P = F root (F root)^T + Q, raised so that it has a factor.

    The diagonal grows by more than the sums, and their Cholesky factor, lose in rounding.
    """
    n = len(x)
    raised = 1.0 + 2.0 * n * n * EPS
    for i in range(n):
        for r in range(TILE):
            Fx[i, r] = 0.0
        for j in range(n):
            for r in range(TILE):
                FR[i, j, r] = 0.0
        for l in range(n):
            f = F[i, l]
            if f != 0.0:
                for r in range(TILE):
                    Fx[i, r] += f * x[l, r]
                for j in range(max(l + 1, 3)):
                    for r in range(TILE):
                        FR[i, j, r] += f * root[l, j, r]
    for i in range(n):
        for r in range(TILE):
            x[i, r] = Fx[i, r]
        for j in range(i + 1):
            for r in range(TILE):
                P[i, j, r] = Q[i, j]
            for l in range(n):
                for r in range(TILE):
                    P[i, j, r] += FR[i, l, r] * FR[j, l, r]
        for r in range(TILE):
            P[i, i, r] *= raised


@inlined
def cholesky(P, L):
    """Lower factor of P into L; NaN where P is not positive definite."""
    n = len(P)
    for j in range(n):
        for i in range(j, n):
            for r in range(TILE):
                L[i, j, r] = P[i, j, r]
            for l in range(j):
                for r in range(TILE):
                    L[i, j, r] -= L[i, l, r] * L[j, l, r]
        for r in range(TILE):
            L[j, j, r] = math.sqrt(L[j, j, r] if L[j, j, r] > 0.0 else math.nan)
        for i in range(j + 1, n):
            for r in range(TILE):
                L[i, j, r] /= L[j, j, r]


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
def columns(w, a, r):
    """c0, u0, c1, u1, c2, u2 with A = sum c c^T and g = sum u c: three scalar measurements, c (3,).

    A Cholesky factor of A, the largest pivot first. A pivot that is lost in the rounding of A's
    diagonal is no information: its column is 0.
    """
    a00, a10, a11 = w[a, r], w[a + 1, r], w[a + 2, r]
    a20, a21, a22 = w[a + 3, r], w[a + 4, r], w[a + 5, r]
    g0, g1, g2 = w[a + 6, r], w[a + 7, r], w[a + 8, r]
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
        c0, u0, c1, u1, c2, u2 = columns(w, A, r)
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
def common(w, a, C):
    """A (I + C A)^-1, (I + A C)^-1 g in place: one more error of the position with variances C.

    A and g lie in the rows a ... of w. With A = c c^T, g = c u and sqrt(C) c = f, these become
    c M M^T c^T and c M M^T u, where M is the root of (I + f^T f)^-1.
    """
    s0, s1, s2 = math.sqrt(C[0]), math.sqrt(C[1]), math.sqrt(C[2])
    for r in range(TILE):
        c0, u0, c1, u1, c2, u2 = columns(w, a, r)
        M, z = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0), (0.0, 0.0, 0.0)
        M, z = absorb(M, z, (s0 * c0[0], s0 * c1[0], s0 * c2[0]), 0.0)
        M, z = absorb(M, z, (s1 * c0[1], s1 * c1[1], s1 * c2[1]), 0.0)
        M, z = absorb(M, z, (s2 * c0[2], s2 * c1[2], s2 * c2[2]), 0.0)
        u = turned((u0, u1, u2), M)
        x = turned((c0[0], c1[0], c2[0]), M)
        y = turned((c0[1], c1[1], c2[1]), M)
        z = turned((c0[2], c1[2], c2[2]), M)
        for i in range(9):
            w[a + i, r] = 0.0
        add(w, a, r, 1.0, u[0], (x[0], y[0], z[0]))
        add(w, a, r, 1.0, u[1], (x[1], y[1], z[1]))
        add(w, a, r, 1.0, u[2], (x[2], y[2], z[2]))


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


@inlined
def store(x, root, k, means, covariances):
    """Position and its covariance at step k; its diagonal raised, as in `predict`."""
    for r in range(len(means)):
        for i in range(3):
            means[r, k, i] = x[i, r]
            for j in range(i + 1):
                p = root[i, 0, r] * root[j, 0, r] + root[i, 1, r] * root[j, 1, r]
                p += root[i, 2, r] * root[j, 2, r]
                covariances[r, k, i, j] = covariances[r, k, j, i] = p
            covariances[r, k, i, i] *= 1.0 + 18.0 * EPS


def given(dimensions: int, dtype: Any = types.float64) -> types.Array:
    """The type of an array that is only read."""
    return types.Array(dtype, dimensions, "C", readonly=True)


@kernel(
    types.void(
        *(given(d) for d in (2, 2, 2, 2, 4, 4)), given(2, types.int64),
        *(given(d) for d in (3, 3, 2)), *[types.boolean] * 4,
        types.float64[:, :, ::1], types.float64[:, :, :, ::1],
    )
)  # fmt: skip
def ekf(
    x0,
    root0,
    F,
    Q,
    y,
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
    """EKF of replications: means (R, T, 3) and covariances (R, T, 3, 3) from y, q (R, T, K, 3), R
    at most TILE.

    x0 (R, n), root0, F, Q (n, n), where root0 is a lower factor of the prior's covariance; `heard`
    (T, K) names the ANs of each step, -1 for none; position (R, B, 3), rotation (B, 3, 3); C (B, 3)
    variances of the ANs' positions. The flags run errata as printed.
    """
    (steps, K), (R, n) = heard.shape, x0.shape
    last = R - 1
    x, Fx, w = np.empty((n, TILE)), np.empty((n, TILE)), np.empty((ROWS, TILE))
    P, FR, root = np.empty((n, n, TILE)), np.empty((n, n, TILE)), np.empty((n, n, TILE))
    exact, linked = np.zeros(3), 0.0 if apart else 1.0
    for i in range(n):
        for r in range(TILE):
            x[i, r] = x0[min(r, last), i]
        for j in range(n):
            for r in range(TILE):
                root[i, j, r] = root0[i, j]
    for k in range(steps):
        predict(x, root, F, Q, P, FR, Fx)
        cholesky(P, root)
        for i in range(A, L):
            for r in range(TILE):
                w[i, r] = 0.0
        for i in range(3):
            for r in range(TILE):
                w[X + i, r] = x[i, r]
        for m in range(K):
            a = heard[k, m]
            if a < 0:
                break
            for i in range(3):
                for r in range(TILE):
                    w[S + i, r] = position[min(r, last), a, i]
                    w[Y + i, r] = y[min(r, last), k, m, i]
                    w[V + i, r] = q[min(r, last), k, m, i]
            ahead, left = rotation[a, 0, 0], rotation[a, 0, 1]
            turn = angle(left, ahead, math.sqrt(ahead * ahead + left * left)) if unwrapped else 0.0
            own = exact if shared else C[a]
            if shared and apart:
                observe(w, rotation[a], own, turn, jacobian, unwrapped, linked, A2)
            else:
                observe(w, rotation[a], own, turn, jacobian, unwrapped, linked, A)
        if shared:
            common(w, A, C[0])
            if apart:
                common(w, A2, C[0])
                for i in range(9):
                    for r in range(TILE):
                        w[A + i, r] += w[A2 + i, r]
        for i in range(3):
            for j in range(i + 1):
                for r in range(TILE):
                    w[L + i * (i + 1) // 2 + j, r] = root[i, j, r]
        update(w)
        conclude(x, root, w)
        store(x, root, k, means, covariances)


def run(mean, root, F, Q, y, q, heard, anchors, C, flags):
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
        first = [np.ascontiguousarray(a, dtype=float) for a in (mean[of], root, F, Q, y[of], q[of])]
        more = [np.ascontiguousarray(a, dtype=float) for a in (places[of], turned, known)]
        ekf(*first, np.ascontiguousarray(heard), *more, *flags, position[of], covariance[of])
    return position, covariance
