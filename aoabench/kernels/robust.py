"""The kernel of the robust likelihood: start, descent and judgement, one fix after the other.

The arithmetic of `estimators.robust_reference`.
"""

from __future__ import annotations

import math

import numpy as np
from numba import types

from aoabench.kernels.angles import sine_cosine
from aoabench.kernels.compile import called, given, inlined, kernel
from aoabench.kernels.planes import SAME_PLACE, UNKNOWN, fill
from aoabench.kernels.robust_likelihood import (
    CHUNK,
    ID,
    LANES,
    NORMAL,
    PHI,
    R00,
    R01,
    R02,
    R10,
    R11,
    R12,
    R20,
    R21,
    R22,
    RANGE,
    RHO2,
    ROWS,
    SA,
    SE,
    SR,
    THETA,
    TRUNCATED,
    WR,
    D,
    X,
    Y,
    Z,
    at_range,
    costs,
    different,
    equations,
    gathered,
    grouped,
    nearest,
    nearest_to_all,
    projected,
    residuals,
    weigh,
    weight,
)
from aoabench.kernels.robust_limits import (
    EVEN,
    GAIN,
    GROWTH,
    LEAST,
    MOST,
    REDUNDANT,
    ROUNDING,
    SLACK,
    STARTS,
    STEEP,
    TINY,
    USED,
)
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
from aoabench.kernels.snapshot import FAR


@called
def best_start(loss, k, flat, z, q, d, l, n, ranges, g, firsts, work):
    """The candidate of least cost, and that cost, infinite without a candidate."""
    bx, by, bz, least, count = UNKNOWN, UNKNOWN, UNKNOWN, math.inf, 0
    m = grouped(q, l, n, g, firsts)
    for gap in range(-1, m + (1 if ranges > 0 else 0)):
        for i in range(1 if gap < 0 else m if gap == m else m - gap):
            if gap < 0:
                x, y, w, sound = nearest_to_all(flat, z, l, n)
            elif gap == m:
                sound = q[WR, firsts[i]] > 0.0
                x, y, w = at_range(flat, z, q, firsts[i])
            elif count < STARTS:
                count += 1
                j, two = i + gap, 1.0 if gap > 0 else 0.0
                x, y, w, sound = nearest(
                    flat, z,
                    g[0, i] + two * g[0, j], g[1, i] + two * g[1, j], g[2, i] + two * g[2, j],
                    g[3, i] + two * g[3, j], g[4, i] + two * g[4, j], g[5, i] + two * g[5, j],
                    g[6, i] + two * g[6, j], g[7, i] + two * g[7, j], g[8, i] + two * g[8, j],
                )  # fmt: skip
                sound = sound & ((gap == 0) | distinct(q, firsts[i], firsts[j]))
            else:
                sound = False
            if sound:
                residuals(x, y, w, q, d, n, ranges, work)
                c = costs(loss, k, STEEP, d, n, ranges)
                if not c >= least * (1.0 - EVEN) - ROUNDING:
                    bx, by, bz, least = x, y, w, c
    return bx, by, bz, least


@inlined
def distinct(q, i, j):
    """Whether two anchors stand in different places."""
    dx, dy, dz = q[X, i] - q[X, j], q[Y, i] - q[Y, j], q[Z, i] - q[Z, j]
    a = q[X, i] * q[X, i] + q[Y, i] * q[Y, i] + q[Z, i] * q[Z, i]
    b = q[X, j] * q[X, j] + q[Y, j] * q[Y, j] + q[Z, j] * q[Z, j]
    return dx * dx + dy * dy + dz * dz > SAME_PLACE * (a + b)


@inlined
def apart(flat, q, n):
    """Whether the anchors stand in more than one place, seen from above if `flat`."""
    x = y = z = squares = 0.0
    up = 0.0 if flat else 1.0
    for j in range(n):
        w = up * q[Z, j]
        x, y, z = x + q[X, j], y + q[Y, j], z + w
        squares += q[X, j] * q[X, j] + q[Y, j] * q[Y, j] + w * w
    return n * squares - (x * x + y * y + z * z) > SAME_PLACE * n * squares


