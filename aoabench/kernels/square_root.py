"""Functions of filters that store a square root of their covariance, in double precision.

The last axis of every array has the length `tile`, a number of replications that is a constant of
the kernel. A filter's array `w` holds, in rows that the caller names, the sums A (6, the lower half
row by row) and after it g (3) of a step's measurements, the lower factor L (6) of the position's
covariance, T (9) and z (3) of `update`, and the sum N of the squared innovations, each divided by
its measurement's variance.
"""

from __future__ import annotations

import math

from aoabench.kernels.compile import inlined_ordered, spliced
from aoabench.kernels.limits import NEAREST

EPS = 2.0**-52
LOST = 32.0 * EPS  # share of a diagonal element; a pivot below it is rounding error


@spliced
def predict(tile, x, root, F, Q, P, FR, Fx):
    """Predict by F and Q (n, n): x = F x, and the lower half of P = F root (F root)^T + Q with an
    increased diagonal.
    """
    n = len(x)
    for i in range(n):
        for r in range(tile):
            Fx[i, r] = 0.0
        for j in range(n):
            for r in range(tile):
                FR[i, j, r] = 0.0
                P[i, j, r] = Q[i, j]
        for l in range(n):
            f = F[i, l]
            if f != 0.0:
                for r in range(tile):
                    Fx[i, r] += f * x[l, r]
                for j in range(max(l + 1, 3)):
                    for r in range(tile):
                        FR[i, j, r] += f * root[l, j, r]
    summed(tile, x, P, FR, Fx)


@spliced
def summed(tile, x, P, FR, Fx):
    """Write F x into x, and add F root (F root)^T to the lower half of P, whose diagonal increases.

    The increase exceeds the rounding errors of the sums and of the Cholesky factor, so that P is
    positive definite.
    """
    n = len(x)
    raised = 1.0 + 2.0 * n * n * EPS
    for i in range(n):
        for r in range(tile):
            x[i, r] = Fx[i, r]
        for j in range(i + 1):
            for l in range(n):
                for r in range(tile):
                    P[i, j, r] += FR[i, l, r] * FR[j, l, r]
        for r in range(tile):
            P[i, i, r] *= raised


@spliced
def advance(tile, start, k, x, root, F, Q, moves, P, FR, Fx):
    """Predict the state of step k, x and root, of the replications start ... from F and Q (R|1,
    T|1, n, n); moves (2, n, n, tile), P, FR and Fx are workspace, and P becomes the covariance.

    Where all replications have the same matrices, the products of `predict` are taken by number.
    """
    i, j = min(k, F.shape[1] - 1), min(k, Q.shape[1] - 1)
    if len(F) == 1 and len(Q) == 1:
        predict(tile, x, root, F[0, i], Q[0, j], P, FR, Fx)
    else:
        fill(tile, start, i, F, moves[0])
        fill(tile, start, j, Q, moves[1])
        predict_each(tile, x, root, moves[0], moves[1], P, FR, Fx)
    cholesky(tile, P, root)


@spliced
def fill(tile, start, k, matrices, out):
    """Copy the matrices (R|1, T, n, n) of step k of the replications start ... into out (n, n,
    tile); the last one fills up the tile.
    """
    n = len(out)
    for r in range(tile):
        one = matrices[min(start + r, len(matrices) - 1), k]
        for i in range(n):
            for j in range(n):
                out[i, j, r] = one[i, j]


@spliced
def predict_each(tile, x, root, F, Q, P, FR, Fx):
    """`predict` with F and Q (n, n, tile) of each replication."""
    n = len(x)
    for i in range(n):
        for r in range(tile):
            Fx[i, r] = 0.0
        for j in range(n):
            for r in range(tile):
                FR[i, j, r] = 0.0
                P[i, j, r] = Q[i, j, r]
        for l in range(n):
            some = False
            for r in range(tile):
                some |= F[i, l, r] != 0.0
            if some:
                for r in range(tile):
                    Fx[i, r] += F[i, l, r] * x[l, r]
                for j in range(max(l + 1, 3)):
                    for r in range(tile):
                        FR[i, j, r] += F[i, l, r] * root[l, j, r]
    summed(tile, x, P, FR, Fx)


@spliced
def cholesky(tile, P, L):
    """Lower factor of P into L; NaN where P is not positive definite."""
    n = len(P)
    for j in range(n):
        for i in range(j, n):
            for r in range(tile):
                L[i, j, r] = P[i, j, r]
            for l in range(j):
                for r in range(tile):
                    L[i, j, r] -= L[i, l, r] * L[j, l, r]
        for r in range(tile):
            L[j, j, r] = math.sqrt(L[j, j, r] if L[j, j, r] > 0.0 else math.nan)
        for i in range(j + 1, n):
            for r in range(tile):
                L[i, j, r] /= L[j, j, r]


