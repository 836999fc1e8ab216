"""Weights of particles and their sums, tile by tile.

A tile's weights are relative to its own largest one, so that one pass over the particles is enough;
`added` gives all tiles a common scale.
"""

from __future__ import annotations

import numpy as np

from aoabench.kernels.compile import inlined
from aoabench.kernels.limits import ONE_PARTICLE
from aoabench.kernels.philox import TILE, f8
from aoabench.kernels.single import ZERO, exponential, f4, larger, precise_exponential

SUMS = 11  # of weights, their squares, x, y, z and xx, xy, xz, yy, yz, zz


@inlined
def weigh(x, y, z, log_w, w, top, c):
    """Sums over one tile of the weights, of their squares and of the first moments about c.

    The weights, relative to the one with the logarithm `top`, go into w.
    """
    a = a2 = ax = ay = az = ZERO
    for i in range(TILE):
        v = exponential(log_w[i] - top)
        w[i] = v
        a += v
        a2 += v * v
        ax += v * (x[i] - c[0])
        ay += v * (y[i] - c[1])
        az += v * (z[i] - c[2])
    return a, a2, ax, ay, az


@inlined
def squares(x, y, z, w, c):
    """Second moments of one tile about c: xx, xy, xz, yy, yz, zz."""
    xx = xy = xz = yy = yz = zz = ZERO
    for i in range(TILE):
        p, q, r, v = x[i] - c[0], y[i] - c[1], z[i] - c[2], w[i]
        vp, vq = v * p, v * q
        xx += vp * p
        xy += vp * q
        xz += vp * r
        yy += vq * q
        yz += vq * r
        zz += v * r * r
    return xx, xy, xz, yy, yz, zz


@inlined
def summed(x, y, z, log_w, w, top, c, sums):
    """Sums of one tile about c into sums (SUMS,), and its weights into w.

    Single precision has the second moments about the tile's own mean.
    """
    a, a2, ax, ay, az = weigh(x, y, z, log_w, w, top, c)
    if a == ZERO:
        sums[:] = 0.0
        return
    own = c[0] + ax / a, c[1] + ay / a, c[2] + az / a
    xx, xy, xz, yy, yz, zz = squares(x, y, z, w, own)
    p, q, r = f8(own[0]) - f8(c[0]), f8(own[1]) - f8(c[1]), f8(own[2]) - f8(c[2])
    A, X, Y, Z = f8(a), f8(ax), f8(ay), f8(az)
    sums[0], sums[1], sums[2], sums[3], sums[4] = A, a2, X, Y, Z
    sums[5], sums[8] = xx + p * (2 * X - A * p), yy + q * (2 * Y - A * q)
    sums[10] = zz + r * (2 * Z - A * r)
    sums[6] = xy + p * Y + q * X - A * p * q
    sums[7] = xz + p * Z + r * X - A * p * r
    sums[9] = yz + q * Z + r * Y - A * q * r


@inlined
def added(tiles, tops, scales, total):
    """Largest of `tops`, the logarithms of each tile's largest weight; the sums over all tiles go
    into total (SUMS,), the scale of each tile's weights into scales.
    """
    top = f4(-np.inf)
    for j in range(len(tops)):
        top = larger(top, tops[j])
    total[:] = 0.0
    for j in range(len(tops)):
        scale = precise_exponential(tops[j] - top)
        scales[j] = scale
        for i in range(SUMS):
            total[i] += scale * tiles[j, i]
        total[1] += scale * (scale - 1.0) * tiles[j, 1]
    return top


@inlined
def report(total, c, row):
    """Mean, covariance and effective number of particles into row (13,), from sums about c."""
    S = total[0]
    x, y, z = total[2] / S, total[3] / S, total[4] / S
    row[0], row[1], row[2], row[12] = c[0] + x, c[1] + y, c[2] + z, S * S / total[1]
    if row[12] < ONE_PARTICLE:  # the covariance is 0
        row[3:12] = 0.0
        return
    row[3], row[7], row[11] = total[5] / S - x * x, total[8] / S - y * y, total[10] / S - z * z
    row[4] = row[6] = total[6] / S - x * y
    row[5] = row[9] = total[7] / S - x * z
    row[8] = row[10] = total[9] / S - y * z
