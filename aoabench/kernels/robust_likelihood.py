"""One fix of the robust likelihood: its anchors, lines, residuals, losses and normal equations.

The arithmetic of `estimators.robust_reference` and `estimators.losses`. The measurements of a fix
are copied into the rows of an array, padded with weight 0 to a multiple of `LANES`, so that the
loops over its anchors vectorise.
"""

from __future__ import annotations

import math

from aoabench.kernels.angles import angle, sine_cosine, wrapped
from aoabench.kernels.compile import called, inlined
from aoabench.kernels.robust_limits import FLAT, TINY
from aoabench.kernels.small import solve

LANES, CHUNK = 8, 64  # anchors at a time
FACTORS = 4  # anchors of a product, which is finite up to s = 1e37
NORMAL, STUDENT, HUBER, TRUNCATED = range(4)
PHI, THETA, WA, WE, X, Y, Z = range(7)  # rows of q; then those of the rotation
R00, R01, R02, R10, R11, R12, R20, R21, R22, RANGE, WR, ID = range(7, 19)
DA, DE, SA, SE, U, V, W, CA, CE, DR, SR, CR = range(12)  # rows of d; the last three of ranges
D, RHO2 = ID + 1, CR + 1  # rows of w: those of q, from D on those of d, and D + RHO2
ROWS = D + RHO2 + 1


@inlined
def weight(loss, k, m, s):
    """The derivative of `cost`."""
    if loss == STUDENT:
        return (k + 1.0) / (k + s)
    if loss == HUBER:
        return min(1.0, k / math.sqrt(max(s, TINY)))
    if loss == TRUNCATED:
        found = k * math.sqrt(m * (m + 1.0)) / math.sqrt(max(s, TINY)) - m
        return min(max(found, 0.0), 1.0)
    return 1.0


@inlined
def cost(loss, k, m, s):
    """rho of a squared deviation, as `losses.Loss`; that of `student` in `costs`."""
    if loss == HUBER:
        return s if s <= k * k else 2.0 * k * math.sqrt(s) - k * k
    if loss == TRUNCATED:
        if s >= k * k * (m + 1.0) / m:
            return k * k
        between = 2.0 * k * math.sqrt(s * m * (m + 1.0)) - m * (k * k + s)
        return s if s <= k * k * m / (m + 1.0) else between
    return s


@inlined
def logarithms(k, d, n, ranges):
    """The sum of log(1 + s / k) over the squared deviations s of the first n anchors: that of
    products, which takes an eighth of the logarithms.
    """
    total = 0.0
    for first in range(0, n, FACTORS):
        product = 1.0
        for j in range(first, min(first + FACTORS, n)):
            product *= (1.0 + d[SA, j] / k) * (1.0 + d[SE, j] / k)
        total += math.log(product)
        if ranges > 0:
            product = 1.0
            for j in range(first, min(first + FACTORS, n)):
                product *= 1.0 + d[SR, j] / k
            total += math.log(product)
    return total


@called
def costs(loss, k, m, d, n, ranges):
    """Half the sum of rho over the first n anchors."""
    total = 0.0
    if loss == STUDENT:
        total = (k + 1.0) * logarithms(k, d, n, ranges)
    else:
        for j in range(n):
            total += cost(loss, k, m, d[SA, j]) + cost(loss, k, m, d[SE, j])
        for j in range(n if ranges > 0 else 0):
            total += cost(loss, k, m, d[SR, j])
    return 0.5 * total