@inlined_ordered
def turned(h, M):
    """M^T h with M (9,) row by row."""
    return (
        M[0] * h[0] + M[3] * h[1] + M[6] * h[2],
        M[1] * h[0] + M[4] * h[1] + M[7] * h[2],
        M[2] * h[0] + M[5] * h[1] + M[8] * h[2],
    )


@inlined_ordered
def swapped(swap, a, b):
    """(b, a) if `swap`, else (a, b)."""
    return b if swap else a, a if swap else b


@inlined_ordered
def inverse_root(p, least):
    """1 / sqrt(p); 0 where p is not above `least`."""
    return 1.0 / math.sqrt(math.inf if p <= least else p)


@inlined_ordered
def back(first, second, third, c):
    """c (3,) without the swaps of `columns`."""
    x, y, z = c
    y, z = swapped(third, y, z)
    x, z = swapped(second, x, z)
    x, y = swapped(first, x, y)
    return x, y, z


@inlined_ordered
def columns(w, a, r):
    """c0, u0, c1, u1, c2, u2 with A = sum c c^T and g = sum u c, each c (3,) and u a number.

    The columns c are a Cholesky factor of A, the largest pivot first. A pivot below the rounding
    error of A's diagonal carries no information, and its column is 0.
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


@inlined_ordered
def absorb(M, z, h, u):
    """Mean z and factor M of a normal N(z, M M^T) after a measurement u = h^T z + e, e ~ N(0, 1).

    M (9,) is stored row by row. In Potter's form, with f = M^T h and s = 1 + f^T f,
    z += M f (u - h^T z) / s and M -= M f f^T / (s + sqrt(s)). The second step multiplies M f by
    1 / sqrt(s), so M M^T stays positive semidefinite.
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


@spliced
def update(tile, w, A, L, T, Z, N):
    """T (3, 3) and z (3,) from A, g and L: an update gives x + L z and the factor L T of P_pp.

    N, the sum v^T R^-1 v of the squared innovations, becomes v^T S^-1 v with S = H P H^T + R: it is
    reduced by g^T L z.
    """
    for r in range(tile):
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
        explained = w[A + 6, r] * (l00 * z[0]) + w[A + 7, r] * (l10 * z[0] + l11 * z[1])
        w[N, r] -= explained + w[A + 8, r] * (l20 * z[0] + l21 * z[1] + l22 * z[2])


@spliced
def reach(tile, P, out):
    """Squares of the distances (tile,) below which an EKF skips an anchor; P is the predicted
    covariance.
    """
    for r in range(tile):
        out[r] = NEAREST * NEAREST * (P[0, 0, r] + P[1, 1, r] + P[2, 2, r])


@spliced
def conclude(tile, x, root, w, T, Z):
    """Apply an update: x += L_:p z and L_:p = L_:p T; other columns of the factor do not change."""
    for i in range(len(x)):
        for r in range(tile):
            a = root[i, 0, r]
            b, c = root[i, 1, r] if i > 0 else 0.0, root[i, 2, r] if i > 1 else 0.0
            x[i, r] += a * w[Z, r] + b * w[Z + 1, r] + c * w[Z + 2, r]
            root[i, 0, r] = a * w[T, r] + b * w[T + 3, r] + c * w[T + 6, r]
            root[i, 1, r] = a * w[T + 1, r] + b * w[T + 4, r] + c * w[T + 7, r]
            root[i, 2, r] = a * w[T + 2, r] + b * w[T + 5, r] + c * w[T + 8, r]


@spliced
def store(tile, x, root, squared, start, k, means, covariances, nis):
    """Store the normalised innovation squared at step k, and as many of the state's first
    components as `means` has: position or whole state, and covariance, the latter with an increased
    diagonal as in `predict`.
    """
    raised = 1.0 + 2.0 * means.shape[2] * means.shape[2] * EPS
    for r in range(min(tile, len(means) - start)):
        nis[start + r, k] = squared[r]
        for p in range(means.shape[2]):
            means[start + r, k, p] = x[p, r]
            for q in range(p + 1):
                c = root[p, 0, r] * root[q, 0, r] + root[p, 1, r] * root[q, 1, r]
                c += root[p, 2, r] * root[q, 2, r]
                for l in range(3, q + 1):
                    c += root[p, l, r] * root[q, l, r]
                covariances[start + r, k, p, q] = covariances[start + r, k, q, p] = c
            covariances[start + r, k, p, p] *= raised
