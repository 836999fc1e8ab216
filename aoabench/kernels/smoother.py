"""Kernels of smoothers in double precision, one replication after the other: the information of
measurements, a Kalman filter that absorbs it, and the backward pass of Rauch, Tung and Striebel.

The arithmetic of `filters/smoother.py` and `filters/track_model.py`. `which` are the indices of the
replications to compute; the others' results are not touched. F[:, k] and Q[:, k] lead from step
k - 1 to step k.
"""

from __future__ import annotations

import math

import numpy as np
from numba import types

from aoabench.kernels.angles import direction_angle, wrapped
from aoabench.kernels.compile import ORDERED, given, inlined_ordered, kernel
from aoabench.kernels.small import UNIT_VECTOR
from aoabench.kernels.square_root import EPS

WHICH = given(1, types.intp)
STATES, COVARIANCES = types.float64[:, :, ::1], types.float64[:, :, :, ::1]
NEAREST, RHO2_FLOOR = 1e-12, 1e-12  # m and m^2, as in the measurement models


@inlined_ordered
def product(A, B, out):
    """A B into `out`, all (n, n)."""
    n = len(A)
    for i in range(n):
        for j in range(n):
            c = 0.0
            for l in range(n):
                c += A[i, l] * B[l, j]
            out[i, j] = c


@inlined_ordered
def add_square(A, B, M, out):
    """out += A B A^T for a symmetric B, all (n, n); M (n, n) is workspace."""
    n = len(A)
    product(A, B, M)
    for i in range(n):
        for j in range(i + 1):
            c = 0.0
            for l in range(n):
                c += M[i, l] * A[j, l]
            out[i, j] += c
            if i != j:
                out[j, i] += c


@inlined_ordered
def factor(A, L):
    """Lower factor of A (n, n) into L; NaN where A is not positive definite."""
    n = len(A)
    for j in range(n):
        for i in range(j, n):
            c = A[i, j]
            for l in range(j):
                c -= L[i, l] * L[j, l]
            if i == j:
                L[j, j] = math.sqrt(c) if c > 0.0 else math.nan
            else:
                L[i, j] = c / L[j, j]
        for i in range(j):
            L[i, j] = 0.0


@inlined_ordered
def forward_solve(L, B):
    """L^-1 B in place of B (n, n)."""
    n = len(L)
    for i in range(n):
        for j in range(n):
            c = B[i, j]
            for l in range(i):
                c -= L[i, l] * B[l, j]
            B[i, j] = c / L[i, i]


@inlined_ordered
def backward_solve(L, B):
    """L^-T B in place of B (n, n)."""
    n = len(L)
    for i in range(n - 1, -1, -1):
        for j in range(n):
            c = B[i, j]
            for l in range(i + 1, n):
                c -= L[l, i] * B[l, j]
            B[i, j] = c / L[i, i]


# numba compiles a loop in a tenth of the time that it takes for an assignment of arrays


@inlined_ordered
def copy(source, out):
    """Copy source (n,) into out (n,)."""
    for i in range(len(out)):
        out[i] = source[i]


@inlined_ordered
def copy_matrix(source, out):
    """Copy source (n, n) into out (n, n)."""
    for i in range(len(out)):
        copy(source[i], out[i])


@inlined_ordered
def predict(F, Q, P, M, S):
    """S = F P F^T + Q with an increased diagonal, all (n, n), so that it is positive definite."""
    n = len(F)
    copy_matrix(Q, S)
    add_square(F, P, M, S)
    for i in range(n):
        S[i, i] *= 1.0 + 2.0 * n * n * EPS


