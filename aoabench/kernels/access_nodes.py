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
    cholesky,
    columns,
    conclude,
    predict,
    reach,
    store,
    turned,
    update,
)

TILE = 8

RHO2_FLOOR = 1e-12  # m^2, as in access_nodes
# First rows of w: X position, S AN's position, Y measurements, V their variances, A sums A and g,
# A2 the same sums of the times alone, L factor of the position's covariance, T and Z of an update,
# N the sum of squared innovations, D the square of the distance below which an AN is skipped
X, S, Y, V, A, A2, L, T, Z, N, D, ROWS = 0, 3, 6, 9, 12, 21, 30, 36, 45, 48, 49, 50
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
def observe(w, R, c, turn, jacobian, unwrapped, linked, first):
    """Add H^T S^-1 H to A and H^T S^-1 v to g for one AN.

    The terms of the AN's time are added to the rows of w from `first` on. R (3, 3) is its rotation,
    c (3,) m^2 are the variances of its position. `linked` is 0 if the covariances of time and
    angles are left out, else 1. The components are decorrelated one after the other, and each is
    weighted by the inverse of its remaining variance. An AN that is too near is left out.
    """
    M = R[0, 0], R[0, 1], R[0, 2], R[1, 0], R[1, 1], R[1, 2], R[2, 0], R[2, 1], R[2, 2]
    C = c[0], c[1], c[2]
    for r in range(TILE):
        x, y, z = w[X, r] - w[S, r], w[X + 1, r] - w[S + 1, r], w[X + 2, r] - w[S + 2, r]
        near = x * x + y * y + z * z < w[D, r]
        yd, ya, ye = w[Y, r], w[Y + 1, r], w[Y + 2, r]
        yd, ya, ye = hidden(near, yd), hidden(near, ya), hidden(near, ye)
        h, hd, ha, he = expected(
            M[0] * x + M[1] * y + M[2] * z,
            M[3] * x + M[4] * y + M[5] * z,
            M[6] * x + M[7] * y + M[8] * z,
            jacobian,
        )
        d, a, e = w[Y, r] - h[0], w[Y + 1, r] - h[1], w[Y + 2, r] - h[2]
        a = wrapped(w[Y + 1, r] + turn) - wrapped(h[1] + turn) if unwrapped else wrapped(a)
        d, sd, hd = measured(yd, d, w[V, r], turned(hd, M))
        a, sa, ha = measured(ya, a, w[V + 1, r], turned(ha, M))
        e, se, he = measured(ye, e, w[V + 2, r], turned(he, M))
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
        q = 1.0 / (se - f * ea)
        add(w, A, r, q, e, he)
        w[N, r] += SURE * (i * d * d + j * a * a + q * e * e)


@inlined_ordered
def common(w, a, C):
    """Replace A by A (I + C A)^-1 and g by (I + A C)^-1 g: a further error of the position.

    C (3,) m^2 are the variances of this error. A and g are the rows of w from a on. With A = c c^T,
    g = c u and sqrt(C) c = f, the results are c M M^T c^T and c M M^T u, where M is the root of
    (I + f^T f)^-1. The sum N of squared innovations is reduced by g^T C (I + A C)^-1 g.
    """
    s0, s1, s2 = math.sqrt(C[0]), math.sqrt(C[1]), math.sqrt(C[2])
    for i in range(3):  # the rows of T are free until the update
        for r in range(TILE):
            w[T + i, r] = C[i] * w[a + 6 + i, r]
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
    for r in range(TILE):
        w[N, r] -= w[T, r] * w[a + 6, r] + w[T + 1, r] * w[a + 7, r] + w[T + 2, r] * w[a + 8, r]


@kernel(
    types.void(
        *(given(d) for d in (2, 2, 2, 2, 4, 4)), given(2, types.int64),
        *(given(d) for d in (3, 3, 2)), *[types.boolean] * 4,
        types.float64[:, :, ::1], types.float64[:, :, :, ::1], types.float64[:, ::1],
    ),
    ORDERED,
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
    nis,
):
    """EKF means (R, T, 3) m, covariances (R, T, 3, 3) m^2 and normalised innovations squared (R, T)
    of R <= TILE replications, into the last three arguments.

    y, q (R, T, K, 3): measurements and their variances; x0 (R, n), root0, F, Q (n, n): prior mean,
    lower factor of the prior covariance, motion model; heard (T, K): numbers of the ANs at each
    step, -1 for none; position (R, B, 3) m, rotation (B, 3, 3), C (B, 3) m^2: the ANs and the
    variances of their positions; jacobian, unwrapped, shared, apart: errata to run as printed.
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
        predict(TILE, x, root, F, Q, P, FR, Fx)
        cholesky(TILE, P, root)
        reach(TILE, P, w[D])
        for i in range(A, L):
            for r in range(TILE):
                w[i, r] = 0.0
        for r in range(TILE):
            w[N, r] = 0.0
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
        update(TILE, w, A, L, T, Z, N)
        conclude(TILE, x, root, w, T, Z)
        store(TILE, x, root, w[N], 0, k, means, covariances, nis)


def run(mean, root, F, Q, y, q, heard, anchors, C, flags):
    """Positions (R, T, 3) m, covariances (R, T, 3, 3) m^2 and normalised innovations squared
    (R, T), computed tile by tile.
    """
    R, T = y.shape[:2]
    places, rotation = anchors.frames
    places = np.broadcast_to(places, (R, *places.shape[1:]))
    position, covariance, nis = np.empty((R, T, 3)), np.empty((R, T, 3, 3)), np.empty((R, T))
    # replications of a tile share rotations and stated deviations; if these differ, it has only one
    size = TILE if len(rotation) == len(C) == 1 else 1
    for start in range(0, R, size):
        of = slice(start, min(start + size, R))
        turned, known = (a[start if len(a) > 1 else 0] for a in (rotation, C))
        first = [np.ascontiguousarray(a, dtype=float) for a in (mean[of], root, F, Q, y[of], q[of])]
        more = [np.ascontiguousarray(a, dtype=float) for a in (places[of], turned, known)]
        out = position[of], covariance[of], nis[of]
        ekf(*first, np.ascontiguousarray(heard), *more, *flags, *out)
    return position, covariance, nis