@called
def descended(loss, k, tolerance, updates, flat, x, y, z, m, q, d, n, ranges, w):
    """Damped Gauss-Newton steps from (x, y, z): the position, outcome, reason, number of updates
    and cost.
    """
    far2, damping, outcome, reason, count = (
        z * z if flat else 0.0,
        1e-3,
        OSCILLATED,
        NO_CONVERGENCE,
        0,
    )
    for j in range(n):
        far2 = max(far2, q[X, j] * q[X, j] + q[Y, j] * q[Y, j] + q[Z, j] * q[Z, j])
        far2 = max(far2, q[RANGE, j] * q[RANGE, j])
    far2 *= FAR * FAR
    residuals(x, y, z, q, d, n, ranges, w)
    for _ in range(updates):
        weigh(loss, k, m, q, d, n, ranges)
        now = costs(loss, k, m, d, n, ranges)
        a00, a10, a11, a20, a21, a22, g0, g1, g2 = equations(flat, False, q, d, n, ranges)
        f = 1.0 + damping
        dx, dy, dz, sound = solve(f * a00, a10, f * a11, a20, a21, f * a22, g0, g1, g2)
        count += 1
        if not sound:
            outcome, reason = DIVERGED, NO_DESCENT
            break
        tx, ty, tz = x + dx, y + dy, z + dz
        pole2 = residuals(tx, ty, tz, q, d, n, ranges, w)
        better = costs(loss, k, m, d, n, ranges) <= now * (1.0 + SLACK) + ROUNDING
        if better:
            x, y, z = tx, ty, tz
        damping = min(max(damping * (0.1 if better else 10.0), LEAST), MOST)
        if not tx * tx + ty * ty + tz * tz <= far2:
            outcome, reason = DIVERGED, TOO_FAR
            break
        if (m >= STEEP) & (dx * dx + dy * dy + dz * dz < tolerance * tolerance):
            dx, dy, dz, sound = solve(a00, a10, a11, a20, a21, a22, g0, g1, g2)
            short = sound & (dx * dx + dy * dy + dz * dz < tolerance * tolerance)
            short = short | (sound & (dx * g0 + dy * g1 + dz * g2 <= GAIN))
            if short | (pole2 <= tolerance * tolerance):
                outcome, reason = OK, NONE
                break
        m = min(m * GROWTH, STEEP)
        if not better:
            residuals(x, y, z, q, d, n, ranges, w)
    residuals(x, y, z, q, d, n, ranges, w)
    return x, y, z, outcome, reason, count, costs(loss, k, STEEP, d, n, ranges)


@inlined
def minimum(loss, k, tolerance, updates, flat, x, y, z, q, d, n, ranges, w):
    """The minimum below (x, y, z), as `descended`; the better of two for a truncated loss."""
    found = descended(loss, k, tolerance, updates, flat, x, y, z, STEEP, q, d, n, ranges, w)
    if loss != TRUNCATED:
        return found
    residuals(x, y, z, q, d, n, ranges, w)
    s = 0.0
    for j in range(n):
        s = max(s, max(d[SA, j], d[SE, j]))
        if ranges > 0:
            s = max(s, d[SR, j])
    m = min(max(k * k / max(2.0 * s - k * k, TINY), 1.0 / STEEP), STEEP)
    other = descended(loss, k, tolerance, updates, flat, x, y, z, m, q, d, n, ranges, w)
    lower = other[6] < found[6] * (1.0 - EVEN) - ROUNDING
    return other if (lower if other[3] == found[3] else other[3] < found[3]) else found


@called
def used_and_behind(loss, k, every, x, y, z, q, d, n):
    """The number of anchors that are used, and whether (x, y, z) lies behind one of them."""
    used, back, least = 0, False, USED * weight(loss, k, STEEP, 0.0)
    for j in range(n):
        if every or weight(loss, k, STEEP, d[SA, j]) >= least:
            new = True
            for i in range(j):
                same = q[ID, i] == q[ID, j]
                new = new & ~(same & (every | (weight(loss, k, STEEP, d[SA, i]) >= least)))
            used += 1 if new else 0
            sp, cp = sine_cosine(q[PHI, j])
            st, ct = sine_cosine(q[THETA, j])
            dx, dy, dz = x - q[X, j], y - q[Y, j], z - q[Z, j]
            u = q[R00, j] * dx + q[R01, j] * dy + q[R02, j] * dz
            v = q[R10, j] * dx + q[R11, j] * dy + q[R12, j] * dz
            w = q[R20, j] * dx + q[R21, j] * dy + q[R22, j] * dz
            back = back | (ct * (cp * u + sp * v) + st * w < 0.0)
    return used, back


