"""Random numbers by counter: Philox4x32-10 [Salmon et al., SC 2011] and standard normals from it.

The counter is (index, step, replication, stream). So every filter of a replication draws the same
numbers, on any worker and for any number of particles.
"""

from __future__ import annotations

import math

import numpy as np

from aoabench.kernels.compile import inlined, kernel
from aoabench.kernels.single import HALF, as_float, as_int, f4, i4, logarithm

TILE = 256  # particles
QUARTER = TILE // 4
NORMALS, TURNS = range(2)  # streams

f8, u4, u8 = np.float64, np.uint32, np.uint64

_S0, _S1, _S2, _S3 = (f4(c) for c in (1.570796322, -0.6459634602, 0.07968003277, -0.004601657891))
_C0, _C1, _C2, _C3 = (f4(c) for c in (0.9999999724, -1.233697014, 0.2535986441, -0.02040835251))
_1, _31 = i4(1), i4(31)
_WORD, _SHIFT = u8(0xFFFFFFFF), u8(32)
_M0, _M1, _W0, _W1 = u8(0xD2511F53), u8(0xCD9E8D57), u8(0x9E3779B9), u8(0xBB67AE85)


@inlined
def circle(k):
    """(sin, cos) of a uniform angle from 32 random bits: two of them choose the quarter, the others
    the angle in it.
    """
    q = i4(k >> u4(30))
    f = f4(i4(k & u4(0x3FFFFFFF))) * f4(2.0**-30) - HALF
    u = f * f
    s = f * (_S0 + u * (_S1 + u * (_S2 + u * _S3)))
    c = _C0 + u * (_C1 + u * (_C2 + u * _C3))
    odd = i4(q & _1) != 0
    a = c if odd else s
    b = s if odd else c
    return as_float(i4(as_int(a) ^ i4(i4(q >> _1) << _31))), as_float(
        i4(as_int(b) ^ i4(i4(i4(q + _1) >> _1) << _31))
    )


@inlined
def radius(k):
    """sqrt(-2 log u) of a uniform u in (0, 1] from 32 random bits; up to 6.76."""
    return math.sqrt(f4(-2.0) * logarithm((f4(k) + HALF) * f4(2.0**-32)))


@inlined
def philox(c0, c1, c2, c3, k0, k1):
    """Four words of 32 random bits for a counter of four words and a key of two, all held in
    uint64.
    """
    for _ in range(10):
        p0, p1 = _M0 * c0, _M1 * c2
        c0, c1, c2, c3 = (p1 >> _SHIFT) ^ c1 ^ k0, p1 & _WORD, (p0 >> _SHIFT) ^ c3 ^ k1, p0 & _WORD
        k0, k1 = (k0 + _W0) & _WORD, (k1 + _W1) & _WORD
    return u4(c0), u4(c1), u4(c2), u4(c3)


@inlined
def four_normals(counter, step, replication, k0, k1):
    """Four standard normals from the four words of one counter, by Box and Muller."""
    a, b, c, d = philox(counter, step, replication, u8(NORMALS), k0, k1)
    r, t = radius(a), radius(c)
    s0, c0 = circle(b)
    s1, c1 = circle(d)
    return r * s0, r * c0, t * s1, t * c1


@kernel("void(f4[:,::1], u8, u8, u8, u8)")
def normals(out, step, replication, k0, k1):
    """Standard normals into out (3, N), N a multiple of TILE.

    Three counters make the three normals of four particles, a quarter of a tile apart.
    """
    for o in range(0, out.shape[1], TILE):
        x, y, z = out[0, o : o + TILE], out[1, o : o + TILE], out[2, o : o + TILE]
        for i in range(QUARTER):
            first = u8(3) * u8(o // 4 + i)
            p, q, r = i + QUARTER, i + 2 * QUARTER, i + 3 * QUARTER
            x[i], y[i], z[i], x[p] = four_normals(first, step, replication, k0, k1)
            y[p], z[p], x[q], y[q] = four_normals(first + u8(1), step, replication, k0, k1)
            z[q], x[r], y[r], z[r] = four_normals(first + u8(2), step, replication, k0, k1)


@kernel("void(f4[:,:,::1], u8, u8, u8)")
def draw(out, replication, k0, k1):
    """Standard normals of the prior and of all steps of one replication into out (T + 1, 3, N)."""
    for step in range(out.shape[0]):
        normals(out[step], u8(step), replication, k0, k1)


@kernel("f8(u8, u8, u8, u8)")
def turn(step, replication, k0, k1):
    """One uniform in [0, 1) for the resampling after a step."""
    return f8(philox(u8(0), step, replication, u8(TURNS), k0, k1)[0]) * 2.0**-32
