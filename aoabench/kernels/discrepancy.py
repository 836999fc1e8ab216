"""Kernels of the discrepancy filter: ellipses of a block of fixes at once, then each fix's vote and
fusion.

The arithmetic of `discrepancy.py` and `ellipses.py`. S1 runs over blocks of `BLOCK` fixes, padded
with NaN, without calls or branches, so that the compiler vectorises it; no fix sees another one. A
set of anchors is an integer whose most significant bit is the first anchor that measured: among
sets of one size, the larger integer comes first in the order of anchor numbers.

Kernels may use nothing but this file: the cache on disk sees only its own.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numba import njit, types

BLOCK = 64
MOST = 62  # anchors that can vote
MIDPOINT, ESTIMATE = range(2)  # what an ellipse is centred on
BOXES, EXACT, NO_VOTE = range(3)  # what must have a common point
AREA, FIRST = range(2)  # among several largest sets
OK, REJECTED, FAILED = 0, 1, 4  # outcomes, as in aoabench.types
MX, MY, UX, UY, A, B, HX, HY = range(
    8
)  # an ellipse: centre, direction of a, half-axes a and b, half sides of its box
UNKNOWN, SAME = -2, -1  # instead of a number of crossings

OPTIONS: dict[str, Any] = {"fastmath": {"contract", "reassoc", "nsz"}, "error_model": "numpy"}
TURN, HALF_PI = 2.0 * math.pi, 0.5 * math.pi
TOUCH, EVEN, LEAST_AXIS = 1e-9, 1e-9, 1e-6  # as in the reference
CLOSE, TINY = 1e-7, 1e-140


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
called = njit(**OPTIONS)

# ------------------------------------------------------------------------- sines, to the last bits

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


# ---------------------------------------------------------------------------------------------- S1:


@inlined
def on_plane(x, y, z, R, h, side, least):
    """f of (12) and (14): where the ray (x, y, z) of the anchor's frame meets the plane, from the
    anchor's foot on.
    """
    u = R[0, 0] * x + R[1, 0] * y + R[2, 0] * z
    v = R[0, 1] * x + R[1, 1] * y + R[2, 1] * z
    w = R[0, 2] * x + R[1, 2] * y + R[2, 2] * z
    reach = h / max(side * w, least * math.sqrt(u * u + v * v) + TINY)
    return reach * u, reach * v


@inlined
def project(centre, azimuth, elevation, s, R, to_plane, least, sines, minimum, e):
    """Ellipses e (8, BLOCK) from angles (BLOCK,) of one anchor: s (3,) m, R (3, 3), to_plane m its
    height over it.

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
        lowest = least * math.sqrt(u * u + v * v)
        low = side * w < lowest
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
        e[MX, k], e[MY, k] = s[0] + mx, s[1] + my
        e[UX, k], e[UY, k], e[A, k], e[B, k] = ux, uy, a, b
        e[HX, k] = math.sqrt(a * a * ux * ux + b * b * uy * uy)
        e[HY, k] = math.sqrt(a * a * uy * uy + b * b * ux * ux)


# ----------------------------------------------------------------------------------------- S2: the


@inlined
def count(M):
    """How many bits of the set M are 1."""
    M = M - ((M >> 1) & 0x5555555555555555)
    M = (M & 0x3333333333333333) + ((M >> 2) & 0x3333333333333333)
    return (((M + (M >> 4)) & 0x0F0F0F0F0F0F0F0F) * 0x0101010101010101) >> 56


@inlined
def has(M, i, n):
    """Whether the set M has the i-th of n anchors."""
    return (M >> (n - 1 - i)) & 1 == 1


@inlined
def insert(M, sets, found):
    """How many different sets there are, falling, after M has joined them; a larger one ousts all,
    a smaller none.
    """
    size = count(M)
    if size < 2 or (found > 0 and size < count(sets[0])):
        return found
    if found > 0 and size > count(sets[0]):
        found = 0
    k = found
    while k > 0 and sets[k - 1] < M:
        k -= 1
    if k > 0 and sets[k - 1] == M:
        return found
    for l in range(found, k, -1):
        sets[l] = sets[l - 1]
    sets[k] = M
    return found + 1


