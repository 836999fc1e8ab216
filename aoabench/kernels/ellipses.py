"""Ellipses in a plane: projection of uncertain angles, crossings of two, areas of several.

The functions compute the same as `estimators/ellipses.py`. `project` runs over blocks of `BLOCK`
fixes, padded with NaN. It contains no calls or branches, so that the compiler vectorises it.
"""

from __future__ import annotations

import math

from aoabench.kernels.angles import TURN, sine_cosine
from aoabench.kernels.compile import called, inlined
from aoabench.kernels.small import ascending, has

BLOCK = 64
MIDPOINT, ESTIMATE = range(2)  # centre of an ellipse
# rows of an ellipse: centre, direction of a, half-axes a and b, half sides of its box; and the
# coefficients of u . (p - s) = AX x + AY y + AC, with the measured ray u of the anchor at s
MX, MY, UX, UY, A, B, HX, HY, AX, AY, AC = range(11)
ROWS = 11
UNKNOWN, SAME = -2, -1  # in place of a number of crossings: not yet computed; equal ellipses

TOUCH = 1e-9  # tolerance for rounding of a level of 1, as in estimators/ellipses.py
CLOSE, TINY = 1e-7, 1e-140
POLE = 1e-6  # as in estimators.rays


@inlined
def on_plane(x, y, z, R, h, side, least):
    """f of (12) and (14): the point x, y m, relative to the anchor, where the ray (x, y, z) in the
    anchor's frame meets the plane.

    h: distance m of the plane; side: 1 if the plane is above the anchor, else -1.
    """
    u = R[0, 0] * x + R[1, 0] * y + R[2, 0] * z
    v = R[0, 1] * x + R[1, 1] * y + R[2, 1] * z
    w = R[0, 2] * x + R[1, 2] * y + R[2, 2] * z
    reach = h / max(side * w, least * math.sqrt(u * u + v * v) + TINY)
    return reach * u, reach * v


@inlined
def project(centre, azimuth, elevation, s, R, to_plane, least, sines, minimum, e):
    """Ellipses e (ROWS, BLOCK) from angles (BLOCK,) rad of one anchor with position s (3,) m and
    rotation R (3, 3).

    to_plane: height m of the plane above the anchor; minimum: lower limit m of the half-axes;
    centre: MIDPOINT or ESTIMATE; least: tangent of the smallest angle between ray and plane; sines:
    sin, cos of the azimuth's deviation, then of the elevation's.
    """
    h, side = abs(to_plane), math.copysign(1.0, to_plane)
    sa, ca, se, ce = sines[0], sines[1], sines[2], sines[3]
    for k in range(BLOCK):
        st, ct = sine_cosine(azimuth[k])
        z, r = sine_cosine(elevation[k])
        x, y = r * ct, r * st
        u = R[0, 0] * x + R[1, 0] * y + R[2, 0] * z
        v = R[0, 1] * x + R[1, 1] * y + R[2, 1] * z
        w = R[0, 2] * x + R[1, 2] * y + R[2, 2] * z
        e[AX, k], e[AY, k], e[AC, k] = u, v, w * to_plane - u * s[0] - v * s[1]
        lowest = least * math.sqrt(u * u + v * v)
        low = side * w < lowest
        away = (side * w < 0.0) & (u * u + v * v < POLE * POLE)  # straight away: no azimuth
        w = side * lowest
        lx = R[0, 0] * u + R[0, 1] * v + R[0, 2] * w
        ly = R[1, 0] * u + R[1, 1] * v + R[1, 2] * w
        lz = R[2, 0] * u + R[2, 1] * v + R[2, 2] * w
        lr = math.sqrt(lx * lx + ly * ly)
        over = 1.0 / (lr + TINY)
        x, y, z, r = lx if low else x, ly if low else y, lz if low else z, lr if low else r
        ct, st = lx * over if low else ct, ly * over if low else st
        fx, fy = on_plane(
            ce * x - se * z * ct, ce * y - se * z * st, ce * z + se * r, R, h, side, least
        )
        nx, ny = on_plane(
            ce * x + se * z * ct, ce * y + se * z * st, ce * z - se * r, R, h, side, least
        )
        px, py = on_plane(x, y, z, R, h, side, least)
        mx, my = (
            px if centre == ESTIMATE else 0.5 * (fx + nx),
            py if centre == ESTIMATE else 0.5 * (fy + ny),
        )
        dx, dy = fx - nx, fy - ny
        length = math.sqrt(dx * dx + dy * dy)
        over = 1.0 / (length + TINY)
        ux, uy = dx * over if length > 0.0 else 1.0, dy * over if length > 0.0 else 0.0
        x = R[0, 0] * mx + R[0, 1] * my + R[0, 2] * to_plane
        y = R[1, 0] * mx + R[1, 1] * my + R[1, 2] * to_plane
        z = R[2, 0] * mx + R[2, 1] * my + R[2, 2] * to_plane
        fx, fy = on_plane(ca * x - sa * y, sa * x + ca * y, z, R, h, side, least)
        nx, ny = on_plane(ca * x + sa * y, ca * y - sa * x, z, R, h, side, least)
        dx, dy = fx - nx, fy - ny
        a, b = max(0.5 * length, minimum), max(0.5 * math.sqrt(dx * dx + dy * dy), minimum)
        e[MX, k], e[MY, k] = math.nan if away else s[0] + mx, s[1] + my
        e[UX, k], e[UY, k], e[A, k], e[B, k] = ux, uy, a, b
        e[HX, k] = math.sqrt(a * a * ux * ux + b * b * uy * uy)
        e[HY, k] = math.sqrt(a * a * uy * uy + b * b * ux * ux)


