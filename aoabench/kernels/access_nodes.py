"""Kernel of the EKF at access nodes (ANs): double precision, `TILE` replications at once.

The kernel computes the recursion of `filters/access_nodes.py`. The last axis of every array runs
over the replications; the innermost loops run over this axis and contain no calls. The compiler
vectorises such a loop only if it can prove that its arrays do not overlap. Therefore all inputs of
an update are rows of one array `w`, and one loop does all the work on one AN.
"""

from __future__ import annotations

import math

import numpy as np
from numba import types

from aoabench.kernels.angles import angle, wrapped
from aoabench.kernels.compile import ORDERED, given, inlined_ordered, kernel
from aoabench.kernels.limits import ROUNDED
from aoabench.kernels.square_root import (
    absorb,
    advance,
    columns,
    conclude,
    reach,
    store,
    turned,
    update,
)
from aoabench.maths.geometry import LIGHT

TILE = 32

RHO2_FLOOR = 1e-12  # m^2, as in filters.access_nodes
LEAST_VARIANCE = 1e-32  # as in models.components
# First rows of w: X position, S AN's position, Y measurements, V their variances, A sums A and g,
# A2 the same sums of the times alone, L factor of the position's covariance, T and Z of an update,
# N the sum of squared innovations, D the square of the distance below which an AN is skipped,
# M AN's rotation, C variances of its position, C0 those of the error that all ANs share, B the
# direction of its broadside, U the number of measured components
X, S, Y, V, A, A2, L, T, Z, N, D = 0, 3, 6, 9, 12, 21, 30, 36, 45, 48, 49
M, C, C0, B, U, ROWS = 50, 59, 62, 65, 66, 67
SURE = 1.0 - ROUNDED


@inlined_ordered
def expected(u, v, w, jacobian):
    """Range, azimuth, elevation of the point (u, v, w) in the AN's frame; derivatives of each."""
    rho2 = max(u * u + v * v, RHO2_FLOOR)
    rho, d2 = math.sqrt(rho2), rho2 + w * w
    d = math.sqrt(d2)
    i, j, k = 1.0 / d, 1.0 / (rho if jacobian else rho2), 1.0 / (rho2 if jacobian else d2)
    t = w * k if jacobian else w / rho * k
    h = d, angle(v, u, rho), angle(w, rho, d)
    return h, (u * i, v * i, w * i), (-v * j, u * j, 0.0), (-u * t, -v * t, rho * k)


@inlined_ordered
def measured(y, d, q, h):
    """Residual, variance and derivatives of a component; 0, 1 and 0 where its y is NaN."""
    if math.isnan(y):
        return 0.0, 1.0, (0.0, 0.0, 0.0)
    return d, q, h


@inlined_ordered
def hidden(near, y):
    """NaN if `near`, else y."""
    return math.nan if near else y


@inlined_ordered
def product(a, C, b):
    """a^T diag(C) b."""
    return a[0] * C[0] * b[0] + a[1] * C[1] * b[1] + a[2] * C[2] * b[2]


@inlined_ordered
def less(f, d, h, e, k):
    """d - f e and h - f k: residual and derivatives of a component minus f times another's."""
    return d - f * e, (h[0] - f * k[0], h[1] - f * k[1], h[2] - f * k[2])


@inlined_ordered
def add(w, a, r, f, d, h):
    """Add f h h^T to A and f h d to g; A and g are the rows of w from a on."""
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


@inlined_ordered
def observe(w, jacobian, unwrapped, linked, first):
    """Add H^T S^-1 H to A and H^T S^-1 v to g for one AN.

    The terms of the AN's time are added to the rows of w from `first` on. `linked` is 0 if the
    covariances of time and angles are left out, else 1. The components are decorrelated one after
    the other, and each is weighted by the inverse of its remaining variance. An AN that is too near
    is left out.
    """
    for r in range(TILE):
        x, y, z = w[X, r] - w[S, r], w[X + 1, r] - w[S + 1, r], w[X + 2, r] - w[S + 2, r]
        near = x * x + y * y + z * z < w[D, r]
        yd, ya, ye = w[Y, r], w[Y + 1, r], w[Y + 2, r]
        yd, ya, ye = hidden(near, yd), hidden(near, ya), hidden(near, ye)
        R0 = w[M, r], w[M + 1, r], w[M + 2, r]
        R1 = w[M + 3, r], w[M + 4, r], w[M + 5, r]
        R2 = w[M + 6, r], w[M + 7, r], w[M + 8, r]
        R, c, turn = (*R0, *R1, *R2), (w[C, r], w[C + 1, r], w[C + 2, r]), w[B, r]
        h, hd, ha, he = expected(
            R[0] * x + R[1] * y + R[2] * z,
            R[3] * x + R[4] * y + R[5] * z,
            R[6] * x + R[7] * y + R[8] * z,
            jacobian,
        )
        d, a, e = w[Y, r] - h[0], w[Y + 1, r] - h[1], w[Y + 2, r] - h[2]
        a = wrapped(w[Y + 1, r] + turn) - wrapped(h[1] + turn) if unwrapped else wrapped(a)
        d, sd, hd = measured(yd, d, w[V, r], turned(hd, R))
        a, sa, ha = measured(ya, a, w[V + 1, r], turned(ha, R))
        e, se, he = measured(ye, e, w[V + 2, r], turned(he, R))
        sd, sa, se = sd + product(hd, c, hd), sa + product(ha, c, ha), se + product(he, c, he)
        ad, ed, ea = linked * product(ha, c, hd), linked * product(he, c, hd), product(he, c, ha)
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
        q = 1.0 / (se - f * ea)
        add(w, A, r, q, e, he)
        w[N, r] += SURE * (i * d * d + j * a * a + q * e * e)


