"""Particle filter kernels: single precision, vectorised over particles, random numbers by counter.

The arithmetic is `filters/particle.py`'s. What differs is the order and the precision:

- Philox4x32-10 [Salmon et al., SC 2011] with the counter (place, step, replication, stream): every
  filter of a replication moves its particles by the same normals, whoever computes them, and as
  many as it likes.
- positions are relative to the prior's mean; azimuths are measured from the measured azimuth (the
  anchor's frame is turned by it), so that no difference of angles needs wrapping:
  |a| = 2 atan(|y| / (rho + |x|)).
- loops run over tiles of `TILE` particles, the last one padded with weight 0, so that the compiler
  vectorises them: no calls inside, arrays contiguous, constant length.
- sums of weights are single precision within a tile and double over tiles; cumulative weights are
  double.

Whoever changes this file: kernels may use nothing but this file (the cache on disk sees only its
own), and `tests/theory/test_particle_kernels.py` reads the generated machine code.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba import carray, njit, types
from numba.core import cgutils
from numba.extending import intrinsic

TILE = 256
QUARTER = TILE // 4
PAIRS = 2 * 181  # entries of the table for AZEL_ADAPTIVE, twice; see `loglik`
SCRATCH = 8 * TILE
UNIT_VECTOR, AZEL, AZEL_ADAPTIVE = range(3)  # measurement models
NORMALS, TURNS = range(2)  # streams
TERMS = 15  # columns of the table of coefficients; see `loglik`

LONELY = 1.00001  # an effective number of particles that has no covariance

f4, f8, i4, u4, u8 = np.float32, np.float64, np.int32, np.uint32, np.uint64
# contract: fused multiply-add; reassoc, nsz: sums in lanes; no flag may assume that infinities do
# not occur
OPTIONS: dict[str, Any] = {"fastmath": {"contract", "reassoc", "nsz"}, "error_model": "numpy"}


def kernel(signature: str) -> Callable[[Callable], Callable]:
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


@intrinsic
def as_float(typingctx: Any, bits: Any) -> Any:
    """The float32 whose bits are those of an int32."""
    return types.float32(types.int32), lambda c, builder, s, a: builder.bitcast(
        a[0], ir.FloatType()
    )


@intrinsic
def as_int(typingctx: Any, x: Any) -> Any:
    """The bits of a float32 as int32."""
    return types.int32(types.float32), lambda c, builder, s, a: builder.bitcast(
        a[0], ir.IntType(32)
    )


@intrinsic
def larger(typingctx: Any, a: Any, b: Any) -> Any:
    """max(a, b) of two float32, neither of them NaN, such that a loop over it vectorises."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        flags = ("nnan", "nsz")
        return builder.select(builder.fcmp_ordered(">", *args, flags=flags), *args, flags=flags)

    return types.float32(types.float32, types.float32), generate


@intrinsic
def stack(typingctx: Any, size: Any) -> Any:
    """`size` float32 on the stack: nothing else can point there, so loops need no check for
    overlaps.
    """
    if not isinstance(size, types.IntegerLiteral):
        return None  # the compiler asks again with the constant
    n = size.literal_value

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        memory = cgutils.alloca_once(builder, ir.ArrayType(ir.FloatType(), n))
        memory.align = 64
        return builder.bitcast(memory, ir.FloatType().as_pointer())

    return types.CPointer(types.float32)(size), generate


@intrinsic
def copy_pair(typingctx: Any, source: Any, i: Any, target: Any, k: Any) -> Any:
    """target[2 k], target[2 k + 1] = source[2 i], source[2 i + 1] in one go of 64 bits.

    The load is atomic to keep the compiler from gathering, which is several times slower than what
    it replaces.
    """

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        pair = ir.IntType(64).as_pointer()
        of = [
            builder.bitcast(
                context.make_array(signature.args[m])(context, builder, args[m]).data, pair
            )
            for m in (0, 2)
        ]
        value = builder.load_atomic(builder.gep(of[0], [args[1]]), "monotonic", 8)
        builder.store(value, builder.gep(of[1], [args[3]]))
        return context.get_dummy_value()

    return types.void(source, types.int32, target, types.intp), generate


# ---------------------------------------------------------------- polynomials, minimax over the ran