@inlined
def seen_from(x, y, i, e):
    """The point (x, y) in the frame where the i-th ellipse is the unit circle."""
    dx, dy = x - e[MX, i], y - e[MY, i]
    return (dx * e[UX, i] + dy * e[UY, i]) / e[A, i], (dy * e[UX, i] - dx * e[UY, i]) / e[B, i]


@inlined
def level(x, y, i, e):
    """(p - mu_i)^T Sigma_i^-1 (p - mu_i) at p = (x, y)."""
    u, v = seen_from(x, y, i, e)
    return u * u + v * v


@inlined
def outer_extremum(near, far, gap):
    """The root delta > 0 of near^2 / delta^2 + far^2 / (delta + gap)^2 = 1, by Newton's method
    from below on 1 / sqrt of the left side.
    """
    delta = max(near, far - gap)
    for _ in range(50):
        a, b = 1.0 / delta, 1.0 / (delta + gap)
        p, q = (near * a) ** 2, (far * b) ** 2
        f = p + q
        excess = math.sqrt(f) - 1.0
        delta += excess * f / (p * a + q * b)
        if excess < CLOSE:
            break
    return delta


@inlined
def inner_extremum(near, far, gap):
    """The smaller root delta < gap of near^2 / delta^2 + far^2 / (gap - delta)^2 = 1; -1 if it does
    not exist.
    """
    delta = near
    for _ in range(50):
        a, b = 1.0 / delta, 1.0 / (gap - delta)
        p, q = (near * a) ** 2, (far * b) ** 2
        excess, slope = p + q - 1.0, 2.0 * (p * a - q * b)
        if slope <= 0.0:
            return -1.0
        delta += excess / slope
        if delta >= gap:
            return -1.0
        if excess < CLOSE:
            break
    return delta


@inlined
def unit(x, y):
    """(x, y) scaled to length 1."""
    over = 1.0 / math.sqrt(x * x + y * y)
    return x * over, y * over


@inlined
def excess_at(c, s, q):
    """Level minus 1 at (c, s) on the unit circle: |q0 + q1 c + q2 s|^2 - 1."""
    u, v = q[0] + q[1] * c + q[2] * s, q[3] + q[4] * c + q[5] * s
    return u * u + v * v - 1.0


@called
def crossing(low, high, rising, q):
    """The angle in rad between `low` and `high` at which the level passes 1, by Newton's method,
    with bisection if a step leaves the bracket.
    """
    t = 0.5 * (low + high)
    for _ in range(80):
        s, c = sine_cosine(t)
        u, v = q[0] + q[1] * c + q[2] * s, q[3] + q[4] * c + q[5] * s
        g = u * u + v * v - 1.0
        if (g < 0.0) == rising:
            low = t
        else:
            high = t
        before, t = t, t - 0.5 * g / (u * (q[2] * c - q[1] * s) + v * (q[5] * c - q[4] * s))
        if not (low <= t <= high):
            t = 0.5 * (low + high)
        if abs(t - before) < 1e-10:
            break
    return t


