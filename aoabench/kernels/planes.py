"""Least squares on azimuth and elevation, one fix after the other: positions and covariances.

The arithmetic of `least_squares.py`. The loops over the anchors have no calls, so that the compiler
vectorises them.
"""

from __future__ import annotations

import math

from aoabench.kernels.angles import sine_cosine
from aoabench.kernels.compile import inlined
from aoabench.kernels.small import inverse, solve

PRINTED, INVARIANT = range(2)  # the elevation's rows
SAME_PLACE = 1e-12  # as in maths.linalg
FLOOR = 1e-8  # rad^2: PRECISION^2 of estimators.rays
UNKNOWN = math.nan


@inlined
def planes(rows, phi, theta, wa, we, s, R):
    """Least-squares position of one fix from its angles (B,), relative to the origin of s (3, B); R
    (3, 3, B).

    Also returns whether the equations determine it, the number of anchors that measured, whether
    these stand in more than one place (planes through one place meet there for all measurements),
    and the number of angles.
    """
    a00 = a10 = a11 = a20 = a21 = a22 = g0 = g1 = g2 = 0.0
    n = mx = my = mz = m2 = angles = 0.0
    for j in range(len(phi)):
        sp, cp = sine_cosine(phi[j])
        st, ct = sine_cosine(theta[j])
        first = 1.0 if wa[j] > 0.0 else 0.0
        x = first * (R[0, 0, j] * sp - R[1, 0, j] * cp)
        y = first * (R[0, 1, j] * sp - R[1, 1, j] * cp)
        z = first * (R[0, 2, j] * sp - R[1, 2, j] * cp)
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
        angles += first + (1.0 if we[j] > 0.0 else 0.0)
        n += first
        mx += first * s[0, j]
        my += first * s[1, j]
        mz += first * s[2, j]
        m2 += first * (s[0, j] * s[0, j] + s[1, j] * s[1, j] + s[2, j] * s[2, j])
    x, y, z, sound = solve(a00, a10, a11, a20, a21, a22, g0, g1, g2)
    between = n * m2 - mx * mx - my * my - mz * mz
    return x, y, z, sound, n, between > SAME_PLACE * n * m2, angles


