"""Kernels of the snapshot estimators: least squares and Gauss-Newton on azimuth and elevation, one
fix after the other.

The kernels compute the same as `estimators/least_squares.py` and `maximum_likelihood.py`. Within a
fix the loops run over the anchors, padded with weight 0 to a multiple of `LANES`, and contain no
calls, so that the compiler vectorises them. Fixes are independent.
"""

from __future__ import annotations

import math

import numpy as np
from numba import types

from aoabench.kernels.angles import HALF_PI, TURN, angle, sine_cosine
from aoabench.kernels.compile import given, inlined, kernel
from aoabench.kernels.small import DIVERGED, FAILED, OK, OSCILLATED, SINGULAR, solve

LANES = 4
ARCTAN, ATAN2, KCORR = range(3)  # definitions of the azimuth's difference
CORRECTED, SIGN, SWAPPED = range(3)  # erratum to run as printed: none, L1, L2
PRINTED, INVARIANT = range(2)  # equations of the elevation
FAR = 1e9  # m; an iteration beyond this distance diverges


@inlined
def planes(rows, phi, theta, wa, we, s, R):
    """Least-squares position x, y, z m from one fix's angles (B,) rad, and whether the equations
    determine it.

    The position and the anchors s (3, B) m have the same origin; R (3, 3, B). The equations do not
    determine a position if all anchors that measured are at one place, because their planes meet
    at this place for all measurements.
    """
    a00 = a10 = a11 = a20 = a21 = a22 = g0 = g1 = g2 = 0.0
    n = mx = my = mz = m2 = 0.0
    for j in range(len(phi)):
        sp, cp = sine_cosine(phi[j])
        st, ct = sine_cosine(theta[j])
        w = 1.0 if wa[j] > 0.0 else 0.0
        x = w * (R[0, 0, j] * sp - R[1, 0, j] * cp)
        y = w * (R[0, 1, j] * sp - R[1, 1, j] * cp)
        z = w * (R[0, 2, j] * sp - R[1, 2, j] * cp)
        p = st / ct if rows == PRINTED else st * cp
        q = 0.0 if rows == PRINTED else st * sp
        r = cp if rows == PRINTED else ct
        w = 1.0 if wa[j] * we[j] > 0.0 else 0.0
        u = w * (R[0, 0, j] * p + R[1, 0, j] * q - R[2, 0, j] * r)
        v = w * (R[0, 1, j] * p + R[1, 1, j] * q - R[2, 1, j] * r)
        t = w * (R[0, 2, j] * p + R[1, 2, j] * q - R[2, 2, j] * r)
        b = x * s[0, j] + y * s[1, j] + z * s[2, j]
        d = u * s[0, j] + v * s[1, j] + t * s[2, j]
        a00 += x * x + u * u
        a10 += x * y + u * v
        a11 += y * y + v * v
        a20 += x * z + u * t
        a21 += y * z + v * t
        a22 += z * z + t * t
        g0 += x * b + u * d
        g1 += y * b + v * d
        g2 += z * b + t * d
        w = 1.0 if wa[j] + we[j] > 0.0 else 0.0
        n += w
        mx += w * s[0, j]
        my += w * s[1, j]
        mz += w * s[2, j]
        m2 += w * (s[0, j] * s[0, j] + s[1, j] * s[1, j] + s[2, j] * s[2, j])
    x, y, z, sound = solve(a00, a10, a11, a20, a21, a22, g0, g1, g2)
    apart = (
        n * m2 - mx * mx - my * my - mz * mz
    )  # sum of the squared distances between all pairs of anchors
    return x, y, z, sound & (apart > SINGULAR * n * m2)


@inlined
def update(azimuth, printed, x, y, z, phi, theta, wa, we, s, R):
    """One Gauss-Newton step from (x, y, z), and whether its normal matrix is positive definite."""
    a00 = a10 = a11 = a20 = a21 = a22 = g0 = g1 = g2 = 0.0
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
    return solve(a00, a10, a11, a20, a21, a22, g0, g1, g2)


@kernel(
    types.void(
        types.intp,
        types.intp,
        types.intp,
        types.float64,
        types.intp,
        *(given(d) for d in (2, 2, 2, 2, 2, 3)),
        types.float64[:, ::1],
        types.int8[::1],
        types.float64[::1],
    )
)
def gauss_newton(
    azimuth, printed, rows, tolerance, updates, phi, theta, wa, we, s, R, x, outcome, count
):
    """Position x (N, 3) m, outcome and number of updates (N,) of each fix from angles (N, B) rad.

    wa, we (N, B): 1 / variance, 0 if not measured (the angle is then any number); s (3, B) m:
    anchors relative to the origin, R (3, 3, B). `updates` = 0: least squares alone.
    """
    for n in range(len(phi)):
        a, b, c, sound = planes(rows, phi[n], theta[n], wa[n], we[n], s, R)
        x[n, 0], x[n, 1], x[n, 2], outcome[n], count[n] = a, b, c, OK, 0
        if not sound:
            x[n, 0], x[n, 1], x[n, 2], outcome[n] = math.nan, math.nan, math.nan, FAILED
        elif updates > 0:
            outcome[n] = OSCILLATED
            for u in range(updates):
                da, db, dc, sound = update(
                    azimuth, printed, a, b, c, phi[n], theta[n], wa[n], we[n], s, R
                )
                a, b, c, count[n] = a + da, b + db, c + dc, u + 1
                if not (sound and a * a + b * b + c * c <= FAR * FAR):
                    outcome[n] = DIVERGED
                    break
                if da * da + db * db + dc * dc < tolerance * tolerance:
                    x[n, 0], x[n, 1], x[n, 2], outcome[n] = a, b, c, OK
                    break
