"""Log likelihoods of a tile of particles, in single precision.

Azimuths are relative to the measured azimuth, because the anchor's frame is turned by it. So no
difference of angles needs wrapping: |a| = 2 atan(|y| / (rho + |x|)).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from llvmlite import ir
from numba import carray, types
from numba.core import cgutils
from numba.extending import intrinsic

from aoabench.kernels.compile import inlined, kernel
from aoabench.kernels.philox import TILE
from aoabench.kernels.single import ONE, ZERO, arctan, as_float, as_int, f4, i4
from aoabench.kernels.small import AZEL, UNIT_VECTOR

PAIRS = 2 * 181  # entries of the table for AZEL_ADAPTIVE, twice; see `loglik`
SCRATCH = 8 * TILE
TERMS = 15  # columns of the table of coefficients; see `loglik`

FOUR, HALF_PI = f4(4.0), f4(math.pi / 2)
TINY = f4(1e-30)  # m^2 or m: avoids 0 / 0 for a particle at an anchor or on its pole axis
DEGREES, NINETY = f4(180.0 / math.pi), f4(90.0)
_0, _180 = i4(0), i4(180)


@intrinsic
def stack(typingctx: Any, size: Any) -> Any:
    """Pointer to `size` float32 on the stack; no other pointer can reach them, so that loops need
    no check for overlaps.
    """
    if not isinstance(size, types.IntegerLiteral):
        return None  # numba types the call again with the constant
    n = size.literal_value

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        memory = cgutils.alloca_once(builder, ir.ArrayType(ir.FloatType(), n))
        memory.align = 64
        return builder.bitcast(memory, ir.FloatType().as_pointer())

    return types.CPointer(types.float32)(size), generate


@intrinsic
def copy_pair(typingctx: Any, source: Any, i: Any, target: Any, k: Any) -> Any:
    """target[2 k], target[2 k + 1] = source[2 i], source[2 i + 1] in one access of 64 bits.

    The load is atomic, so that the compiler does not replace it by gather instructions, which are
    several times slower.
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


@inlined
def first_quadrant(y, x):
    """atan2(y, x) of y, x >= 0."""
    a = arctan(min(y, x) / (max(y, x) + TINY))
    return HALF_PI - a if y > x else a


@inlined
def turned(x, y, z, t, out):
    """One tile's particles in the turned frame of the anchor with terms t, into the first three
    tiles of out.

    It has a loop of its own, because its constants and those of `angles` do not fit into the
    registers together.
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
    """Log likelihood of one step into out (N,), N a multiple of TILE, without terms that are equal
    for all particles.

    x, y, z (N,) m are relative to the origin. `terms` (B, TERMS) has one row for each anchor: its
    position, then

    - UNIT_VECTOR: the measured direction in the global frame, kappa / 2
    - AZEL: the rotation into the anchor's frame turned by the measured azimuth, the measured
      elevation, 1 / (2 variance) of azimuth and of elevation
    - AZEL_ADAPTIVE: the same with 1 or 0 (measured or not) in place of each 1 / (2 variance);
      `table` (4 x 181) holds the pairs of 1 / (2 variance) at elevations of -90, -89 ... 90
      degrees, then half the logarithms of these.
    """
    tile, scratch = carray(stack(TILE), TILE), carray(stack(SCRATCH), SCRATCH)
    for o in range(0, len(x), TILE):
        loglik_tile(
            kind, x[o : o + TILE], y[o : o + TILE], z[o : o + TILE], terms, table, tile, scratch
        )
        for i in range(TILE):
            out[o + i] = tile[i]