@inlined_ordered
def common(w, a):
    """Replace A by A (I + C A)^-1 and g by (I + A C)^-1 g: a further error of the position.

    The rows of w from C0 on are the variances C of this error; A and g are the rows from a on. With
    A = c c^T, g = c u and sqrt(C) c = f, the results are c G G^T c^T and c G G^T u, where G is the
    root of (I + f^T f)^-1. The sum N of squared innovations is reduced by g^T C (I + A C)^-1 g.
    """
    for i in range(3):  # the rows of T are free until the update
        for r in range(TILE):
            w[T + i, r] = w[C0 + i, r] * w[a + 6 + i, r]
    for r in range(TILE):
        c0, u0, c1, u1, c2, u2 = columns(w, a, r)
        s0, s1, s2 = math.sqrt(w[C0, r]), math.sqrt(w[C0 + 1, r]), math.sqrt(w[C0 + 2, r])
        G, z = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0), (0.0, 0.0, 0.0)
        G, z = absorb(G, z, (s0 * c0[0], s0 * c1[0], s0 * c2[0]), 0.0)
        G, z = absorb(G, z, (s1 * c0[1], s1 * c1[1], s1 * c2[1]), 0.0)
        G, z = absorb(G, z, (s2 * c0[2], s2 * c1[2], s2 * c2[2]), 0.0)
        u = turned((u0, u1, u2), G)
        x = turned((c0[0], c1[0], c2[0]), G)
        y = turned((c0[1], c1[1], c2[1]), G)
        z = turned((c0[2], c1[2], c2[2]), G)
        for i in range(9):
            w[a + i, r] = 0.0
        add(w, a, r, 1.0, u[0], (x[0], y[0], z[0]))
        add(w, a, r, 1.0, u[1], (x[1], y[1], z[1]))
        add(w, a, r, 1.0, u[2], (x[2], y[2], z[2]))
    for r in range(TILE):
        w[N, r] -= w[T, r] * w[a + 6, r] + w[T + 1, r] * w[a + 7, r] + w[T + 2, r] * w[a + 8, r]


@inlined_ordered
def clear(w, first, stop):
    """Set rows of w to 0."""
    for i in range(first, stop):
        for r in range(TILE):
            w[i, r] = 0.0


@inlined_ordered
def spread(w, row, values, start, last, k, m):
    """Copy the values (R|1, T|1, K, d) of the AN at place m of step k into d rows of w."""
    at = min(k, values.shape[1] - 1)
    for j in range(values.shape[3]):
        if len(values) == 1:
            value = values[0, at, m, j]
            for r in range(TILE):
                w[row + j, r] = value
        else:
            for r in range(TILE):
                w[row + j, r] = values[min(start + r, last), at, m, j]


@inlined_ordered
def place(w, start, last, k, m, position, rotation, unwrapped):
    """Copy position, rotation and broadside's direction of the AN at place m of step k into w."""
    spread(w, S, position, start, last, k, m)
    spread(w, M, rotation, start, last, k, m)
    if unwrapped:
        for r in range(TILE):
            ahead, left = w[M, r], w[M + 1, r]
            w[B, r] = angle(left, ahead, math.sqrt(ahead * ahead + left * left))


@inlined_ordered
def variances(w, row, start, last, k, m, sigma):
    """Copy the variances of the position of the AN at place m of step k into three rows of w."""
    spread(w, row, sigma, start, last, k, m)
    for i in range(row, row + 3):
        for r in range(TILE):
            w[i, r] *= w[i, r]


@inlined_ordered
def copy(w, row, start, k, m, values, sigmas):
    """Copy values at place m of step k into a row of Y, and their deviations into that of V; return
    whether a value is a number.
    """
    last, found = len(values) - 1, False
    for r in range(TILE):
        i = min(start + r, last)
        value = values[i, k, m]
        w[Y + row, r], w[V + row, r] = value, sigmas[i, k, m]
        found |= not math.isnan(value)
    return found


@inlined_ordered
def convert(w, row, scale):
    """Scale a row of Y, and replace its deviations by variances.

    A value counts as not measured, NaN, where its variance is not a positive number.
    """
    for r in range(TILE):
        y, s = scale * w[Y + row, r], scale * w[V + row, r]
        q = s * s
        usable = (q > 0.0) & (q < math.inf)
        w[Y + row, r] = y if usable else math.nan
        w[V + row, r] = max(q if usable else 1.0, LEAST_VARIANCE)
        w[U, r] += 1.0 if usable & (abs(y) < math.inf) else 0.0