@called
def gathered(phi, theta, wa, we, r, wr, s, R, ids, q):
    """Copy the anchors that measured into q; the numbers of anchors, of rays, of ranges, and of
    rays with a range, and the centre.
    """
    n, rays, ranges, both, x, y, z = 0, 0, 0, 0, 0.0, 0.0, 0.0
    for j in range(len(phi)):
        if wa[j] > 0.0:
            q[PHI, n], q[THETA, n], q[WA, n], q[WE, n] = phi[j], theta[j], wa[j], we[j]
            q[X, n], q[Y, n], q[Z, n] = s[j, 0], s[j, 1], s[j, 2]
            for i in range(3):
                for c in range(3):
                    q[R00 + 3 * i + c, n] = R[j, i, c]
            x, y, z = x + s[j, 0], y + s[j, 1], z + s[j, 2]
            q[RANGE, n], q[WR, n], q[ID, n] = 0.0, 0.0, ids[j]
            if len(wr) > 0 and wr[j] > 0.0:
                q[RANGE, n], q[WR, n] = r[j], wr[j]
                ranges, both = ranges + 1, both + (1 if we[j] > 0.0 else 0)
            n, rays = n + 1, rays + (1 if we[j] > 0.0 else 0)
    if n > 0:
        x, y, z = x / n, y / n, z / n
        for j in range(n):
            q[X, j], q[Y, j], q[Z, j] = q[X, j] - x, q[Y, j] - y, q[Z, j] - z
        for j in range(n, n + -n % LANES):
            for i in range(len(q)):
                q[i, j] = q[i, n - 1]
            q[WA, j] = q[WE, j] = q[WR, j] = 0.0
    return n, rays, ranges, both, x, y, z


@called
def projected(q, n, l):
    """Write the projector across each ray or plane, and its product with the anchor, into l (9, B);
    whether the planes are vertical.
    """
    up = across = 0.0
    for j in range(n):
        sp, cp = sine_cosine(q[PHI, j])
        st, ct = sine_cosine(q[THETA, j])
        vx, vy, vz = (
            cp * q[R10, j] - sp * q[R00, j],
            cp * q[R11, j] - sp * q[R01, j],
            cp * q[R12, j] - sp * q[R02, j],
        )
        up, across = up + vz * vz, across + vx * vx + vy * vy
        one = 0.0
        if q[WE, j] > 0.0:
            a, b, one = cp * ct, sp * ct, 1.0
            vx = a * q[R00, j] + b * q[R10, j] + st * q[R20, j]
            vy = a * q[R01, j] + b * q[R11, j] + st * q[R21, j]
            vz = a * q[R02, j] + b * q[R12, j] + st * q[R22, j]
        f = 1.0 - 2.0 * one
        x, y, z = q[X, j], q[Y, j], q[Z, j]
        along = f * (vx * x + vy * y + vz * z)
        l[0, j], l[1, j], l[2, j] = one + f * vx * vx, f * vx * vy, one + f * vy * vy
        l[3, j], l[4, j], l[5, j] = f * vx * vz, f * vy * vz, one + f * vz * vz
        l[6, j], l[7, j] = one * x + along * vx, one * y + along * vy
        l[8, j] = one * z + along * vz
    return up <= FLAT * across


@called
def different(q, n):
    """The number of measurements, several of a kind by one anchor counted once."""
    total = 0
    for j in range(n):
        a, e, r = 1, 1 if q[WE, j] > 0.0 else 0, 1 if q[WR, j] > 0.0 else 0
        for i in range(j):
            if q[ID, i] == q[ID, j]:
                a, e, r = 0, 0 if q[WE, i] > 0.0 else e, 0 if q[WR, i] > 0.0 else r
        total += a + e + r
    return total


@called
def grouped(q, l, n, g, first):
    """Write the sums of each anchor's columns of l into g (9, M), and the place of its first packet
    into `first` (M,); the number M of anchors.
    """
    m = 0
    for j in range(n):
        i = 0
        while i < m and q[ID, first[i]] != q[ID, j]:
            i += 1
        if i == m:
            first[m], m = j, m + 1
            for c in range(9):
                g[c, i] = 0.0
        for c in range(9):
            g[c, i] += l[c, j]
    return m


@called
def nearest(flat, z, a00, a10, a11, a20, a21, a22, g0, g1, g2):
    """The point nearest to lines, at the height z if `flat`, and whether they determine it."""
    if flat:
        g0, g1, g2 = g0 - a20 * z, g1 - a21 * z, 0.0
        a20, a21, a22 = 0.0, 0.0, a00 + a11
    x, y, w, sound = solve(a00, a10, a11, a20, a21, a22, g0, g1, g2)
    return x, y, z if flat else w, sound