@called
def crossings(i, j, e, px, py):
    """Number of points where the boundaries of two ellipses cross or touch from outside, or SAME.

    The points go into px, py (4,). In the frame where the first ellipse is the unit circle, turned
    to the axes of the second's quadratic form, the extrema of the second's level on the circle
    solve a secular equation. The minimum lies in the first quadrant and the maximum in the third.
    The fourth quadrant may contain one more of each, of which the maximum is nearer to the first
    axis. A change of sign between neighbouring extrema brackets one crossing.
    """
    u0, v0 = seen_from(e[MX, i], e[MY, i], j, e)
    c, s = e[UX, i] * e[UX, j] + e[UY, i] * e[UY, j], e[UY, i] * e[UX, j] - e[UX, i] * e[UY, j]
    u1, u2 = e[A, i] * c / e[A, j], -e[B, i] * s / e[A, j]
    v1, v2 = e[A, i] * s / e[B, j], e[B, i] * c / e[B, j]
    d, o = 0.5 * (u1 * u1 + v1 * v1 - u2 * u2 - v2 * v2), u1 * u2 + v1 * v2
    r = math.sqrt(d * d + o * o)
    c, s = 1.0, 0.0
    if d >= 0.0 and r > 0.0:
        c = math.sqrt(0.5 * (1.0 + d / r))
        s = 0.5 * o / (r * c)
    elif r > 0.0:
        s = math.sqrt(0.5 * (1.0 - d / r))
        c = 0.5 * o / (r * s)
    u1, u2, v1, v2 = u1 * c + u2 * s, u2 * c - u1 * s, v1 * c + v2 * s, v2 * c - v1 * s
    x, y, gap = -(u0 * u1 + v0 * v1), -(u0 * u2 + v0 * v2), 2.0 * r
    flip, flop = math.copysign(1.0, x), math.copysign(1.0, y)
    x, y = max(abs(x), TINY), max(abs(y), TINY)
    q = (u0, u1 * flip, u2 * flop, v0, v1 * flip, v2 * flop)

    delta = outer_extremum(y, x, gap)
    x0, y0 = unit(x / (delta + gap), y / delta)
    least = excess_at(x0, y0, q)
    if least > TOUCH:
        return 0
    delta = outer_extremum(x, y, gap)
    x1, y1 = unit(x / delta, y / (delta + gap))
    most = excess_at(-x1, -y1, q)
    if most <= TOUCH and least >= -TOUCH:
        return SAME
    if most <= 0.0:
        return 0
    first, n = math.atan2(y0, x0), 1
    px[0] = first
    if least <= 0.0:
        last = math.atan2(y1, x1) - math.pi
        px[0] = crossing(first, last + TURN, True, q)
        peak = valley = -1.0
        if gap * gap > x * x + y * y:
            peak, valley = inner_extremum(x, y, gap), inner_extremum(y, x, gap)
        if peak > 0.0 and valley > 0.0:
            x0, y0 = unit(x / peak, -y / (gap - peak))
            x1, y1 = unit(x / (gap - valley), -y / valley)
            stops = (math.atan2(y0, x0), math.atan2(y1, x1), last)
            values = (excess_at(x0, y0, q), excess_at(x1, y1, q), most)
            t, g = first, least
            for part in range(3):
                if (g > 0.0) != (values[part] > 0.0):
                    px[n] = crossing(stops[part], t, g > 0.0, q)
                    n += 1
                t, g = stops[part], values[part]
        else:
            px[1] = crossing(last, first, False, q)
            n = 2
    for k in range(n):
        y, x = sine_cosine(px[k])
        x, y = x * flip, y * flop
        x, y = e[A, i] * (c * x - s * y), e[B, i] * (s * x + c * y)
        px[k], py[k] = (
            e[MX, i] + x * e[UX, i] - y * e[UY, i],
            e[MY, i] + x * e[UY, i] + y * e[UX, i],
        )
    return n


@called
def area_ratio(M, n, e, points, number, order, t):
    """Ratio (19) of the ellipses in the set M, by Green's theorem over arcs between crossings."""
    m = 0
    for i in range(n):
        if has(M, i, n):
            order[m] = i
            for k in range(m):
                j = order[k]
                if number[j, i] == UNKNOWN:
                    number[j, i] = crossings(j, i, e, points[0, j, i], points[1, j, i])
                if number[j, i] == SAME:
                    m -= 1  # equal ellipses are counted once
                    break
            m += 1
    x0, y0 = e[MX, order[0]], e[MY, order[0]]
    common = union = 0.0
    for k in range(m):
        i, arcs = order[k], 0
        for l in range(m):
            p, q = min(i, order[l]), max(i, order[l])
            if l != k:
                for c in range(number[p, q]):
                    u, v = seen_from(points[0, p, q, c], points[1, p, q, c], i, e)
                    t[arcs] = math.atan2(v, u)
                    arcs += 1
        ascending(t, arcs)
        if arcs == 0:
            t[0], arcs = 0.0, 1
        t[arcs] = t[0] + TURN
        for c in range(arcs):
            x, y = on_boundary(0.5 * (t[c] + t[c + 1]), i, e)
            inside = outside = True
            for l in range(m):
                if l != k:
                    within = level(x, y, order[l], e) < 1.0
                    inside, outside = inside & within, outside & (not within)
            if inside or outside:
                (px, py), (qx, qy) = on_boundary(t[c], i, e), on_boundary(t[c + 1], i, e)
                turned = (e[MX, i] - x0) * (qy - py) - (e[MY, i] - y0) * (qx - px)
                area = 0.5 * (e[A, i] * e[B, i] * (t[c + 1] - t[c]) + turned)
                common += area if inside else 0.0
                union += area if outside else 0.0
    return common / union


@inlined
def on_boundary(t, i, e):
    """The boundary point of the i-th ellipse at the angle t."""
    s, c = sine_cosine(t)
    x, y = e[A, i] * c, e[B, i] * s
    return e[MX, i] + x * e[UX, i] - y * e[UY, i], e[MY, i] + x * e[UY, i] + y * e[UX, i]