@kernel(types.void(WHICH, given(4), given(4), STATES, COVARIANCES), ORDERED)
def backward(which, F, Q, x, P):
    """Smoothed states and covariances in place of the filtered x (R, T, n) and P (R, T, n, n).

    F, Q (R|1, T|1, n, n). Where the next step is not finite, the filtered state remains.
    """
    _, steps, n = x.shape
    M, S, L, G = np.empty((n, n)), np.empty((n, n)), np.empty((n, n)), np.empty((n, n))
    D, U, v = np.empty((n, n)), np.empty((n, n)), np.empty(n)
    for r in which:
        i = min(r, len(F) - 1)
        for k in range(steps - 2, -1, -1):
            j = min(k + 1, F.shape[1] - 1)
            if not (np.isfinite(x[r, k + 1]).all() and np.isfinite(P[r, k + 1]).all()):
                continue
            f, q = F[i, j], Q[min(r, len(Q) - 1), min(k + 1, Q.shape[1] - 1)]
            predict(f, q, P[r, k], M, S)
            factor(S, L)
            product(f, P[r, k], M)
            forward_solve(L, M)
            backward_solve(L, M)
            for a in range(n):
                for b in range(n):
                    G[a, b] = M[b, a]
            for a in range(n):
                v[a] = x[r, k + 1, a]
                for b in range(n):
                    v[a] -= f[a, b] * x[r, k, b]
            product(G, f, D)
            for a in range(n):
                for b in range(n):
                    D[a, b] = (1.0 if a == b else 0.0) - D[a, b]
                    S[a, b] = P[r, k + 1, a, b] + q[a, b]
                    x[r, k, a] += G[a, b] * v[b]
            U[:] = 0.0
            add_square(D, P[r, k], M, U)
            add_square(G, S, M, U)
            copy_matrix(U, P[r, k])


@kernel(
    types.void(
        WHICH,
        *(given(d) for d in (2, 3, 4, 4, 4, 3, 3)),
        STATES,
        COVARIANCES,
    ),
    ORDERED,
)
def forward(which, mean, prior, F, Q, A, g, at, x, P):
    """Filtered states x (R, T, n) and covariances P (R, T, n, n) from the information A
    (R, T, n, n) and g (R, T, n) of each step about the state's deviation from `at` (R, T, n).

    mean (R, n), prior (R|1, n, n): the state before the first step; F, Q (R|1, T|1, n, n).
    """
    _, steps, n = x.shape
    M, S, L, H = np.empty((n, n)), np.empty((n, n)), np.empty((n, n)), np.empty((n, n))
    C, m, u, v = np.empty((n, n)), np.empty(n), np.empty(n), np.empty(n)
    for r in which:
        copy(mean[r], m)
        copy_matrix(prior[min(r, len(prior) - 1)], C)
        for k in range(steps):
            f = F[min(r, len(F) - 1), min(k, F.shape[1] - 1)]
            q = Q[min(r, len(Q) - 1), min(k, Q.shape[1] - 1)]
            for a in range(n):
                v[a] = 0.0
                for b in range(n):
                    v[a] += f[a, b] * m[b]
            copy(v, m)
            predict(f, q, C, M, S)
            factor(S, L)
            for a in range(n):  # I + L^T A L, and L^T
                for b in range(n):
                    S[a, b] = L[b, a]
                    H[a, b] = 1.0 if a == b else 0.0
            add_square(S, A[r, k], M, H)
            factor(H, L)
            forward_solve(L, S)
            for a in range(n):
                u[a] = g[r, k, a]
                for b in range(n):
                    u[a] -= A[r, k, a, b] * (m[b] - at[r, k, b])
            for a in range(n):
                for b in range(n):
                    C[a, b] = 0.0
                    for l in range(n):
                        C[a, b] += S[l, a] * S[l, b]
            for a in range(n):
                for b in range(n):
                    m[a] += C[a, b] * u[b]
            copy(m, x[r, k])
            copy_matrix(C, P[r, k])


@inlined_ordered
def rows(kind, a, b, c, y, v, J):
    """Innovations v (d,) and derivatives J (d, 3) in the anchor's frame of measurements y (d,) of a
    position at (a, b, c) from the anchor.
    """
    rho2 = a * a + b * b
    if kind == UNIT_VECTOR:
        length = max(math.sqrt(rho2 + c * c), NEAREST)
        u = a / length, b / length, c / length
        for i in range(3):
            v[i] = y[i] - u[i]
            for l in range(3):
                J[i, l] = ((1.0 if i == l else 0.0) - u[i] * u[l]) / length
    else:
        v[0] = wrapped(y[0] - direction_angle(b + 0.0, a + 0.0))
        v[1] = y[1] - direction_angle(c, math.sqrt(rho2))
        rho2 = max(rho2, RHO2_FLOOR)
        rho, r2 = math.sqrt(rho2), rho2 + c * c
        along = c / (rho * r2)
        J[0, 0], J[0, 1], J[0, 2] = -b / rho2, a / rho2, 0.0
        J[1, 0], J[1, 1], J[1, 2] = -a * along, -b * along, rho / r2