@kernel(
    types.void(
        *(given(dimensions) for dimensions in (2, 2, 4, 4, 3, 3, 3, 3, 3, 3, 4, 4, 4)),
        *[types.boolean] * 5,
        types.float64[:, :, ::1], types.float64[:, :, :, ::1], types.float64[:, ::1],
        types.int64[:, ::1],
    ),
    ORDERED,
)  # fmt: skip
def ekf(
    x0, root0, F, Q, delay, azimuth, elevation, delay_sigma, azimuth_sigma, elevation_sigma,
    position, rotation, sigma, toa, jacobian, unwrapped, shared, apart,
    means, covariances, nis, used,
):  # fmt: skip
    """EKF means (R, T, 3|n), covariances (R, T, 3|n, 3|n), normalised innovations squared (R, T)
    and numbers (R, T) of measured components, into the last four arguments.

    x0 (R, n), root0 (n, n): prior mean, lower factor of the prior covariance; F, Q (R|1, T|1, n,
    n): motion model; delay s ... elevation_sigma rad (R, T, K): measurements and their deviations,
    NaN = not measured; position, sigma (R|1, T|1, K, 3) m, rotation (R|1, T|1, K, 9): the ANs and
    the deviations of their positions; toa: whether the delays are used; jacobian, unwrapped,
    shared, apart: errata to run as printed.
    """
    (R, steps, K), n = azimuth.shape, x0.shape[1]
    x, Fx, w = np.empty((n, TILE)), np.empty((n, TILE)), np.empty((ROWS, TILE))
    P, FR, root = np.empty((n, n, TILE)), np.empty((n, n, TILE)), np.empty((n, n, TILE))
    moves = np.empty((2, n, n, TILE))
    linked = 0.0 if apart else 1.0
    for start in range(0, R, TILE):
        lanes = min(TILE, R - start)
        clear(w, 0, ROWS)
        for r in range(TILE):
            w[Y, r] = math.nan  # it remains so without times
        for i in range(n):
            for r in range(TILE):
                x[i, r] = x0[min(start + r, R - 1), i]
            for j in range(n):
                for r in range(TILE):
                    root[i, j, r], P[i, j, r] = root0[i, j], 0.0
        for k in range(steps):
            advance(lanes, start, k, x, root, F, Q, moves, P, FR, Fx)
            reach(TILE, P, w[D])
            clear(w, A, L)
            clear(w, N, N + 1)
            clear(w, U, ROWS)
            for i in range(3):
                for r in range(TILE):
                    w[X + i, r] = x[i, r]
            if shared:
                variances(w, C0, start, R - 1, k, 0, sigma)
            for m in range(K):
                found = copy(w, 1, start, k, m, azimuth, azimuth_sigma)
                found |= copy(w, 2, start, k, m, elevation, elevation_sigma)
                if toa:
                    found |= copy(w, 0, start, k, m, delay, delay_sigma)
                if not found:
                    continue
                if toa:
                    convert(w, 0, LIGHT)
                convert(w, 1, 1.0)
                convert(w, 2, 1.0)
                place(w, start, R - 1, k, m, position, rotation, unwrapped)
                if not shared:
                    variances(w, C, start, R - 1, k, m, sigma)
                if shared and apart:
                    observe(w, jacobian, unwrapped, linked, A2)
                else:
                    observe(w, jacobian, unwrapped, linked, A)
            if shared:
                common(w, A)
                if apart:
                    common(w, A2)
                    for i in range(9):
                        for r in range(TILE):
                            w[A + i, r] += w[A2 + i, r]
            for i in range(3):
                for j in range(i + 1):
                    for r in range(TILE):
                        w[L + i * (i + 1) // 2 + j, r] = root[i, j, r]
            update(TILE, w, A, L, T, Z, N)
            conclude(lanes, x, root, w, T, Z)
            store(lanes, x, root, w[N], start, k, means, covariances, nis)
            for r in range(lanes):
                used[start + r, k] = int(w[U, r])


def run(belief, batch, toa, flags, size):
    """The first `size` components of the states, and what `ekf` gives beside them.

    The covariance of `belief` is a square root; toa: whether the delays are used; flags: errata.
    """
    R, T, K = batch.azimuth.shape
    delay = (batch.delay, batch.delay_sigma) if toa else (batch.azimuth, batch.azimuth_sigma)
    rotation, own = batch.anchors.rotation, batch.anchors.position_sigma
    arrays = (
        *belief, delay[0], batch.azimuth, batch.elevation,
        delay[1], batch.azimuth_sigma, batch.elevation_sigma,
        batch.anchors.position, rotation.reshape(*rotation.shape[:3], 9),
        np.zeros((1, 1, K, 3)) if own is None else own,
    )  # fmt: skip
    shapes = (R, T, size), (R, T, size, size), (R, T)
    out = *map(np.empty, shapes), np.empty((R, T), int)
    ekf(*(np.ascontiguousarray(a, dtype=float) for a in arrays), toa, *flags, *out)
    return out
