"""Measured rays of one fix, and the point nearest to them.

The arithmetic of `estimators/rays.py` and `lines.py`. Positions are relative to the centre of all
anchors. `ahead` (3, B): unit vectors, 0 where not measured; `v` (3, B): the same, or the normal of
the plane where the azimuth alone is measured; line, plane (B,): 1 where the ray is such, else 0.
"""

from __future__ import annotations

import math

from aoabench.kernels.angles import sine_cosine
from aoabench.kernels.compile import inlined, inlined_ordered
from aoabench.kernels.small import solve

SAME_PLACE = 1e-12  # as in maths.linalg
FLOOR = 1e-8  # rad^2: PRECISION^2 of estimators.rays
UNKNOWN = math.nan


@inlined
def centred(B, s, q):
    """The centre of the first B anchors s (3, B), and their positions relative to it into q."""
    cx = cy = cz = 0.0
    for j in range(B):
        cx += s[0, j]
        cy += s[1, j]
        cz += s[2, j]
    cx, cy, cz = cx / B, cy / B, cz / B
    for j in range(s.shape[1]):
        q[0, j], q[1, j], q[2, j] = s[0, j] - cx, s[1, j] - cy, s[2, j] - cz
    return cx, cy, cz


@inlined
def extent2(q):
    """The square of the largest distance of the anchors q (3, B) from the origin."""
    most = 0.0
    for j in range(q.shape[1]):
        most = max(most, q[0, j] * q[0, j] + q[1, j] * q[1, j] + q[2, j] * q[2, j])
    return most


@inlined_ordered  # the cosine of a quarter turn is 6e-17, as in NumPy
def cast(phi, theta, R, ahead, v, line, plane, level):
    """The rays of angles phi, theta (B,), NaN where not measured, and the cosines of the elevations
    into level (B,); R (3, 3, B).
    """
    for j in range(len(phi)):
        known = phi[j] == phi[j]
        both = known & (theta[j] == theta[j])
        sp, cp = sine_cosine(phi[j] if known else 0.0)
        st, ct = sine_cosine(theta[j] if both else 0.0)
        a, b = ct * cp, ct * sp
        one = 1.0 if known else 0.0
        line[j] = 1.0 if both else 0.0
        plane[j] = one - line[j]
        level[j] = ct
        x = one * (a * R[0, 0, j] + b * R[1, 0, j] + st * R[2, 0, j])
        y = one * (a * R[0, 1, j] + b * R[1, 1, j] + st * R[2, 1, j])
        z = one * (a * R[0, 2, j] + b * R[1, 2, j] + st * R[2, 2, j])
        ahead[0, j], ahead[1, j], ahead[2, j] = x, y, z
        v[0, j] = x if both else one * (cp * R[1, 0, j] - sp * R[0, 0, j])
        v[1, j] = y if both else one * (cp * R[1, 1, j] - sp * R[0, 1, j])
        v[2, j] = z if both else one * (cp * R[1, 2, j] - sp * R[0, 2, j])


@inlined
def drop(k, ahead, v, line, plane):
    """Count the ray of anchor k as not measured."""
    line[k] = plane[k] = 0.0
    for i in range(3):
        ahead[i, k] = v[i, k] = 0.0


@inlined
def projectors(weight, v, line, plane):
    """Elements 00, 10, 11, 20, 21, 22 of the sum of the rays' projectors, with weights (B,)."""
    a00 = a10 = a11 = a20 = a21 = a22 = n = 0.0
    for j in range(len(line)):
        c = weight[j] * (plane[j] - line[j])
        x, y, z = c * v[0, j], c * v[1, j], c * v[2, j]
        a00 += x * v[0, j]
        a10 += x * v[1, j]
        a11 += y * v[1, j]
        a20 += x * v[2, j]
        a21 += y * v[2, j]
        a22 += z * v[2, j]
        n += weight[j] * line[j]
    return a00 + n, a10, a11 + n, a20, a21, a22 + n


@inlined
def nearest(q, v, line, plane, one):
    """The point nearest to the rays, whether they determine it, whether z is not determined, and
    the sum of the projectors; one (B,): ones.
    """
    gx = gy = gz = lines = 0.0
    for j in range(len(line)):
        along = (plane[j] - line[j]) * (v[0, j] * q[0, j] + v[1, j] * q[1, j] + v[2, j] * q[2, j])
        gx += line[j] * q[0, j] + along * v[0, j]
        gy += line[j] * q[1, j] + along * v[1, j]
        gz += line[j] * q[2, j] + along * v[2, j]
        lines += line[j]
    a00, a10, a11, a20, a21, a22 = projectors(one, v, line, plane)
    level = (lines == 0.0) & (a22 <= 1e-12 * (a00 + a11))
    a22 += 1.0 if level else 0.0
    x, y, z, sound = solve(a00, a10, a11, a20, a21, a22, gx, gy, gz)
    return x, y, z, sound, level, (a00, a10, a11, a20, a21, a22)


@inlined
def distances(x, y, z, q, ahead, v, plane, d):
    """Distances of a point from the rays into d (B,), 0 where not measured; the sum of squares."""
    squares = 0.0
    for j in range(len(plane)):
        a, b, c = x - q[0, j], y - q[1, j], z - q[2, j]
        e = ahead[1, j] * c - ahead[2, j] * b
        f = ahead[2, j] * a - ahead[0, j] * c
        g = ahead[0, j] * b - ahead[1, j] * a
        across = math.sqrt(e * e + f * f + g * g)
        away = abs(v[0, j] * a + v[1, j] * b + v[2, j] * c)
        d[j] = away if plane[j] > 0.0 else across
        squares += d[j] * d[j]
    return squares


@inlined
def several_places(q, line, plane, high):
    """Whether the anchors that measured stand in more than one place; `high` = 0: seen from above,
    else 1.
    """
    n = sx = sy = sz = squares = 0.0
    for j in range(len(line)):
        w = line[j] + plane[j]
        x, y, z = w * q[0, j], w * q[1, j], w * high * q[2, j]
        n += w
        sx += x
        sy += y
        sz += z
        squares += x * x + y * y + z * z
    return n * squares - (sx * sx + sy * sy + sz * sz) > SAME_PLACE * n * squares


@inlined
def lies_behind(x, y, z, known, q, ahead):
    """Whether a point lies behind an anchor that measured, at the anchor's height if z is not
    `known`.
    """
    back = 0.0
    for j in range(q.shape[1]):
        c = z - q[2, j] if known else 0.0
        along = ahead[0, j] * (x - q[0, j]) + ahead[1, j] * (y - q[1, j]) + ahead[2, j] * c
        back += 1.0 if along < 0.0 else 0.0
    return back > 0.0


@inlined
def residual_variance(squares, freedom):
    """Variance of an angle from the sum of squared residuals; NaN without a degree of freedom."""
    return max(squares / max(freedom, 1.0), FLOOR) if freedom > 0.0 else UNKNOWN