@kernel(
    types.void(
        types.intp,
        WHICH,
        *(given(d) for d in (3, 3, 3, 4, 5)),
        types.float64[:, ::1],
        COVARIANCES,
        STATES,
    ),
    ORDERED,
)
def information(kind, which, x, y, weights, position, rotation, squares, A, g):
    """Weighted squares (R, T) of the innovations, and information A (R, T, n, n) and g (R, T, n)
    about states x (R, T, n), from measurements y and weights (R, T, B d), 0 = not measured.

    position (R|1, T|1, B, 3) m, rotation (R|1, T|1, B, 3, 3).
    """
    _, steps, n = x.shape
    B, d = position.shape[2], 3 if kind == UNIT_VECTOR else 2
    v, J, local, turned = np.empty(3), np.empty((3, 3)), np.empty(3), np.empty(3)
    for r in which:
        for k in range(steps):
            squares[r, k] = 0.0
            A[r, k] = 0.0
            g[r, k] = 0.0
            for j in range(B):
                W = weights[r, k, d * j : d * (j + 1)]
                if not (W > 0.0).any():
                    continue
                s = position[min(r, len(position) - 1), min(k, position.shape[1] - 1), j]
                rot = rotation[min(r, len(rotation) - 1), min(k, rotation.shape[1] - 1), j]
                for i in range(3):
                    local[i] = 0.0
                    for l in range(3):
                        local[i] += rot[i, l] * (x[r, k, l] - s[l])
                rows(kind, local[0], local[1], local[2], y[r, k, d * j : d * (j + 1)], v, J)
                for i in range(d):
                    if not W[i] > 0.0:
                        continue
                    squares[r, k] += W[i] * v[i] * v[i]
                    for a in range(3):
                        turned[a] = J[i, 0] * rot[0, a] + J[i, 1] * rot[1, a] + J[i, 2] * rot[2, a]
                    for a in range(3):
                        g[r, k, a] += W[i] * turned[a] * v[i]
                        for b in range(3):
                            A[r, k, a, b] += W[i] * turned[a] * turned[b]


@inlined_ordered
def deviation(W, f, now, before):
    """|W (x - F y)|^2 of states x = `now` and y = `before` (n,), W and F (n, n)."""
    n, total = len(now), 0.0
    for a in range(n):
        c = 0.0
        for b in range(n):
            w = now[b]
            for l in range(n):
                w -= f[b, l] * before[l]
            c += W[a, b] * w
        total += c * c
    return total


@kernel(
    types.void(
        WHICH,
        given(2, types.boolean),
        *(given(d) for d in (3, 2, 2, 4, 3, 4)),
        types.float64[::1],
    ),
    ORDERED,
)
def cost(which, known, x, squares, mean, F, first, later, out):
    """The sum of squares (R,) of the steps that are `known` (R, T): `squares` (R, T) of the
    measurements and those of the motion.

    x (R, T, n) states; mean (R, n) before the first step; F (R|1, T|1, n, n); first (R|1, n, n) and
    later (R|1, T|1, n, n): roots of the inverse covariances of the first step and the others.
    """
    for r in which:
        total = 0.0
        for k in range(x.shape[1]):
            if not known[r, k]:
                continue
            f = F[min(r, len(F) - 1), min(k, F.shape[1] - 1)]
            total += squares[r, k]
            if k == 0:
                total += deviation(first[min(r, len(first) - 1)], f, x[r, k], mean[r])
            else:
                W = later[min(r, len(later) - 1), min(k, later.shape[1] - 1)]
                total += deviation(W, f, x[r, k], x[r, k - 1])
        out[r] = total
