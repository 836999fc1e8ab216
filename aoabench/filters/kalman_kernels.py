"""Kalman filter kernels: EKF and UKF in double precision, one replication after the other.

The arithmetic of `filters/kalman.py`, written out for states whose first three components are the position and for the
measurement models that are numbered below. In both filters the measurement enters through an information matrix, summed
up component by component, and P+ = V^T V with V = G^-1 L^T, G G^T = I + L^T A L, is positive semidefinite by form.

Kernels may use nothing but this file: the cache on disk sees only its own.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numba import njit, types

UNIT_VECTOR, AZEL, AZEL_ADAPTIVE = range(3)  # measurement models
AVERAGED, CENTRE = range(2)  # the UKF's variances

OPTIONS: dict[str, Any] = {"fastmath": {"contract"}, "error_model": "numpy"}
TURN = 2.0 * math.pi
RHO2_FLOOR, NEAREST = 1e-12, 1e-12  # m^2, m: as in the measurement models


def kernel(signature: Any) -> Callable[[Callable], Callable]:
    """Compile now, or take it from the cache on disk; without the cache where its folder cannot be written."""

    def compile_(function: Callable) -> Callable:
        try:
            return njit(signature, cache=True, nogil=True, **OPTIONS)(function)
        except RuntimeError:
            return njit(signature, nogil=True, **OPTIONS)(function)

    return compile_


inlined = njit(forceinline=True, **OPTIONS)


@inlined
def wrapped(a):
    """An angle brought into (-pi, pi]."""
    a -= TURN * np.rint(a / TURN)
    return math.pi if a <= -math.pi else a


@inlined
def seen_from(x, s, R):
    """R (x - s)."""
    dx, dy, dz = x[0] - s[0], x[1] - s[1], x[2] - s[2]
    return (
        R[0, 0] * dx + R[0, 1] * dy + R[0, 2] * dz,
        R[1, 0] * dx + R[1, 1] * dy + R[1, 2] * dz,
        R[2, 0] * dx + R[2, 1] * dy + R[2, 2] * dz,
    )


@inlined
def direction(kind, u, v, w):
    """The measured components of a direction: unit vector, or azimuth and elevation (and 0)."""
    if kind == UNIT_VECTOR:
        d = max(math.sqrt(u * u + v * v + w * w), NEAREST)
        return u / d, v / d, w / d
    return math.atan2(v + 0.0, u + 0.0), math.atan2(w, math.sqrt(u * u + v * v)), 0.0


@inlined
def variance(kind, c, elevation, nominal, table):
    """Variance of component c where the expected elevation is this."""
    if kind == AZEL_ADAPTIVE:
        degree = np.rint(elevation * (180.0 / math.pi) + 90.0)
        return table[int(degree) if 0.0 <= degree <= 180.0 else 90, c]
    return nominal


@inlined
def predict(x, P, F, Q, FP, work):
    """x = F x, P = F P F^T + Q in place."""
    n = len(x)
    for i in range(n):
        work[i] = 0.0
        for j in range(n):
            work[i] += F[i, j] * x[j]
            FP[i, j] = 0.0
            for l in range(n):
                FP[i, j] += F[i, l] * P[l, j]
    for i in range(n):
        x[i] = work[i]
        for j in range(n):
            total = Q[i, j]
            for l in range(n):
                total += FP[i, l] * F[j, l]
            P[i, j] = total


@inlined
def cholesky(A, L):
    """Lower factor of A into L; NaN where A is not positive definite."""
    n = A.shape[0]
    for j in range(n):
        pivot = A[j, j]
        for l in range(j):
            pivot -= L[j, l] * L[j, l]
        root = math.sqrt(pivot) if pivot > 0.0 else math.nan
        L[j, j] = root
        inverse = 1.0 / root
        for i in range(j + 1, n):
            total = A[i, j]
            for l in range(j):
                total -= L[i, l] * L[j, l]
            L[i, j] = total * inverse


@inlined
def forward(G, V, b):
    """V = G^-1 V and b = G^-1 b in place, G (m, m) lower triangular, V (m, n), b (m,)."""
    m, n = V.shape
    for i in range(m):
        inverse = 1.0 / G[i, i]
        for j in range(i):
            g = G[i, j]
            b[i] -= g * b[j]
            for c in range(n):
                V[i, c] -= g * V[j, c]
        b[i] *= inverse
        for c in range(n):
            V[i, c] *= inverse


@inlined
def conclude(x, P, V, b):
    """x += V^T b, P = V^T V."""
    m, n = V.shape
    for i in range(n):
        for l in range(m):
            x[i] += V[l, i] * b[l]
        for j in range(i + 1):
            total = 0.0
            for l in range(m):
                total += V[l, i] * V[l, j]
            P[i, j] = total
            P[j, i] = total


def given(dimensions: int) -> types.Array:
    """The type of an array of doubles that is only read."""
    return types.Array(types.float64, dimensions, "C", readonly=True)


ARGUMENTS = (
    types.intp,
    *(given(d) for d in (2, 2, 2, 2, 3, 3, 3, 4, 2)),
    types.float64[:, :, ::1],
    types.float64[:, :, :, ::1],
)


@kernel(types.void(*ARGUMENTS))
def ekf(kind, x0, P0, F, Q, Y, quality, position, rotation, table, means, covariances):
    """EKF of each replication: means (R, T, 3) and covariances (R, T, 3, 3) from measurements Y (R, T, m).

    x0 (R, n), P0, F, Q (n, n); quality (R, T, m) nominal variances; anchors (R|1, B, ...); `table` (181, 2) of
    variances for AZEL_ADAPTIVE.
    """
    (R, T, m), (B, n) = Y.shape, (position.shape[1], x0.shape[1])
    d = m // B
    x, b, work, h = np.empty(n), np.empty(n), np.empty(n), np.empty((3, 3))
    P, M, V, FP = np.empty((n, n)), np.empty((n, n)), np.empty((n, n)), np.empty((n, n))
    L, G = np.zeros((n, n)), np.zeros((n, n))
    A, g, AL = np.empty((3, 3)), np.empty(3), np.empty((3, n))
    for r in range(R):
        a = r if len(position) > 1 else 0
        x[:] = x0[r]
        P[:] = P0
        for k in range(T):
            predict(x, P, F, Q, FP, work)
            A[:] = 0.0
            g[:] = 0.0
            for j in range(B):
                rot = rotation[a, j]
                u, v, w = seen_from(x, position[a, j], rot)
                c = direction(kind, u, v, w)
                if kind == UNIT_VECTOR:  # (I - c c^T) R / distance
                    inverse = 1.0 / max(math.sqrt(u * u + v * v + w * w), NEAREST)
                    for q in range(3):
                        e = c[0] * rot[0, q] + c[1] * rot[1, q] + c[2] * rot[2, q]
                        h[0, q], h[1, q], h[2, q] = (
                            (rot[0, q] - c[0] * e) * inverse,
                            (rot[1, q] - c[1] * e) * inverse,
                            (rot[2, q] - c[2] * e) * inverse,
                        )
                else:
                    rho2 = max(u * u + v * v, RHO2_FLOOR)
                    rho, r2 = math.sqrt(rho2), rho2 + w * w
                    along = w / (rho * r2)
                    for q in range(3):
                        h[0, q] = (u * rot[1, q] - v * rot[0, q]) / rho2
                        h[1, q] = rho / r2 * rot[2, q] - along * (u * rot[0, q] + v * rot[1, q])
                for l in range(d):
                    y = Y[r, k, d * j + l]
                    if math.isnan(y):
                        continue
                    v_ = y - (c[0] if l == 0 else (c[1] if l == 1 else c[2]))
                    if kind != UNIT_VECTOR and l == 0:
                        v_ = wrapped(v_)
                    weight = 1.0 / variance(kind, l, c[1], quality[r, k, d * j + l], table)
                    for p in range(3):
                        hp = weight * h[l, p]
                        g[p] += hp * v_
                        for q in range(p + 1):
                            A[p, q] += hp * h[l, q]
            cholesky(P, L)
            for i in range(n):  # AL = A L[:3], b = L[:3]^T g
                b[i] = L[0, i] * g[0] + L[1, i] * g[1] + L[2, i] * g[2]
                AL[0, i] = A[0, 0] * L[0, i] + A[1, 0] * L[1, i] + A[2, 0] * L[2, i]
                AL[1, i] = A[1, 0] * L[0, i] + A[1, 1] * L[1, i] + A[2, 1] * L[2, i]
                AL[2, i] = A[2, 0] * L[0, i] + A[2, 1] * L[1, i] + A[2, 2] * L[2, i]
            for i in range(n):
                for j in range(i + 1):
                    M[i, j] = L[0, i] * AL[0, j] + L[1, i] * AL[1, j] + L[2, i] * AL[2, j]
                    V[i, j] = 0.0
                for j in range(i, n):
                    V[i, j] = L[j, i]
                M[i, i] += 1.0
            cholesky(M, G)
            forward(G, V, b)
            conclude(x, P, V, b)
            for p in range(3):
                means[r, k, p] = x[p]
                for q in range(3):
                    covariances[r, k, p, q] = P[p, q]


@kernel(types.void(*ARGUMENTS, types.float64, types.intp))
def ukf(kind, x0, P0, F, Q, Y, quality, position, rotation, table, means, covariances, lambda_, form):
    """UKF of each replication with 2 n + 1 sigma points; `form` AVERAGED or CENTRE, the rest as for `ekf`."""
    (R, T, m), (B, n) = Y.shape, (position.shape[1], x0.shape[1])
    d, S = m // B, 2 * n + 1
    x, work = np.empty(n), np.empty(n)
    P, L, FP = np.empty((n, n)), np.zeros((n, n)), np.empty((n, n))
    point, z, image = np.empty((S, n)), np.empty(S), np.empty((S, 3))
    M, G, V, b = np.empty((S, S)), np.zeros((S, S)), np.empty((S, n)), np.empty(S)
    weight = np.full(S, 0.5 / (n + lambda_))
    weight[0] = lambda_ / (n + lambda_)
    root, spread = np.sqrt(weight), math.sqrt(n + lambda_)
    for r in range(R):
        a = r if len(position) > 1 else 0
        x[:] = x0[r]
        P[:] = P0
        for k in range(T):
            predict(x, P, F, Q, FP, work)
            cholesky(P, L)
            for i in range(n):
                point[0, i] = x[i]
                V[0, i] = 0.0
                b[0] = 0.0
                for l in range(n):
                    step = spread * L[i, l]
                    point[1 + l, i], point[1 + n + l, i] = x[i] + step, x[i] - step
                    V[1 + l, i], V[1 + n + l, i] = root[1] * step, -root[1] * step
            for i in range(S):
                b[i] = 0.0
                for j in range(i + 1):
                    M[i, j] = 0.0
                M[i, i] = 1.0
            for j in range(B):
                for s in range(S):
                    u, v, w = seen_from(point[s], position[a, j], rotation[a, j])
                    image[s, 0], image[s, 1], image[s, 2] = direction(kind, u, v, w)
                for l in range(d):
                    y = Y[r, k, d * j + l]
                    if math.isnan(y):
                        continue
                    nominal = quality[r, k, d * j + l]
                    angle = kind != UNIT_VECTOR and l == 0
                    mean, var = 0.0, 0.0
                    for s in range(S):
                        z[s] = image[s, l] - image[0, l]
                        if angle:
                            z[s] = wrapped(z[s])
                        mean += weight[s] * z[s]
                        if form == AVERAGED:
                            var += weight[s] * variance(kind, l, image[s, 1], nominal, table)
                    if form == CENTRE:
                        var = variance(kind, l, image[0, 1], nominal, table)
                    v_ = y - (image[0, l] + mean)
                    if angle:
                        v_ = wrapped(v_)
                    for s in range(S):
                        z[s] = root[s] * (z[s] - mean)
                    for s in range(S):
                        zw = z[s] / var
                        b[s] += zw * v_
                        for q in range(s + 1):
                            M[s, q] += zw * z[q]
            cholesky(M, G)
            forward(G, V, b)
            conclude(x, P, V, b)
            for p in range(3):
                means[r, k, p] = x[p]
                for q in range(3):
                    covariances[r, k, p, q] = P[p, q]