@inlined
def nearest_to_all(flat, z, l, n):
    """The point nearest to all lines, and whether they determine it."""
    a, b, c, d, e, f, g, h, i = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for j in range(n):
        a, b, c = a + l[0, j], b + l[1, j], c + l[2, j]
        d, e, f = d + l[3, j], e + l[4, j], f + l[5, j]
        g, h, i = g + l[6, j], h + l[7, j], i + l[8, j]
    return nearest(flat, z, a, b, c, d, e, f, g, h, i)


@called
def at_range(flat, z, q, i):
    """The point on the ray of an anchor at its range, at the height z if `flat`."""
    sp, cp = sine_cosine(q[PHI, i])
    st, ct = sine_cosine(q[THETA, i])
    a, b, c = q[RANGE, i] * cp * ct, q[RANGE, i] * sp * ct, q[RANGE, i] * st
    x = q[X, i] + a * q[R00, i] + b * q[R10, i] + c * q[R20, i]
    y = q[Y, i] + a * q[R01, i] + b * q[R11, i] + c * q[R21, i]
    w = q[Z, i] + a * q[R02, i] + b * q[R12, i] + c * q[R22, i]
    return x, y, z if flat else w


@called
def residuals(x, y, z, q, d, n, ranges, w):
    """Write differences, squared deviations and the anchors' views of (x, y, z) into d; the least
    squared distance from a pole.

    w (ROWS * CHUNK,) has CHUNK places for each row of q, of d and for the squared distances. Up to
    CHUNK anchors, q and d are parts of w; more are copied there and back. The compiler vectorises
    the loop because all of it is in one array, with a constant distance from row to row.
    """
    least, padded, copied = math.inf, n + -n % LANES, q.shape[1] > CHUNK
    for first in range(0, padded, CHUNK):
        size = min(padded - first, CHUNK)
        for i in range(RANGE if copied else 0):
            for l in range(size):
                w[CHUNK * i + l] = q[i, first + l]
        for l in range(size):
            viewed(x, y, z, l, w)
        for i in range(CA if copied else 0):
            for l in range(size):
                d[i, first + l] = w[CHUNK * (D + i) + l]
        for l in range(size):
            least = min(least, w[CHUNK * (D + RHO2) + l])
    if ranges > 0:
        for j in range(padded):
            u, v, t = d[U, j], d[V, j], d[W, j]
            d[DR, j] = q[RANGE, j] - math.sqrt(max(u * u + v * v, TINY) + t * t)
            d[SR, j] = q[WR, j] * d[DR, j] * d[DR, j]
    return least


@inlined
def viewed(x, y, z, l, w):
    """Write what `residuals` finds for the anchor in place l of w."""
    dx, dy, dz = x - w[CHUNK * X + l], y - w[CHUNK * Y + l], z - w[CHUNK * Z + l]
    u = w[CHUNK * R00 + l] * dx + w[CHUNK * R01 + l] * dy + w[CHUNK * R02 + l] * dz
    v = w[CHUNK * R10 + l] * dx + w[CHUNK * R11 + l] * dy + w[CHUNK * R12 + l] * dz
    t = w[CHUNK * R20 + l] * dx + w[CHUNK * R21 + l] * dy + w[CHUNK * R22 + l] * dz
    rho2 = max(u * u + v * v, TINY)
    rho = math.sqrt(rho2)
    da = wrapped(w[CHUNK * PHI + l] - angle(v, u, rho))
    de = w[CHUNK * THETA + l] - angle(t, rho, math.sqrt(rho2 + t * t))
    w[CHUNK * (D + DA) + l], w[CHUNK * (D + DE) + l] = da, de
    w[CHUNK * (D + SA) + l] = w[CHUNK * WA + l] * da * da
    w[CHUNK * (D + SE) + l] = w[CHUNK * WE + l] * de * de
    w[CHUNK * (D + U) + l], w[CHUNK * (D + V) + l] = u, v
    w[CHUNK * (D + W) + l], w[CHUNK * (D + RHO2) + l] = t, rho2


