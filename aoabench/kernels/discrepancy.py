"""Kernels of the discrepancy filter: ellipses of a block of fixes at once, then each fix's vote and
fusion.

The kernels compute the same as `estimators/discrepancy.py`, and the fixes are independent. A set of
anchors is an integer whose most significant bit is the first anchor that measured: of two sets of
equal size, the larger integer comes first in the order of anchor numbers.
"""

from __future__ import annotations

import math

import numpy as np
from numba import types

from aoabench.kernels.compile import called, given, inlined, kernel
from aoabench.kernels.ellipses import (
    AC,
    AX,
    AY,
    BLOCK,
    HX,
    HY,
    MX,
    MY,
    ROWS,
    TOUCH,
    UNKNOWN,
    UX,
    UY,
    A,
    B,
    area_ratio,
    crossings,
    level,
    project,
)
from aoabench.kernels.small import DIVERGED, FAILED, OK, REJECTED, ascending, has

MOST = 62  # anchors that can vote: the bits of a set
BOXES, EXACT, NO_VOTE = range(3)  # regions that must have a common point
AREA, FIRST = range(2)  # choice among several largest sets
EVEN = 1e-9  # ratios (19) that differ by less are equal, as in estimators/discrepancy.py


@inlined
def count(M):
    """Number of anchors in the set M, which is the number of bits that are 1."""
    M = M - ((M >> 1) & 0x5555555555555555)
    M = (M & 0x3333333333333333) + ((M >> 2) & 0x3333333333333333)
    return (((M + (M >> 4)) & 0x0F0F0F0F0F0F0F0F) * 0x0101010101010101) >> 56


@inlined
def different(M, n, at):
    """Number of different places `at` (n,) in the set M (all n if M is negative)."""
    found = 0
    for i in range(n):
        new = M < 0 or has(M, i, n)
        for j in range(i):
            new &= not ((M < 0 or has(M, j, n)) and at[i] == at[j])
        found += 1 if new else 0
    return found


@inlined
def insert(M, sets, found):
    """Insert M into the first `found` of `sets` and return their new number.

    `sets` holds different sets of equal size, the largest integer first. A set of more anchors
    replaces them all; a set of fewer anchors, or of fewer than two, is not inserted.
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
    """Number of the largest sets of boxes of ellipses e (ROWS, n) that have a common point.

    The sets go into `sets`; masks (2, V) is scratch. The lower left corner of a common box lies on
    the left side of one of the boxes and on the lower side of one of them.
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
    """Ratio (19), area of the intersection to area of the union, of the boxes in the set M.

    The union is a sum of slabs between neighbouring left or right sides; order and x are scratch.
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
            order[k] = i  # in ascending order of the lower sides
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


@called
def common_ellipses(n, e, boxes, sets, points, number):
    """Number of the largest sets of ellipses e (ROWS, n) that have a common point.

    The sets go into `sets`. A common region has crossings as vertices, or it is a whole ellipse
    with its centre. Crossings are stored in points (2, V, V, 4) and counted in number (V, V). Only
    ellipses whose boxes meet can cross; boxes (V,) stores these ellipses as a set for each one.
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
    """The set of those ellipses in the set `among` that contain (x, y).

    If (x, y) is a crossing of the ellipses `first` and `second`, these contain it without a test;
    for any other point both are -1.
    """
    M = 0
    for l in range(n):
        M = 2 * M + (
            1
            if has(among, l, n) and (l in (first, second) or level(x, y, l, e) <= 1.0 + TOUCH)
            else 0
        )
    return M


@inlined
def fuse(M, n, e):
    """Mean x, y and covariance xx, xy, yy of the product of the normals in the set M (all n if M is
    negative).
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


ARGUMENTS = (
    types.intp,
    types.intp,
    types.intp,
    types.float64,
    given(1),
    types.float64,
    *(given(d) for d in (2, 2, 2, 3)),
    types.Array(types.int64, 1, "C", readonly=True),
    types.float64,
    types.float64[:, ::1],
    types.float64[:, :, ::1],
    types.int8[::1],
    types.float64[::1],
)


@kernel(types.void(*ARGUMENTS))
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
    place,
    height,
    position,
    covariance,
    outcome,
    used,
):
    """Position (N, 3) m, covariance (N, 3, 3) m^2, outcome and number of anchors used (N,) of each
    fix from angles (N, B) rad.

    centre: MIDPOINT or ESTIMATE; intersection: BOXES, EXACT or NO_VOTE; ties: AREA or FIRST; least:
    tangent of the smallest angle between ray and plane; sines (4,): sin, cos of the azimuth's
    deviation, then of the elevation's; minimum: lower limit m of the half-axes; s (B, 3) m and
    R (B, 3, 3) of the anchors, and the number of each one's place (B,); height m of the plane.
    """
    N, J = azimuth.shape
    V = min(J, MOST)
    block, e = np.empty((J, ROWS, BLOCK)), np.empty((ROWS, J))
    angles = np.empty((2, BLOCK))
    masks, sets = np.empty((2, V), np.int64), np.empty(2 * V * V + 1, np.int64)
    order, at = np.empty(J, np.int64), np.empty(J, np.int64)
    points, number, t = np.empty((2, V, V, 4)), np.empty((V, V), np.int64), np.empty(4 * V + 2)
    for start in range(0, N, BLOCK):
        size = min(BLOCK, N - start)
        for j in range(J):
            for k in range(BLOCK):
                angles[0, k] = azimuth[start + k, j] if k < size else math.nan
                angles[1, k] = elevation[start + k, j] if k < size else math.nan
            up = height - s[j, 2]
            project(centre, angles[0], angles[1], s[j], R[j], up, least, sines, minimum, block[j])
        for k in range(size):
            n = 0
            for j in range(J):
                if math.isfinite(block[j, MX, k]) and math.isfinite(block[j, MY, k]):
                    for l in range(ROWS):
                        e[l, n] = block[j, l, k]
                    at[n] = place[j]
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
                covariance[i, 0, 0], covariance[i, 0, 1] = xx, xy
                covariance[i, 1, 0], covariance[i, 1, 1] = xy, yy
                for j in range(n):
                    ahead = e[AX, j] * x + e[AY, j] * y + e[AC, j]
                    if (M < 0 or has(M, j, n)) and ahead < 0.0:
                        outcome[i] = DIVERGED
                used[i] = different(M, n, at)