@inlined
def common_boxes(n, e, masks, sets):
    """The largest sets of boxes of ellipses e (8, n) with a common point, in `sets`, and how many
    there are.

    A common box has its lower left corner at the left side of one and the lower side of one.
    """
    for i in range(n):
        x, y = e[MX, i] - e[HX, i], e[MY, i] - e[HY, i]
        at_x, at_y = 0, 0
        for j in range(n):
            at_x = 2 * at_x + (1 if (e[MX, j] - e[HX, j] <= x) & (x <= e[MX, j] + e[HX, j]) else 0)
            at_y = 2 * at_y + (1 if (e[MY, j] - e[HY, j] <= y) & (y <= e[MY, j] + e[HY, j]) else 0)
        masks[0, i], masks[1, i] = at_x, at_y
    found, full = 0, (1 << n) - 1
    for i in range(n):
        for j in range(n):
            M = masks[0, i] & masks[1, j]
            found = insert(M, sets, found)
            if full == M:
                return found
    return found


@called
def box_ratio(M, n, e, order, x):
    """(19) of the boxes in the set M: their union slab by slab, between neighbouring left or right
    sides.
    """
    m = 0
    left = low = -np.inf
    right = top = np.inf
    for i in range(n):
        if has(M, i, n):
            left, right = max(left, e[MX, i] - e[HX, i]), min(right, e[MX, i] + e[HX, i])
            low, top = max(low, e[MY, i] - e[HY, i]), min(top, e[MY, i] + e[HY, i])
            k = m
            while k > 0 and e[MY, order[k - 1]] - e[HY, order[k - 1]] > e[MY, i] - e[HY, i]:
                order[k] = order[k - 1]
                k -= 1
            order[k] = i  # by rising lower sides
            x[2 * m], x[2 * m + 1] = e[MX, i] - e[HX, i], e[MX, i] + e[HX, i]
            m += 1
    ascending(x, 2 * m)
    union = 0.0
    for l in range(2 * m - 1):
        middle, covered, up = 0.5 * (x[l] + x[l + 1]), 0.0, -np.inf
        for k in range(m):
            i = order[k]
            if abs(middle - e[MX, i]) < e[HX, i]:
                upper = e[MY, i] + e[HY, i]
                covered += max(upper - max(up, e[MY, i] - e[HY, i]), 0.0)
                up = max(up, upper)
        union += covered * (x[l + 1] - x[l])
    return max(right - left, 0.0) * max(top - low, 0.0) / union


@inlined
def ascending(x, m):
    """Sort the first m numbers of x."""
    for i in range(1, m):
        value, k = x[i], i
        while k > 0 and x[k - 1] > value:
            x[k] = x[k - 1]
            k -= 1
        x[k] = value


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
    """The root delta > 0 of near^2 / delta^2 + far^2 / (delta + gap)^2 = 1, by Newton from below on
    1 / sqrt.
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
    """The smaller root delta < gap of near^2 / delta^2 + far^2 / (gap - delta)^2 = 1; -1 where
    there is none.
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
    """(x, y) at length 1."""
    over = 1.0 / math.sqrt(x * x + y * y)
    return x * over, y * over


@inlined
def excess_at(c, s, q):
    """Level minus 1 at (c, s) on the unit circle: |q0 + q1 c + q2 s|^2 - 1."""
    u, v = q[0] + q[1] * c + q[2] * s, q[3] + q[4] * c + q[5] * s
    return u * u + v * v - 1.0