@inlined
def spread_of_planes(rows, stated, x, y, z, phi, theta, wa, we, s, R, P):
    """Covariance of the least-squares position (x, y, z) into P (3, 3), A^-1 M A^-1, where M is the
    covariance of the equations' right side; and whether the position lies behind an anchor.

    The rows a, b of an anchor change with its angles: the azimuth moves a by f and b by h, the
    elevation b by k. M sums var_a (f a + h b) (f a + h b)^T + var_e k^2 b b^T. N sums a a^T / f^2 +
    b b^T / k^2; it gives the residuals' degrees of freedom.
    """
    a00 = a10 = a11 = a20 = a21 = a22 = 0.0
    m00 = m10 = m11 = m20 = m21 = m22 = squares = back = 0.0
    n00 = n10 = n11 = n20 = n21 = n22 = angles = 0.0
    for j in range(len(phi)):
        sp, cp = sine_cosine(phi[j])
        st, ct = sine_cosine(theta[j])
        dx, dy, dz = x - s[0, j], y - s[1, j], z - s[2, j]
        u = R[0, 0, j] * dx + R[0, 1, j] * dy + R[0, 2, j] * dz
        v = R[1, 0, j] * dx + R[1, 1, j] * dy + R[1, 2, j] * dz
        w = R[2, 0, j] * dx + R[2, 1, j] * dy + R[2, 2, j] * dz
        one = 1.0 if wa[j] > 0.0 else 0.0
        two = 1.0 if wa[j] * we[j] > 0.0 else 0.0
        p = st / ct if rows == PRINTED else st * cp
        q = 0.0 if rows == PRINTED else st * sp
        t = cp if rows == PRINTED else ct
        f = cp * u + sp * v
        h = sp * w if rows == PRINTED else st * (cp * v - sp * u)
        k = u / (ct * ct) if rows == PRINTED else ct * f + st * w
        ax = one * (R[0, 0, j] * sp - R[1, 0, j] * cp)
        ay = one * (R[0, 1, j] * sp - R[1, 1, j] * cp)
        az = one * (R[0, 2, j] * sp - R[1, 2, j] * cp)
        bx = two * (R[0, 0, j] * p + R[1, 0, j] * q - R[2, 0, j] * t)
        by = two * (R[0, 1, j] * p + R[1, 1, j] * q - R[2, 1, j] * t)
        bz = two * (R[0, 2, j] * p + R[1, 2, j] * q - R[2, 2, j] * t)
        va = 1.0 / wa[j] if one > 0.0 else 0.0
        ve = k * k / we[j] if two > 0.0 else 0.0
        e = ax * dx + ay * dy + az * dz
        g = bx * dx + by * dy + bz * dz
        back += 1.0 if (one > 0.0) & ((ct * f + st * w if two > 0.0 else f) < 0.0) else 0.0
        squares += e * e / (e * e + f * f) if one > 0.0 else 0.0  # sin^2 of the residual angle
        squares += g * g / (g * g + k * k) if two > 0.0 else 0.0
        a00 += ax * ax + bx * bx
        a10 += ax * ay + bx * by
        a11 += ay * ay + by * by
        a20 += ax * az + bx * bz
        a21 += ay * az + by * bz
        a22 += az * az + bz * bz
        cx, cy, cz = f * ax + h * bx, f * ay + h * by, f * az + h * bz
        i = one / (f * f) if one > 0.0 else 0.0
        l = two / (k * k) if two > 0.0 else 0.0
        angles += one + two
        n00 += i * ax * ax + l * bx * bx
        n10 += i * ax * ay + l * bx * by
        n11 += i * ay * ay + l * by * by
        n20 += i * ax * az + l * bx * bz
        n21 += i * ay * az + l * by * bz
        n22 += i * az * az + l * bz * bz
        m00 += va * cx * cx + ve * bx * bx
        m10 += va * cx * cy + ve * bx * by
        m11 += va * cy * cy + ve * by * by
        m20 += va * cx * cz + ve * bx * bz
        m21 += va * cy * cz + ve * by * bz
        m22 += va * cz * cz + ve * bz * bz
    p00, p10, p11, p20, p21, p22 = sandwich(
        inverse(a00, a10, a11, a20, a21, a22), m00, m10, m11, m20, m21, m22
    )
    freedom = p00 * n00 + p11 * n11 + p22 * n22 + 2.0 * (p10 * n10 + p20 * n20 + p21 * n21)
    freedom = angles - 6.0 + freedom if angles > 3.0 else 0.0
    fill(P, 1.0 if stated else scale(squares, freedom), p00, p10, p11, p20, p21, p22)
    return back > 0.0


@inlined
def sandwich(inner, m00, m10, m11, m20, m21, m22):
    """The elements 00, 10, 11, 20, 21, 22 of B M B, B symmetric and given by these elements."""
    b00, b10, b11, b20, b21, b22 = inner
    t00, t01, t02 = (
        b00 * m00 + b10 * m10 + b20 * m20,
        b00 * m10 + b10 * m11 + b20 * m21,
        b00 * m20 + b10 * m21 + b20 * m22,
    )
    t10, t11, t12 = (
        b10 * m00 + b11 * m10 + b21 * m20,
        b10 * m10 + b11 * m11 + b21 * m21,
        b10 * m20 + b11 * m21 + b21 * m22,
    )
    t20, t21, t22 = (
        b20 * m00 + b21 * m10 + b22 * m20,
        b20 * m10 + b21 * m11 + b22 * m21,
        b20 * m20 + b21 * m21 + b22 * m22,
    )
    return (
        t00 * b00 + t01 * b10 + t02 * b20,
        t10 * b00 + t11 * b10 + t12 * b20,
        t10 * b10 + t11 * b11 + t12 * b21,
        t20 * b00 + t21 * b10 + t22 * b20,
        t20 * b10 + t21 * b11 + t22 * b21,
        t20 * b20 + t21 * b21 + t22 * b22,
    )


@inlined
def scale(squares, freedom):
    """Variance of an angle from the sum of squared residuals; NaN without a degree of freedom."""
    return max(squares / freedom, FLOOR) if freedom > 0.0 else UNKNOWN


@inlined
def fill(P, c, p00, p10, p11, p20, p21, p22):
    """Write a symmetric matrix, times c, into P (3, 3)."""
    P[0, 0], P[1, 1], P[2, 2] = c * p00, c * p11, c * p22
    P[0, 1] = P[1, 0] = c * p10
    P[0, 2] = P[2, 0] = c * p20
    P[1, 2] = P[2, 1] = c * p21
