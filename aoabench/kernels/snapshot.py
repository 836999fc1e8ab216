"""Kernel of least squares and Gauss-Newton on azimuth and elevation, one fix after the other.

The arithmetic of `least_squares.py` and `maximum_likelihood.py`. Within a fix the loops run over
the anchors, padded with weight 0 to a multiple of `LANES`, without calls, so that the compiler
vectorises them; no fix sees another one.
"""

from __future__ import annotations

import math

import numpy as np
from numba import types

from aoabench.kernels.angles import HALF_PI, TURN, angle, sine_cosine
from aoabench.kernels.compile import given, inlined, kernel
from aoabench.kernels.planes import UNKNOWN, fill, planes, scale, spread_of_planes
from aoabench.kernels.small import (
    BEHIND,
    DIVERGED,
    FAILED,
    NO_CONVERGENCE,
    NO_DESCENT,
    NO_MEASUREMENT,
    NONE,
    OK,
    ONE_PLACE,
    OSCILLATED,
    TOO_FAR,
    TOO_FEW_ANCHORS,
    UNDETERMINED,
    inverse,
    solve,
)

LANES = 4
ARCTAN, ATAN2, KCORR = range(3)  # what an azimuth's difference means
CORRECTED, SIGN, SWAPPED = range(3)  # errata as printed
FAR = 1e6  # as in estimators.rays


@inlined
def is_behind(x, y, z, phi, theta, wa, we, s, R):
    """Whether (x, y, z) lies behind an anchor that measured: u . (p - s) < 0 for its ray u."""
    back = 0.0
    for j in range(len(phi)):
        sp, cp = sine_cosine(phi[j])
        st, ct = sine_cosine(theta[j])
        dx, dy, dz = x - s[0, j], y - s[1, j], z - s[2, j]
        u = R[0, 0, j] * dx + R[0, 1, j] * dy + R[0, 2, j] * dz
        v = R[1, 0, j] * dx + R[1, 1, j] * dy + R[1, 2, j] * dz
        w = R[2, 0, j] * dx + R[2, 1, j] * dy + R[2, 2, j] * dz
        flat = cp * u + sp * v
        ahead = ct * flat + st * w if we[j] > 0.0 else flat
        back += 1.0 if (wa[j] > 0.0) & (ahead < 0.0) else 0.0
    return back > 0.0


@inlined
def update(azimuth, printed, x, y, z, phi, theta, wa, we, s, R):
    """One Gauss-Newton step from (x, y, z), whether its normal matrix is sound, that matrix, and
    the sum of squared residuals, weighted, after the step.
    """
    a00 = a10 = a11 = a20 = a21 = a22 = g0 = g1 = g2 = squares = 0.0
    for j in range(len(phi)):
        dx, dy, dz = x - s[0, j], y - s[1, j], z - s[2, j]
        u = R[0, 0, j] * dx + R[0, 1, j] * dy + R[0, 2, j] * dz
        v = R[1, 0, j] * dx + R[1, 1, j] * dy + R[1, 2, j] * dz
        w = R[2, 0, j] * dx + R[2, 1, j] * dy + R[2, 2, j] * dz
        rho2 = u * u + v * v
        rho, r2 = math.sqrt(rho2), rho2 + w * w
        f = angle(v, u, rho) if printed != SWAPPED else angle(u, v, rho)
        if azimuth == ARCTAN:
            f = f - math.pi if f > HALF_PI else f
            f = f + math.pi if f < -HALF_PI else f
            m = phi[j] + HALF_PI
            d = m - math.pi * np.floor(m / math.pi) - HALF_PI - f
        else:
            f = f + TURN if f < 0.0 else f
            d = phi[j] - TURN * np.floor(phi[j] / TURN) - f
            if azimuth == KCORR:
                k = math.copysign(1.0 if abs(d) >= math.pi else 0.0, d)
                d = d - TURN * (-k if printed == SIGN else k)
        e = theta[j] - angle(w, rho, math.sqrt(r2))
        ia = (1.0 if printed != SWAPPED else -1.0) / rho2
        p = (u * R[1, 0, j] - v * R[0, 0, j]) * ia
        q = (u * R[1, 1, j] - v * R[0, 1, j]) * ia
        r = (u * R[1, 2, j] - v * R[0, 2, j]) * ia
        t = w / rho
        h = (rho * R[2, 0, j] - t * (u * R[0, 0, j] + v * R[1, 0, j])) / r2
        i = (rho * R[2, 1, j] - t * (u * R[0, 1, j] + v * R[1, 1, j])) / r2
        l = (rho * R[2, 2, j] - t * (u * R[0, 2, j] + v * R[1, 2, j])) / r2
        A, E = wa[j], we[j]
        a00 += A * p * p + E * h * h
        a10 += A * p * q + E * h * i
        a11 += A * q * q + E * i * i
        a20 += A * p * r + E * h * l
        a21 += A * q * r + E * i * l
        a22 += A * r * r + E * l * l
        g0 += A * p * d + E * h * e
        g1 += A * q * d + E * i * e
        g2 += A * r * d + E * l * e
        squares += A * d * d + E * e * e
    x, y, z, sound = solve(a00, a10, a11, a20, a21, a22, g0, g1, g2)
    squares -= g0 * x + g1 * y + g2 * z
    return x, y, z, sound, (a00, a10, a11, a20, a21, a22), squares