@kernel(
    types.void(
        types.intp,
        types.float64,
        types.float64,
        types.intp,
        types.float64,
        *(given(3) for _ in range(6)),
        given(4),
        given(5),
        given(3),
        types.float64[:, :, ::1],
        types.float64[:, :, :, ::1],
        types.int8[:, ::1],
        types.int8[:, ::1],
        *(types.float64[:, ::1] for _ in range(3)),
    )
)
def robust(
    loss, k, tolerance, updates, height, phi, theta, wa, we, r, wr, s, R, ids,
    p, P, outcome, reason, count, score, used,
):  # fmt: skip
    """Position p (R, T, 3), covariance P (R, T, 3, 3), outcome, reason, number of updates, score
    and number of anchors used (R, T) of each fix from its angles and ranges r m (R, T, B).

    wa, we, wr (R, T, B): 1 / variance, 0 where not measured; without ranges, r and wr are
    (R, T, 0). ids (R|1, T|1, B): the anchors' numbers. s (R|1, T|1, B, 3) anchors, R
    (R|1, T|1, B, 3, 3); `height` is NaN where z is estimated.
    """
    B, known = phi.shape[2], height == height
    work, l = np.empty(ROWS * CHUNK), np.empty((9, B + LANES))
    if B + LANES > CHUNK:
        q, d = np.empty((D, B + LANES)), np.empty((RHO2, B + LANES))
    else:
        q = work[: D * CHUNK].reshape(D, CHUNK)
        d = work[D * CHUNK : (D + RHO2) * CHUNK].reshape(RHO2, CHUNK)
    g, firsts = np.empty((9, B + 1)), np.empty(B + 1, np.intp)
    for i in range(phi.shape[0]):
        for t in range(phi.shape[1]):
            here = s[min(i, len(s) - 1), min(t, s.shape[1] - 1)]
            turn = R[min(i, len(R) - 1), min(t, R.shape[1] - 1)]
            n, rays, ranges, both, cx, cy, cz = gathered(
                phi[i, t],
                theta[i, t],
                wa[i, t],
                we[i, t],
                r[i, t],
                wr[i, t],
                here,
                turn,
                ids[min(i, len(ids) - 1), min(t, ids.shape[1] - 1)],
                q,
            )
            vertical = projected(q, n, l)
            flat = known | (vertical & (rays == 0))
            alone = (known & (rays + ranges > 0)) | (both > 0)
            z = height - cz if known else 0.0
            unknowns = 2 if flat else 3
            redundancy = n + rays + ranges - unknowns
            few = (loss != NORMAL) & (different(q, n) - unknowns < REDUNDANT)
            plain, rho = few & (ranges == 0), NORMAL if few else loss
            together = not (alone | apart(flat, q, n))
            count[i, t], score[i, t], used[i, t], P[i, t] = 0.0, UNKNOWN, n, UNKNOWN
            x, y, w, sound = nearest_to_all(flat, z, l, n)
            if not plain and not together:
                x, y, w, least = best_start(rho, k, flat, z, q, d, l, n, ranges, g, firsts, work)
                sound = least < math.inf
            if together | (not sound) | (n < (1 if alone else 2)):
                p[i, t], outcome[i, t] = UNKNOWN, FAILED
                reason[i, t] = ONE_PLACE if together else UNDETERMINED
                if n < (1 if known else 2):
                    reason[i, t] = TOO_FEW_ANCHORS if n > 0 else NO_MEASUREMENT
                continue
            outcome[i, t], reason[i, t] = OK, NONE
            if not plain:
                x, y, w, outcome[i, t], reason[i, t], count[i, t], least = minimum(
                    rho, k, tolerance, updates, flat, x, y, w, q, d, n, ranges, work
                )
            residuals(x, y, w, q, d, n, ranges, work)
            squares = weigh(loss, k, STEEP, q, d, n, ranges)
            if redundancy > 0:
                score[i, t] = math.sqrt(
                    2.0 * costs(loss, k, STEEP, d, n, ranges) / (n + rays + ranges)
                )
            used[i, t], back = used_and_behind(loss, k, few, x, y, w, q, d, n)
            if back & (outcome[i, t] == OK):
                outcome[i, t], reason[i, t] = DIVERGED, BEHIND
            a = equations(flat, True, q, d, n, ranges)
            if solve(*a)[3]:
                scale = max(squares / max(redundancy, 1), 1.0)
                fill(P[i, t], scale, *inverse(a[0], a[1], a[2], a[3], a[4], a[5]))
            p[i, t, 0], p[i, t, 1], p[i, t, 2] = x + cx, y + cy, UNKNOWN if flat else w + cz
            if flat:
                P[i, t, 2] = UNKNOWN
                P[i, t, :, 2] = UNKNOWN