@called
def crossing(low, high, rising, q):
    """The angle between `low` and `high`, where the level passes 1: Newton, kept in the bracket by
    bisection.
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
    """Points px, py (4,) where the boundaries of two ellipses cross or touch from outside; their
    number, or SAME.

    In the frame where the first is the unit circle, turned to the axes of the second's form, the
    level's extrema on the circle solve a secular equation: the least in the first quadrant, the
    greatest in the third, and maybe one more of each in the fourth, nearer to the first axis the
    maximum. Between neighbours a change of sign brackets one crossing.
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
def common_ellipses(n, e, boxes, sets, points, number):
    """The largest sets of ellipses e (8, n) with a common point, in `sets`, and how many there are.

    A common region has crossings as vertices, or it is a whole ellipse and has its centre.
    Crossings are kept: points (2, V, V, 4), number (V, V). Only ellipses whose boxes meet, boxes
    (V,), can have any.
    """
    full, found, meet = (1 << n) - 1, 0, (1 << n) - 1
    for i in range(n):
        boxes[i] = 0
        for j in range(n):
            x, y = e[HX, i] + e[HX, j], e[HY, i] + e[HY, j]
            dx, dy = abs(e[MX, i] - e[MX, j]), abs(e[MY, i] - e[MY, j])
            boxes[i] = 2 * boxes[i] + (
                1 if (dx <= x * (1.0 + TOUCH)) & (dy <= y * (1.0 + TOUCH)) else 0
            )
            number[i, j] = UNKNOWN
        meet &= boxes[i]
    if meet == full and n > 1:
        x, y, _, _, _ = fuse(full, n, e)
        inside = True
        for i in range(n):
            inside &= level(x, y, i, e) <= 1.0
        if inside:
            sets[0] = full
            return 1
    for i in range(n):
        found = insert(holders(e[MX, i], e[MY, i], -1, -1, boxes[i], n, e), sets, found)
    for i in range(n):
        for j in range(i + 1, n):
            near = boxes[i] & boxes[j]
            if has(boxes[i], j, n) and (found == 0 or count(near) >= count(sets[0])):
                number[i, j] = crossings(i, j, e, points[0, i, j], points[1, i, j])
                for k in range(number[i, j]):
                    M = holders(points[0, i, j, k], points[1, i, j, k], i, j, near, n, e)
                    found = insert(M, sets, found)
                    if full == M:
                        return found
    return found


@inlined
def holders(x, y, first, second, among, n, e):
    """The set of ellipses in which (x, y) lies, of those in the set `among`; `first` and `second`
    are known to be.
    """
    M = 0
    for l in range(n):
        M = 2 * M + (
            1
            if has(among, l, n) and (l in (first, second) or level(x, y, l, e) <= 1.0 + TOUCH)
            else 0
        )
    return M


@called
def area_ratio(M, n, e, points, number, order, t):
    """(19) of the ellipses in the set M, by Green's theorem over arcs between their crossings."""
    m = 0
    for i in range(n):
        if has(M, i, n):
            order[m] = i
            for k in range(m):
                j = order[k]
                if number[j, i] == UNKNOWN:
                    number[j, i] = crossings(j, i, e, points[0, j, i], points[1, j, i])
                if number[j, i] == SAME:
                    m -= 1  # one of them is enough
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
    """The point of the i-th ellipse at the angle t."""
    s, c = sine_cosine(t)
    x, y = e[A, i] * c, e[B, i] * s
    return e[MX, i] + x * e[UX, i] - y * e[UY, i], e[MY, i] + x * e[UY, i] + y * e[UX, i]


# ------------------------------------------------------------------------------------------------ S


@inlined
def fuse(M, n, e):
    """Mean x, y and covariance xx, xy, yy of the product of the normals in the set M (all n where M
    is negative).
    """
    x0 = y0 = jxx = jxy = jyy = gx = gy = 0.0
    first = True
    for i in range(n):
        if M < 0 or has(M, i, n):
            if first:
                x0, y0, first = e[MX, i], e[MY, i], False
            a, b = 1.0 / (e[A, i] * e[A, i]), 1.0 / (e[B, i] * e[B, i])
            xx = a * e[UX, i] * e[UX, i] + b * e[UY, i] * e[UY, i]
            xy = (a - b) * e[UX, i] * e[UY, i]
            yy = a * e[UY, i] * e[UY, i] + b * e[UX, i] * e[UX, i]
            dx, dy = e[MX, i] - x0, e[MY, i] - y0
            jxx += xx
            jxy += xy
            jyy += yy
            gx += xx * dx + xy * dy
            gy += xy * dx + yy * dy
    over = 1.0 / (jxx * jyy - jxy * jxy)
    xx, xy, yy = jyy * over, -jxy * over, jxx * over
    return x0 + xx * gx + xy * gy, y0 + xy * gx + yy * gy, xx, xy, yy