ZERO, HALF, ONE, FOUR = f4(0.0), f4(0.5), f4(1.0), f4(4.0)
LOWEST = f4(
    -40.0
)  # smaller weights would not be seen beside the largest, 1, and their squares would be denormal
HALF_PI, PI, LOG2, LOG2E = f4(math.pi / 2), f4(math.pi), f4(math.log(2.0)), f4(1.0 / math.log(2.0))
TINY = f4(1e-30)  # m^2 or m: a particle on its anchor, or on its pole

_A0, _A1, _A2, _A3, _A4, _A5, _A6, _A7 = (
    f4(c)
    for c in (
        0.999999901,
        -0.3333199075,
        0.1996972389,
        -0.1401948087,
        0.09914292764,
        -0.05948639267,
        0.024252403,
    )
    + (-0.004693276039,)
)
_E0, _E1, _E2, _E3, _E4, _E5 = (
    f4(c)
    for c in (
        1.000000072,
        0.6931469671,
        0.2402211972,
        0.05550713272,
        0.009675541343,
        0.001327647263,
    )
)
_L0, _L1, _L2, _L3, _L4, _L5, _L6, _L7 = (
    f4(c)
    for c in (
        0.9999999453,
        -0.5000036512,
        0.3333505894,
        -0.2496990914,
        0.1990016553,
        -0.1725082891,
        0.162225804,
    )
    + (-0.1010689832,)
)
_S0, _S1, _S2, _S3 = (f4(c) for c in (1.570796322, -0.6459634602, 0.07968003277, -0.004601657891))
_C0, _C1, _C2, _C3 = (f4(c) for c in (0.9999999724, -1.233697014, 0.2535986441, -0.02040835251))
_BIAS, _FRACTION, _ROOT_HALF = (
    i4(127),
    i4(0x007FFFFF),
    i4(0x3F3504F3),
)  # the float32 format; the bits of sqrt(1/2)
_0, _1, _23, _31, _180 = i4(0), i4(1), i4(23), i4(31), i4(180)
DEGREES, NINETY = f4(180.0 / math.pi), f4(90.0)


@inlined
def arctan(t):
    """atan(t), 0 <= t <= 1; relative error below 2.5e-7."""
    u = t * t
    return t * (
        _A0 + u * (_A1 + u * (_A2 + u * (_A3 + u * (_A4 + u * (_A5 + u * (_A6 + u * _A7))))))
    )


@inlined
def exponential(x):
    """exp(x), x <= 0; relative error below 4e-6 (3e-7 for x > -1), and 0 from x = -40 down"""
    v = larger(x, LOWEST) * LOG2E
    k = np.floor(v + HALF)
    f = v - k
    p = _E0 + f * (_E1 + f * (_E2 + f * (_E3 + f * (_E4 + f * _E5))))
    scale = as_float(i4((i4(k) + _BIAS) << _23))
    return p * scale if x > LOWEST else ZERO


@inlined
def logarithm(x):
    """log(x), 2^-33 <= x <= 1; absolute error below 2e-6, relative below 4e-7."""
    b = i4(as_int(x) - _ROOT_HALF)
    e = i4(b >> _23)
    f = as_float(i4(i4(b & _FRACTION) + _ROOT_HALF)) - ONE
    p = _L0 + f * (_L1 + f * (_L2 + f * (_L3 + f * (_L4 + f * (_L5 + f * (_L6 + f * _L7))))))
    return f * p + f4(e) * LOG2