@inlined
def reach2(s):
    """The square of FAR times the largest distance of the anchors s (3, B) from the origin."""
    most = 0.0
    for j in range(s.shape[1]):
        most = max(most, s[0, j] * s[0, j] + s[1, j] * s[1, j] + s[2, j] * s[2, j])
    return most * (FAR * FAR)


@kernel(
    types.void(
        types.intp,
        types.intp,
        types.intp,
        types.intp,
        types.float64,
        types.intp,
        *(given(d) for d in (2, 2, 2, 2, 3, 4)),
        types.float64[:, ::1],
        types.float64[:, :, ::1],
        types.int8[::1],
        types.int8[::1],
        *(types.float64[::1] for _ in range(2)),
    )
)
def gauss_newton(
    azimuth, printed, rows, stated, tolerance, updates, phi, theta, wa, we, s, R, x, P,
    outcome, reason, count, used,
):  # fmt: skip
    """Position x (N, 3), covariance P (N, 3, 3), outcome, reason, number of updates and of anchors
    used (N,) of each fix from its angles (N, B).

    wa, we (N, B): 1 / variance, 0 where not measured (the angle is then any number); s (N|1, 3, B)
    anchors relative to the origin, R (N|1, 3, 3, B), of each fix or the same for all. `updates` =
    0: least squares alone. `stated`: the variances are stated; else the residuals give one. Beyond
    FAR times the largest distance of an anchor from the origin, a fix has diverged.

    An iterate that equals an earlier one comes back for ever, so that the fix oscillates. It is
    compared with the iterate after the last number of updates that is a power of two, which finds
    every period (R. P. Brent, BIT 20, 1980).
    """
    for n in range(len(phi)):
        i, j = min(n, len(s) - 1), min(n, len(R) - 1)
        one = phi[n], theta[n], wa[n], we[n], s[i], R[j]
        if n == 0 or i > 0:
            far2 = reach2(s[i])
        a, b, c, sound, anchors, distinct, angles = planes(rows, *one)
        x[n, 0], x[n, 1], x[n, 2], outcome[n], count[n] = a, b, c, OK, 0
        reason[n], used[n] = NONE, anchors
        P[n] = UNKNOWN
        if not (sound and distinct):
            x[n, 0], x[n, 1], x[n, 2], outcome[n] = UNKNOWN, UNKNOWN, UNKNOWN, FAILED
            reason[n] = UNDETERMINED if distinct else ONE_PLACE
            if anchors < 2.0:
                reason[n] = TOO_FEW_ANCHORS if anchors > 0.0 else NO_MEASUREMENT
            continue
        if updates > 0:
            outcome[n], reason[n], count[n] = OSCILLATED, NO_CONVERGENCE, updates
            earlier = a, b, c
            for u in range(updates):
                da, db, dc, sound, A, squares = update(azimuth, printed, a, b, c, *one)
                a, b, c = a + da, b + db, c + dc
                if not (sound and a * a + b * b + c * c <= far2):
                    outcome[n], reason[n] = DIVERGED, TOO_FAR if sound else NO_DESCENT
                    count[n] = u + 1
                    break
                if da * da + db * db + dc * dc < tolerance * tolerance:
                    x[n, 0], x[n, 1], x[n, 2], outcome[n], reason[n] = a, b, c, OK, NONE
                    v = 1.0 if stated else scale(squares, angles - 3.0)
                    fill(P[n], v, *inverse(A[0], A[1], A[2], A[3], A[4], A[5]))
                    count[n] = u + 1
                    break
                if a == earlier[0] and b == earlier[1] and c == earlier[2]:
                    break
                if u & (u + 1) == 0:
                    earlier = a, b, c
        a, b, c = x[n, 0], x[n, 1], x[n, 2]
        if updates == 0 or outcome[n] != OK:
            back = spread_of_planes(rows, stated, a, b, c, *one, P[n])
        else:
            back = is_behind(a, b, c, *one)
        if back and outcome[n] == OK:
            outcome[n], reason[n] = DIVERGED, BEHIND