def given(dimensions: int) -> types.Array:
    """The type of an array of doubles that is only read."""
    return types.Array(types.float64, dimensions, "C", readonly=True)


@kernel(
    types.void(
        types.intp,
        types.intp,
        types.intp,
        types.float64,
        given(1),
        types.float64,
        *(given(d) for d in (2, 2, 2, 3)),
        types.float64,
        types.float64[:, ::1],
        types.float64[:, :, ::1],
        types.int8[::1],
        types.float64[::1],
    )
)
def discrepancy(
    centre,
    intersection,
    ties,
    least,
    sines,
    minimum,
    azimuth,
    elevation,
    s,
    R,
    height,
    position,
    covariance,
    outcome,
    used,
):
    """Position (N, 3), covariance (N, 3, 3), outcome and number of anchors used (N,) of each fix
    from angles (N, B).

    centre: MIDPOINT or ESTIMATE; intersection: BOXES, EXACT or NO_VOTE; ties: AREA or FIRST; least:
    tangent of the smallest angle between ray and plane; sines (4,): sin, cos of the azimuth's
    deviation, then of the elevation's; minimum m of the half-axes; s (B, 3) m and R (B, 3, 3) of
    the anchors; height m of the plane.
    """
    N, J = azimuth.shape
    V = min(J, MOST)
    block, e = np.empty((J, 8, BLOCK)), np.empty((8, J))
    angles = np.empty((2, BLOCK))
    masks, sets, order = (
        np.empty((2, V), np.int64),
        np.empty(2 * V * V + 1, np.int64),
        np.empty(J, np.int64),
    )
    points, number, t = np.empty((2, V, V, 4)), np.empty((V, V), np.int64), np.empty(4 * V + 2)
    for start in range(0, N, BLOCK):
        size = min(BLOCK, N - start)
        for j in range(J):
            for k in range(BLOCK):
                angles[0, k] = azimuth[start + k, j] if k < size else math.nan
                angles[1, k] = elevation[start + k, j] if k < size else math.nan
            project(
                centre,
                angles[0],
                angles[1],
                s[j],
                R[j],
                height - s[j, 2],
                least,
                sines,
                minimum,
                block[j],
            )
        for k in range(size):
            n = 0
            for j in range(J):
                if math.isfinite(block[j, MX, k]) and math.isfinite(block[j, MY, k]):
                    for l in range(8):
                        e[l, n] = block[j, l, k]
                    n += 1
            M, found = -1, 1
            if intersection == BOXES:
                found = common_boxes(n, e, masks, sets)
            elif intersection == EXACT:
                found = common_ellipses(n, e, masks[0], sets, points, number)
            if intersection != NO_VOTE and found > 0:
                M = sets[0]
                if found > 1 and ties == AREA:
                    best = -1.0
                    for l in range(found):
                        if intersection == BOXES:
                            ratio = box_ratio(sets[l], n, e, order, t)
                        else:
                            ratio = area_ratio(sets[l], n, e, points, number, order, t)
                        if ratio > best + EVEN:
                            best, M = ratio, sets[l]
            i = start + k
            position[i, :] = math.nan
            covariance[i, :, :] = math.nan
            outcome[i], used[i] = OK, 0.0
            if n == 0 or found == 0:
                outcome[i] = FAILED if n == 0 else REJECTED
            else:
                x, y, xx, xy, yy = fuse(M, n, e)
                position[i, 0], position[i, 1] = x, y
                (
                    covariance[i, 0, 0],
                    covariance[i, 0, 1],
                    covariance[i, 1, 0],
                    covariance[i, 1, 1],
                ) = xx, xy, xy, yy
                used[i] = n if M < 0 else count(M)
