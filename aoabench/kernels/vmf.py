"""Kernel of maximum likelihood of von Mises-Fisher directions, one fix after the other.

The arithmetic of `estimators/vmf_likelihood.py`. Positions are relative to the centre of all
anchors q (3, B); d (3, B) measured directions, 0 where not measured; w (B,) their weights.
"""

from __future__ import annotations

import math

import numpy as np
from numba import types

from aoabench.kernels.compile import given, inlined, kernel
from aoabench.kernels.planes import fill, sandwich
from aoabench.kernels.rays import (
    UNKNOWN,
    cast,
    centred,
    drop,
    extent2,
    lies_behind,
    nearest,
    residual_variance,
    several_places,
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

LANES = 4
FAR = 1e6  # as in estimators.rays
NEAREST = 1e-9  # m, as in estimators.vmf_descent
ROUNDING, TIE = 16 * 2.0**-52, 1.0 - 1e-12  # likewise
SLOPE = math.tan(math.radians(1.0))  # of the flattest ray of a start


@inlined
def expected(x, y, z, free, d, w, q):
    """Cost of a point, and the normal equations of a step from it; z is fixed unless `free`."""
    cost = g0 = g1 = g2 = a00 = a10 = a11 = a20 = a21 = a22 = 0.0
    for j in range(len(w)):
        u, v, t = x - q[0, j], y - q[1, j], z - q[2, j]
        r = max(math.sqrt(u * u + v * v + t * t), NEAREST)
        u, v, t = u / r, v / r, t / r
        e, f, g = d[0, j] - u, d[1, j] - v, d[2, j] - t
        cost += w[j] * (e * e + f * f + g * g)
        along = u * e + v * f + t * g
        h = w[j] / r
        g0 += h * (e - u * along)
        g1 += h * (f - v * along)
        g2 += h * (g - t * along)
        h /= r
        a00 += h * (1.0 - u * u)
        a10 -= h * u * v
        a11 += h * (1.0 - v * v)
        a20 -= h * u * t
        a21 -= h * v * t
        a22 += h * (1.0 - t * t)
    if not free:
        a20 = a21 = g2 = 0.0
        a22 = a00 + a11
    return 0.5 * cost, (a00, a10, a11, a20, a21, a22), (g0, g1, g2)


@inlined
def in_front(x, y, z, length, free, d, w, q):
    """The point of least cost among points on the rays, at multiples of `length` from the anchors,
    and (x, y, z) itself; of points with equal cost the first one.
    """
    best, least = (x, y, z), expected(x, y, z, free, d, w, q)[0]
    for k in range(3 * len(w)):
        j = k % len(w)
        reach = length * (0.25 if k < len(w) else 1.0 if k < 2 * len(w) else 4.0)
        if w[j] > 0.0:
            a, b = q[0, j] + reach * d[0, j], q[1, j] + reach * d[1, j]
            c = q[2, j] + reach * d[2, j] if free else z
            cost = expected(a, b, c, free, d, w, q)[0]
            if cost < TIE * least:
                best, least = (a, b, c), cost
    return best


@inlined
def descend(x, y, z, tolerance, updates, far, free, total, d, w, q):
    """Levenberg-Marquardt steps from (x, y, z): the position, cost, outcome, reason and number of
    updates. total: sum of the weights.
    """
    cost, A, g = expected(x, y, z, free, d, w, q)
    damping, count, outcome, reason = 1e-3, 0, OSCILLATED, NO_CONVERGENCE
    while count < updates:
        count += 1
        m = 1.0 + damping
        step = solve(A[0] * m, A[1], A[2] * m, A[3], A[4], A[5] * m, g[0], g[1], g[2])
        if not step[3]:
            outcome, reason = DIVERGED, NO_DESCENT
            break
        a, b, c = x + step[0], y + step[1], z + step[2]
        new, nextA, nextg = expected(a, b, c, free, d, w, q)
        better = new <= cost
        if better:
            x, y, z, cost = a, b, c, new
        if not a * a + b * b + c * c <= far * far:
            outcome, reason = DIVERGED, TOO_FAR
            break
        if step[0] ** 2 + step[1] ** 2 + step[2] ** 2 < tolerance * tolerance:
            # damping alone makes a step short, too
            a, b, c, sound = solve(*A, g[0], g[1], g[2])
            gain = a * g[0] + b * g[1] + c * g[2]
            short = a * a + b * b + c * c < tolerance * tolerance
            if sound and (short or gain <= ROUNDING * math.sqrt(2.0 * cost * total)):
                outcome, reason = OK, NONE
                break
        if better:
            A, g = nextA, nextg
        damping = min(max(damping * (0.1 if better else 10.0), 1e-12), 1e12)
    return x, y, z, cost, outcome, reason, count


@inlined
def minimum(x, y, z, tolerance, updates, far, free, total, d, w, q):
    """The minimum from the start (x, y, z), as `descend` returns it. One behind an anchor may be a
    saddle; steps from the best point on the rays follow, and the smaller cost counts.
    """
    found = (x, y, z, UNKNOWN, FAILED, UNDETERMINED, 0)
    start = (x, y, z)
    for attempt in range(2):
        other = descend(*start, tolerance, updates, far, free, total, d, w, q)
        if attempt == 0 or other[3] < found[3]:
            found = other
        if attempt > 0 or not lies_behind(found[0], found[1], found[2], True, q, d):
            break
        start = in_front(found[0], found[1], found[2], far / FAR, free, d, w, q)
    return found


@inlined
def level_start(x, y, sound, height, bounds, cx, cy, d, w, q):
    """x and y of a start on the plane z = height: (x, y) if `sound`, or else the mean of the points
    where the rays meet the plane, moved into the bounds.
    """
    if not sound:
        n = x = y = 0.0
        for j in range(len(w)):
            h = height - q[2, j]
            flat = math.sqrt(d[0, j] * d[0, j] + d[1, j] * d[1, j])
            side = 1.0 if h > 0.0 else -1.0
            towards = max(d[2, j] * side, flat * SLOPE)
            reach = abs(h) / towards if flat > 0.0 else 0.0
            measured = w[j] > 0.0
            x += q[0, j] + reach * d[0, j] if measured else 0.0
            y += q[1, j] + reach * d[1, j] if measured else 0.0
            n += 1.0 if measured else 0.0
        x, y = x / n, y / n
    x = min(max(x + cx, bounds[0, 0]), bounds[1, 0]) - cx
    return x, min(max(y + cy, bounds[0, 1]), bounds[1, 1]) - cy


@inlined
def spread(x, y, z, free, stated, variance, va, ve, cosine, w, q, P):
    """Covariance of the minimum (x, y, z) into P (3, 3); `variance` of all angles unless stated."""
    a00 = a10 = a11 = a20 = a21 = a22 = m00 = m10 = m11 = m20 = m21 = m22 = 0.0
    for j in range(len(w)):
        u, v, t = x - q[0, j], y - q[1, j], z - q[2, j]
        over = 1.0 / max(u * u + v * v + t * t, NEAREST * NEAREST)
        uu, uv, vv = u * u * over, u * v * over, v * v * over
        ut, vt, tt = u * t * over, v * t * over, t * t * over
        both = 0.5 * (va[j] * cosine[j] * cosine[j] + ve[j])
        one = variance if stated == 0 else both if stated > 1 else va[j]
        h = w[j] * over
        k = w[j] * h * one if w[j] > 0.0 else 0.0
        a00 += h * (1.0 - uu)
        a10 -= h * uv
        a11 += h * (1.0 - vv)
        a20 -= h * ut
        a21 -= h * vt
        a22 += h * (1.0 - tt)
        m00 += k * (1.0 - uu)
        m10 -= k * uv
        m11 += k * (1.0 - vv)
        m20 -= k * ut
        m21 -= k * vt
        m22 += k * (1.0 - tt)
    if not free:
        a20 = a21 = m20 = m21 = 0.0
        a22, m22 = a00 + a11, m00 + m11
    sound = solve(a00, a10, a11, a20, a21, a22, 0.0, 0.0, 0.0)[3]
    inner = inverse(a00, a10, a11, a20, a21, a22)
    fill(P, 1.0 if sound else UNKNOWN, *sandwich(inner, m00, m10, m11, m20, m21, m22))
    if not free:
        P[2, :] = UNKNOWN
        P[:, 2] = UNKNOWN


@inlined
def weights(stated, va, line, ahead, v, plane, w):
    """Weights w (B,) of the rays, 0 where not both angles are measured; and such rays dropped."""
    for j in range(len(w)):
        w[j] = 0.0
        if line[j] > 0.0:
            w[j] = 1.0 / va[j] if stated > 0 else 1.0
        else:
            drop(j, ahead, v, line, plane)


@kernel(
    types.void(
        types.float64,
        types.intp,
        types.intp,
        types.intp,
        types.float64,
        types.boolean,
        given(2),
        *(given(d) for d in (2, 2, 2, 2, 3, 4)),
        types.float64[:, ::1],
        types.float64[:, :, ::1],
        types.int8[::1],
        types.int8[::1],
        *(types.float64[::1] for _ in range(3)),
    )
)
def vmf_minima(
    tolerance, updates, B, stated, height, clip, bounds, phi, theta, va, ve, s, R, x, P,
    outcome, reason, score, used, count,
):  # fmt: skip
    """Position x (N, 3), covariance P (N, 3, 3), outcome, reason, root mean square angle, number of
    anchors used and of updates (N,) of each fix from its angles (N, B), NaN where not measured.

    B: number of anchors, without padding; va, ve (N, B): the stated variances, of no angle, of
    azimuths alone or of both for `stated` = 0, 1, 2; height of the target, NaN: free; bounds (2, 2)
    of x and y, into which starts are moved, and positions if `clip`; s (N|1, 3, B) anchors, R
    (N|1, 3, 3, B).
    """
    width, free = phi.shape[1], math.isnan(height)
    q, d, v = np.empty((3, width)), np.empty((3, width)), np.empty((3, width))
    line, plane, cosine, w = np.empty(width), np.empty(width), np.empty(width), np.empty(width)
    one = np.ones(width)
    cx = cy = cz = far = 0.0
    for n in range(len(phi)):
        i, j = min(n, len(s) - 1), min(n, len(R) - 1)
        if n == 0 or i > 0:
            cx, cy, cz = centred(B, s[i], q)
            far = math.sqrt(extent2(q))
            if not free:
                for k in range(width):
                    far = max(far, abs(s[i, 2, k] - height))
            far *= FAR
        cast(phi[n], theta[n], R[j], d, v, line, plane, cosine)
        weights(stated, va[n], line, d, v, plane, w)
        m, total = line.sum(), w.sum()
        a, b, c, sound, _, _ = nearest(q, d, line, plane, one)
        distinct = several_places(q, line, plane, 1.0)
        if not free and m > 0.0:
            a, b = level_start(a, b, sound, height - cz, bounds, cx, cy, d, w, q)
            c = height - cz
        used[n], score[n], count[n] = m, UNKNOWN, 0.0
        if (not (sound and distinct)) if free else m == 0.0:
            x[n], P[n], outcome[n] = UNKNOWN, UNKNOWN, FAILED
            reason[n] = UNDETERMINED if distinct else ONE_PLACE
            if m < (2.0 if free else 1.0):
                reason[n] = TOO_FEW_ANCHORS if m > 0.0 else NO_MEASUREMENT
            continue
        a, b, c, cost, outcome[n], reason[n], count[n] = minimum(
            a, b, c, tolerance, updates, far, free, total, d, w, q
        )
        if outcome[n] == OK and lies_behind(a, b, c, True, q, d):
            outcome[n], reason[n] = DIVERGED, BEHIND
        if m > 1.0:
            score[n] = math.sqrt(2.0 * cost / total)
        variance = residual_variance(2.0 * cost, 2.0 * m - (3.0 if free else 2.0))
        spread(a, b, c, free, stated, variance, va[n], ve[n], cosine, w, q, P[n])
        a, b = a + cx, b + cy
        x[n, 0] = min(max(a, bounds[0, 0]), bounds[1, 0]) if clip else a
        x[n, 1] = min(max(b, bounds[0, 1]), bounds[1, 1]) if clip else b
        x[n, 2] = c + cz if free else UNKNOWN