@called
def weigh(loss, k, m, q, d, n, ranges):
    """Write the weights of angles and ranges over their variances into d; the weighted squares."""
    total = 0.0
    for j in range(n + -n % LANES):
        a, e = weight(loss, k, m, d[SA, j]), weight(loss, k, m, d[SE, j])
        d[CA, j], d[CE, j] = q[WA, j] * a, q[WE, j] * e
        total += a * d[SA, j] + e * d[SE, j]
    if ranges > 0:
        for j in range(n + -n % LANES):
            a = weight(loss, k, m, d[SR, j])
            d[CR, j] = q[WR, j] * a
            total += a * d[SR, j]
    return total


@called
def equations(flat, capped, q, d, n, ranges):
    """Normal equations from the weights and views in d; those of the covariance are `capped`: near
    an anchor's pole, its azimuth counts as at one deviation of the elevation from it.
    """
    a00 = a10 = a11 = a20 = a21 = a22 = g0 = g1 = g2 = 0.0
    for j in range(n + -n % LANES):
        u, v, w, a, e = d[U, j], d[V, j], d[W, j], d[CA, j], d[CE, j]
        rho2 = max(u * u + v * v, TINY)
        r2, t = rho2 + w * w, w / math.sqrt(rho2)
        a = a * min(1.0, rho2 * q[WE, j] / r2) if capped & (q[WE, j] > 0.0) else a
        ia, ie = 1.0 / rho2, 1.0 / r2
        rho = math.sqrt(rho2)
        p0 = (u * q[R10, j] - v * q[R00, j]) * ia
        p1 = (u * q[R11, j] - v * q[R01, j]) * ia
        p2 = (u * q[R12, j] - v * q[R02, j]) * ia
        h0 = (rho * q[R20, j] - t * (u * q[R00, j] + v * q[R10, j])) * ie
        h1 = (rho * q[R21, j] - t * (u * q[R01, j] + v * q[R11, j])) * ie
        h2 = (rho * q[R22, j] - t * (u * q[R02, j] + v * q[R12, j])) * ie
        a00 += a * p0 * p0 + e * h0 * h0
        a10 += a * p0 * p1 + e * h0 * h1
        a11 += a * p1 * p1 + e * h1 * h1
        a20 += a * p0 * p2 + e * h0 * h2
        a21 += a * p1 * p2 + e * h1 * h2
        a22 += a * p2 * p2 + e * h2 * h2
        g0 += a * p0 * d[DA, j] + e * h0 * d[DE, j]
        g1 += a * p1 * d[DA, j] + e * h1 * d[DE, j]
        g2 += a * p2 * d[DA, j] + e * h2 * d[DE, j]
    if ranges > 0:
        for j in range(n + -n % LANES):
            u, v, w, a = d[U, j], d[V, j], d[W, j], d[CR, j]
            i = 1.0 / math.sqrt(max(u * u + v * v, TINY) + w * w)
            p0 = (u * q[R00, j] + v * q[R10, j] + w * q[R20, j]) * i
            p1 = (u * q[R01, j] + v * q[R11, j] + w * q[R21, j]) * i
            p2 = (u * q[R02, j] + v * q[R12, j] + w * q[R22, j]) * i
            a00, a10, a11 = a00 + a * p0 * p0, a10 + a * p0 * p1, a11 + a * p1 * p1
            a20, a21, a22 = a20 + a * p0 * p2, a21 + a * p1 * p2, a22 + a * p2 * p2
            a = a * d[DR, j]
            g0, g1, g2 = g0 + a * p0, g1 + a * p1, g2 + a * p2
    if flat:
        a20, a21, a22, g2 = 0.0, 0.0, a00 + a11, 0.0
    return a00, a10, a11, a20, a21, a22, g0, g1, g2
