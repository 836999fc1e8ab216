"""Kernels of the snapshot estimators: least squares and Gauss-Newton on azimuth and elevation, one
fix after the other.

The arithmetic of `least_squares.py` and `maximum_likelihood.py`. Within a fix the loops run over
the anchors, padded with weight 0 to a multiple of `LANES`, without calls, so that the compiler
vectorises them; no fix sees another one.

Kernels may use nothing but this file: the cache on disk sees only its own.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numba import njit, types

LANES = 4
ARCTAN, ATAN2, KCORR = range(3)  # what an azimuth's difference means
AS_MEANT, SIGN, SWAPPED = range(3)  # errata as printed
PRINTED, INVARIANT = range(2)  # the elevation's rows
OK, OSCILLATED, DIVERGED, FAILED = 0, 2, 3, 4  # outcomes, as in aoabench.types

OPTIONS: dict[str, Any] = {"fastmath": {"contract", "reassoc", "nsz"}, "error_model": "numpy"}
TURN, HALF_PI = 2.0 * math.pi, 0.5 * math.pi
SINGULAR, FAR, TINY = 1e-12, 1e9, 1e-300


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

# ------------------------------------------------------------------- angles, to the last bits of do

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
_S1, _S2, _S3, _S4 = (
    -0.166666666666666666,
    0.00833333333333332026,
    -0.000198412698412530222,
    2.75573192133478667e-6,
)
_S5, _S6, _S7 = -2.50521047273601406e-8, 1.60583462371199003e-10, -7.57779904448778001e-13
_C1, _C2, _C3, _C4 = (
    -0.499999999999999993,
    0.0416666666666664288,
    -0.00138888888888588082,
    0.0000248015872828235969,
)
_C5, _C6, _C7 = -2.75573128463784456e-7, 2.08755527170372636e-9, -1.13520037105950103e-11
_REST = 6.123233995736766e-17  # pi / 2 = HALF_PI + _REST


@inlined
def arctan(t):
    """atan(t), 0 <= t <= 1, halved twice."""
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
def sine_cosine(x):
    """sin(x) and cos(x), |x| < 1e5."""
    q = np.rint(x / HALF_PI)
    r = (x - q * HALF_PI) - q * _REST
    u = r * r
    s = r + r * u * (_S1 + u * (_S2 + u * (_S3 + u * (_S4 + u * (_S5 + u * (_S6 + u * _S7))))))
    c = 1.0 + u * (_C1 + u * (_C2 + u * (_C3 + u * (_C4 + u * (_C5 + u * (_C6 + u * _C7))))))
    quarter = q - 4.0 * np.floor(0.25 * q)
    odd = (quarter == 1.0) | (quarter == 3.0)
    a = c if odd else s
    b = s if odd else c
    return -a if quarter >= 2.0 else a, -b if (quarter == 1.0) | (quarter == 2.0) else b


# --------------------------------------------------------------------------------------------------


@inlined
def solve(a00, a10, a11, a20, a21, a22, g0, g1, g2):
    """A^-1 g by Cholesky and whether the pivots are sound."""
    l10, l20 = a10 / a00, a20 / a00
    d1 = a11 - l10 * a10
    e = a21 - l20 * a10
    l21 = e / d1
    d2 = a22 - l20 * a20 - l21 * e
    y1 = g1 - l10 * g0
    z = (g2 - l20 * g0 - l21 * y1) / d2
    y = y1 / d1 - l21 * z
    x = g0 / a00 - l10 * y - l20 * z
    return x, y, z, (a00 > 0.0) & (d1 > SINGULAR * a11) & (d2 > SINGULAR * a22)


@inlined
def planes(rows, phi, theta, wa, we, s, R):
    """Least-squares position from one fix's angles (B,), relative to the origin of s (3, B); R (3,
    3, B).

    And whether the equations determine it: planes through one single place always meet there,
    whatever was measured.
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
    )  # sum of the squared distances between any two of them
    return x, y, z, sound & (apart > SINGULAR * n * m2)


@inlined
def update(azimuth, printed, x, y, z, phi, theta, wa, we, s, R):
    """One Gauss-Newton step from (x, y, z) and whether its normal matrix is sound."""
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


def given(dimensions: int) -> types.Array:
    """The type of an array of doubles that is only read."""
    return types.Array(types.float64, dimensions, "C", readonly=True)


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
    """Position x (N, 3), outcome and number of updates (N,) of each fix from its angles (N, B).

    wa, we (N, B): 1 / variance, 0 where not measured (the angle is then any number); s (3, B)
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