@inlined
def circle(k):
    """A point (sin, cos) of the unit circle from 32 random bits: the quarter from two of them, the
    angle in it.
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


# --------------------------------------------------------------------------------------------------

_WORD, _SHIFT = u8(0xFFFFFFFF), u8(32)
_M0, _M1, _W0, _W1 = u8(0xD2511F53), u8(0xCD9E8D57), u8(0x9E3779B9), u8(0xBB67AE85)


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
    """Box and Muller on the four words of one counter."""
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


@kernel("f8(u8, u8, u8, u8)")
def turn(step, replication, k0, k1):
    """One uniform in [0, 1) for the resampling after a step."""
    return f8(philox(u8(0), step, replication, u8(TURNS), k0, k1)[0]) * 2.0**-32


# -------------------------------------------------------------------------------------- likelihoods


@inlined
def first_quadrant(y, x):
    """atan2(y, x) of y, x >= 0."""
    a = arctan(min(y, x) / (max(y, x) + TINY))
    return HALF_PI - a if y > x else a


@inlined
def turned(x, y, z, t, out):
    """One tile's particles in the turned frame of the anchor with terms t, into the first three
    tiles of out.

    A loop of its own: together with `angles` its constants would not fit into the registers.
    """
    for i in range(TILE):
        px, py, pz = x[i] - t[0], y[i] - t[1], z[i] - t[2]
        out[i] = t[3] * px + t[4] * py + t[5] * pz
        out[TILE + i] = t[6] * px + t[7] * py + t[8] * pz
        out[2 * TILE + i] = t[9] * px + t[10] * py + t[11] * pz


@inlined
def angles(u, v, w):
    """|azimuth - measured| / 2 and elevation, in rad, of one particle in the turned frame."""
    rho = math.sqrt(u * u + v * v)
    a = arctan(abs(v) / (rho + abs(u) + TINY))
    e = first_quadrant(abs(w), rho)
    return a if u >= ZERO else HALF_PI - a, math.copysign(e, w)


@inlined
def loglik_tile(kind, x, y, z, terms, table, out, scratch):
    """Log likelihood of one step for one tile into out (TILE,); see `loglik`."""
    for i in range(TILE):
        out[i] = ZERO
    for j in range(terms.shape[0]):
        r = terms[j]
        t = (
            r[0],
            r[1],
            r[2],
            r[3],
            r[4],
            r[5],
            r[6],
            r[7],
            r[8],
            r[9],
            r[10],
            r[11],
            r[12],
            r[13],
            r[14],
        )
        if kind == UNIT_VECTOR:
            for i in range(TILE):
                px, py, pz = x[i] - t[0], y[i] - t[1], z[i] - t[2]
                inverse = ONE / math.sqrt(px * px + py * py + pz * pz + TINY)
                ex, ey, ez = t[3] - px * inverse, t[4] - py * inverse, t[5] - pz * inverse
                out[i] -= t[6] * (ex * ex + ey * ey + ez * ez)
        elif kind == AZEL:
            turned(x, y, z, t, scratch)
            wa = FOUR * t[13]
            for i in range(TILE):
                a, e = angles(scratch[i], scratch[TILE + i], scratch[2 * TILE + i])
                e -= t[12]
                out[i] -= wa * a * a + t[14] * e * e
        else:
            place = scratch[5 * TILE :]
            turned(x, y, z, t, place)
            for i in range(TILE):
                a, e = angles(place[i], place[TILE + i], place[2 * TILE + i])
                scratch[i] = as_float(min(max(i4(np.rint(e * DEGREES + NINETY)), _0), _180))
                e -= t[12]
                scratch[TILE + i] = FOUR * a * a
                scratch[2 * TILE + i] = e * e
            weights, logs, half_logs = scratch[3 * TILE :], scratch[5 * TILE :], table[PAIRS:]
            for i in range(TILE):
                copy_pair(table, as_int(scratch[i]), weights, i)
                copy_pair(half_logs, as_int(scratch[i]), logs, i)
            for i in range(TILE):
                wa, we, la, le = weights[2 * i], weights[2 * i + 1], logs[2 * i], logs[2 * i + 1]
                a2, e2 = scratch[TILE + i], scratch[2 * TILE + i]
                out[i] += t[13] * (la - wa * a2) + t[14] * (le - we * e2)


@kernel("void(i8, f4[::1], f4[::1], f4[::1], f4[:,::1], f4[::1], f4[::1])")
def loglik(kind, x, y, z, terms, table, out):
    """Log likelihood of one step, less what is the same for all particles, into out (N,), N a
    multiple of TILE.

    x, y, z (N,) m relative to the origin. One row of `terms` (B, TERMS) for each anchor; its
    position first, then

    - UNIT_VECTOR: the measured direction in the global frame, kappa / 2
    - AZEL: the rotation into the anchor's frame turned by the measured azimuth, the measured
      elevation, 1 / (2 variance) of azimuth and of elevation
    - AZEL_ADAPTIVE: the same with 1 or 0 (measured or not) in place of these two; they stand in
      `table` (4 x 181), in pairs for -90, -89 ... 90 degrees of elevation, and after them half
      their logarithms.
    """
    tile, scratch = carray(stack(TILE), TILE), carray(stack(SCRATCH), SCRATCH)
    for o in range(0, len(x), TILE):
        loglik_tile(
            kind, x[o : o + TILE], y[o : o + TILE], z[o : o + TILE], terms, table, tile, scratch
        )
        for i in range(TILE):
            out[o + i] = tile[i]


# --------------------------------------------------------------------------------------------------


@inlined
def move(x, y, z, n0, n1, n2, F, b, L):
    """theta = F theta + b + L n for one tile; L is lower triangular."""
    for i in range(TILE):
        p, q, r = x[i], y[i], z[i]
        u, v, w = n0[i], n1[i], n2[i]
        x[i] = b[0] + F[0] * p + F[1] * q + F[2] * r + L[0] * u
        y[i] = b[1] + F[3] * p + F[4] * q + F[5] * r + L[3] * u + L[4] * v
        z[i] = b[2] + F[6] * p + F[7] * q + F[8] * r + L[6] * u + L[7] * v + L[8] * w


@inlined
def weigh(x, y, z, log_w, w, top, c):
    """Weights of one tile, relative to the largest one's logarithm `top`; their sum, their
    squares', first moments.
    """
    a = a2 = ax = ay = az = ZERO
    for i in range(TILE):
        l = log_w[i] - top
        log_w[i] = l
        v = exponential(l)
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
def first_children(cumulative, scale, offset, end, first):
    """The places where particles i + 1 have their first child, at most `end`; `cumulative` begins
    at `offset`.
    """
    for i in range(len(cumulative)):
        first[i] = min(i4(math.ceil(cumulative[i] * scale + offset)), end)


@kernel("void(f4[::1], i8, f8, f8[::1], i4[::1], f4[::1], f4[:,::1], f4[:,::1])")
def resample(w, N, uniform, cumulative, first, parent, x, children):
    """Systematic resampling of particles x (3, M) with weights w (M,), 0 from N on, and one uniform
    in [0, 1).

    Particle i + 1 has its first child where the weights up to i end. Of several with the same place
    the last one has it, the others have no children; a running maximum finds the parent of the
    other children. Without a branch that could be mispredicted: the numbers of parents are float32,
    exact to 2^24. `cumulative`, `first` (M,), `parent` (M + 1,): scratch.
    """
    q = len(w) // 4
    c0 = c1 = c2 = c3 = 0.0  # four quarters at once: sums that need not wait for each other
    for i in range(q):
        c0 += w[i]
        cumulative[i] = c0
        c1 += w[q + i]
        cumulative[q + i] = c1
        c2 += w[2 * q + i]
        cumulative[2 * q + i] = c2
        c3 += w[3 * q + i]
        cumulative[3 * q + i] = c3
    c1 += c0
    c2 += c1
    scale, end = N / (c2 + c3), i4(N)
    first_children(cumulative[:q], scale, -uniform, end, first[:q])
    first_children(cumulative[q : 2 * q], scale, c0 * scale - uniform, end, first[q : 2 * q])
    first_children(
        cumulative[2 * q : 3 * q], scale, c1 * scale - uniform, end, first[2 * q : 3 * q]
    )
    first_children(cumulative[3 * q :], scale, c2 * scale - uniform, end, first[3 * q :])
    parent[:] = ZERO
    for i in range(N - 1):
        parent[u4(first[i])] = f4(i + 1)
    a, b, c = x[0], x[1], x[2]
    u, v, w_ = children[0], children[1], children[2]
    last = ZERO
    for i in range(N):
        last = larger(last, parent[i])
        j = u4(i4(last))
        u[i] = a[j]
        v[i] = b[j]
        w_[i] = c[j]


@inlined
def flat(A):
    """The 3 x 3 matrix A as nine float32."""
    a, b, c = A[0], A[1], A[2]
    return f4(a[0]), f4(a[1]), f4(a[2]), f4(b[0]), f4(b[1]), f4(b[2]), f4(c[0]), f4(c[1]), f4(c[2])


@kernel(
    "void(i8, i8, f4[:,:,::1], u8, u8, u8, f8[:,::1], f8[::1], f8[:,::1], f8[:,::1], f4[:,:,::1],"
    "f4[::1], f8, f8[:,::1], f4[:,:,::1])"
)
def lap(
    kind,
    N,
    noise,
    replication,
    k0,
    k1,
    F,
    b,
    root_Q,
    root_P,
    terms,
    table,
    resample_below,
    out,
    chosen,
):
    """One replication: posterior means, covariances and effective numbers of particles into out (T,
    13).

    `terms` (T, B, TERMS) and `table` as for `loglik`; positions relative to the prior's mean, with
    theta = F theta + b + n. `noise` (T + 1, 3, M), M the padded N, holds the normals of the prior
    and of each step; with (1, 3, M) they are drawn here. `chosen` (T, 2, N) receives, at each step
    that ends in resampling, every particle's parent and the weights that parents were chosen by;
    with (0, 2, N) nobody asks.
    """
    M = noise.shape[2]
    T = terms.shape[0]
    particles, children = np.zeros((3, M), f4), np.zeros((3, M), f4)
    x, y, z = particles[0], particles[1], particles[2]
    log_w, w = np.empty(M, f4), np.empty(M, f4)
    cumulative, first, parent = np.empty(M, f8), np.empty(M, i4), np.empty(M + 1, f4)
    tile, scratch = carray(stack(TILE), TILE), carray(stack(SCRATCH), SCRATCH)
    log_w[:N] = ZERO
    log_w[N:] = f4(-np.inf)
    F_, b_, L = flat(F), (f4(b[0]), f4(b[1]), f4(b[2])), flat(root_Q)
    P_, none = flat(root_P), (ZERO, ZERO, ZERO)
    shared = noise.shape[0] > 1
    if not shared:
        normals(noise[0], u8(0), replication, k0, k1)
    for o in range(0, M, TILE):
        s = slice(o, o + TILE)
        move(x[s], y[s], z[s], noise[0, 0, s], noise[0, 1, s], noise[0, 2, s], P_, none, P_)
    mx, my, mz = 0.0, 0.0, 0.0
    for k in range(T):
        plane = k + 1
        if not shared:
            plane = 0
            normals(noise[0], u8(k + 1), replication, k0, k1)
        n = noise[plane]
        x, y, z = particles[0], particles[1], particles[2]
        top = f4(-np.inf)
        for o in range(0, M, TILE):
            s = slice(o, o + TILE)
            xs, ys, zs, ls = x[s], y[s], z[s], log_w[s]
            move(xs, ys, zs, n[0, s], n[1, s], n[2, s], F_, b_, L)
            loglik_tile(kind, xs, ys, zs, terms[k], table, tile, scratch)
            for i in range(TILE):
                l = ls[i] + tile[i]
                ls[i] = l
                top = larger(top, l)
        c = (f4(mx), f4(my), f4(mz))
        S = S2 = Sx = Sy = Sz = 0.0
        for o in range(0, M, TILE):
            s = slice(o, o + TILE)
            a, a2, ax, ay, az = weigh(x[s], y[s], z[s], log_w[s], w[s], top, c)
            S, S2, Sx, Sy, Sz = S + a, S2 + a2, Sx + ax, Sy + ay, Sz + az
        mx, my, mz = c[0] + Sx / S, c[1] + Sy / S, c[2] + Sz / S
        effective = S * S / S2
        c = (f4(mx), f4(my), f4(mz))
        Sxx = Sxy = Sxz = Syy = Syz = Szz = 0.0
        for o in range(0, M, TILE):
            s = slice(o, o + TILE)
            axx, axy, axz, ayy, ayz, azz = squares(x[s], y[s], z[s], w[s], c)
            Sxx, Sxy, Sxz, Syy, Syz, Szz = (
                Sxx + axx,
                Sxy + axy,
                Sxz + axz,
                Syy + ayy,
                Syz + ayz,
                Szz + azz,
            )
        row = out[k]
        row[0], row[1], row[2], row[12] = mx, my, mz, effective
        if effective < LONELY:  # what is left are rounding errors
            S = math.inf
        row[3], row[7], row[11] = Sxx / S, Syy / S, Szz / S
        row[4] = row[6] = Sxy / S
        row[5] = row[9] = Sxz / S
        row[8] = row[10] = Syz / S
        if effective < resample_below * N:
            resample(
                w,
                N,
                turn(u8(k + 1), replication, k0, k1),
                cumulative,
                first,
                parent,
                particles,
                children,
            )
            particles, children = children, particles
            log_w[:N] = ZERO
            if chosen.shape[0] > 0:
                last = ZERO
                for i in range(N):
                    last = larger(last, parent[i])
                    chosen[k, 0, i] = last
                    chosen[k, 1, i] = w[i]
