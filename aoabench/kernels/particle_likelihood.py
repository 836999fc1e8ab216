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
from aoabench.kernels.single import HALF, ZERO, arctan, as_float, as_int, f4, i4, inverse_root
from aoabench.kernels.small import AZEL, UNIT_VECTOR

ROWS = 181  # of the table for AZEL_ADAPTIVE; see `loglik`
SCRATCH = 9 * TILE
TERMS = 15  # columns of the table of coefficients; see `loglik`

FOUR, HALF_PI = f4(4.0), f4(math.pi / 2)
TINY = f4(1e-30)  # m^2 or m: avoids 0 / 0 for a particle at an anchor or on its pole axis
DEGREES, NINETY = f4(360.0 / math.pi), f4(90.0)  # of half angles
_0, _2, _180 = i4(0), i4(2), i4(180)


def _on_stack(kind: Any) -> Any:
    """An intrinsic that gives a pointer to `size` numbers on the stack; no other pointer can reach
    them, so that loops need no check for overlaps.
    """

    @intrinsic
    def pointer(typingctx: Any, size: Any) -> Any:
        if not isinstance(size, types.IntegerLiteral):
            return None  # numba types the call again with the constant
        n = size.literal_value

        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            each = context.get_value_type(kind)
            memory = cgutils.alloca_once(builder, ir.ArrayType(each, n))
            memory.align = 64
            return builder.bitcast(memory, each.as_pointer())

        return types.CPointer(kind)(size), generate

    return pointer


stack, stack_f8, stack_i4 = (_on_stack(k) for k in (types.float32, types.float64, types.int32))


@intrinsic
def copy_row(typingctx: Any, table: Any, i: Any, target: Any, k: Any) -> Any:
    """target[4 k] ... target[4 k + 3] = table[i] ... table[i + 3] by one load and one store, which
    the compiler does not replace by gather instructions; these are several times slower.
    """
    row = ir.VectorType(ir.FloatType(), 4)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        def at(m: int, index: Any) -> Any:
            array = context.make_array(signature.args[m])(context, builder, args[m])
            return builder.bitcast(builder.gep(array.data, [index]), row.as_pointer())

        k4 = builder.shl(args[3], ir.Constant(args[3].type, 2))
        builder.store(builder.load(at(0, args[1]), align=4), at(2, k4), align=4)
        return context.get_dummy_value()

    return types.void(table, types.int32, target, types.intp), generate


@inlined
def place(r):
    """Position and rotation of an anchor, or its measured direction, from a row of terms."""
    return r[0], r[1], r[2], r[3], r[4], r[5], r[6], r[7], r[8], r[9], r[10], r[11]


@inlined
def tangents(x, y, z, t):
    """Tangents of half of |azimuth - measured| and of half of the elevation of one particle for
    the anchor with terms t.

    The azimuth's is folded to at most 1 and has the sign of u, the first coordinate in the turned
    frame: below 0 stands for pi / 2 less the half angle.
    """
    px, py, pz = x - t[0], y - t[1], z - t[2]
    u = t[3] * px + t[4] * py + t[5] * pz
    v = t[6] * px + t[7] * py + t[8] * pz
    w = t[9] * px + t[10] * py + t[11] * pz
    square = u * u + v * v
    rho, r = math.sqrt(square), math.sqrt(square + w * w)
    return math.copysign(v / (rho + abs(u) + TINY), u), w / (rho + r + TINY)


@inlined
def half_angles(a, e):
    """|azimuth - measured| / 2 and elevation / 2, in rad, from `tangents`."""
    half = arctan(abs(a))
    return half if a >= ZERO else HALF_PI - half, arctan(e)


@inlined
def azel(a, e, half, wa, we):
    """Minus the log likelihood of one particle for one anchor, from its `tangents`."""
    a, e = half_angles(a, e)
    e -= half
    return wa * a * a + we * e * e


@inlined
def azel_tile(x, y, z, terms, out, a, e):
    """`loglik_tile` for AZEL; a, e (TILE,) are scratch.

    A loop has the polynomials of one anchor and the roots and quotients of the next one, which the
    processor computes at the same time.
    """
    t = place(terms[0])
    for i in range(TILE):
        a[i], e[i] = tangents(x[i], y[i], z[i], t)
    last = terms.shape[0] - 1
    for j in range(last):
        r, t = terms[j], place(terms[j + 1])
        half, wa, we = HALF * r[12], FOUR * r[13], FOUR * r[14]
        for i in range(TILE):
            out[i] -= azel(a[i], e[i], half, wa, we)
            a[i], e[i] = tangents(x[i], y[i], z[i], t)
    r = terms[last]
    half, wa, we = HALF * r[12], FOUR * r[13], FOUR * r[14]
    for i in range(TILE):
        out[i] -= azel(a[i], e[i], half, wa, we)


@inlined
def row_and_squares(a, e, half):
    """Place of a row in the table, as bits of a float, and squares of the residuals of azimuth and
    elevation in rad^2, of one particle for one anchor, from its `tangents`.
    """
    a, e = half_angles(a, e)
    degree = min(max(i4(np.rint(e * DEGREES + NINETY)), _0), _180)
    e -= half
    return as_float(i4(degree << _2)), FOUR * a * a, FOUR * e * e


@inlined
def adaptive_tile(x, y, z, terms, table, out, a, e, index, a2, e2, rows):
    """`loglik_tile` for AZEL_ADAPTIVE; a, e, index, a2, e2 (TILE,) and rows (4 TILE,) are scratch.

    As in `azel_tile`, a loop works on two anchors.
    """
    t = place(terms[0])
    for i in range(TILE):
        a[i], e[i] = tangents(x[i], y[i], z[i], t)
    last = terms.shape[0] - 1
    for j in range(last + 1):
        r = terms[j]
        half, ta, te = HALF * r[12], r[13], r[14]
        if j < last:
            t = place(terms[j + 1])
            for i in range(TILE):
                index[i], a2[i], e2[i] = row_and_squares(a[i], e[i], half)
                a[i], e[i] = tangents(x[i], y[i], z[i], t)
        else:
            for i in range(TILE):
                index[i], a2[i], e2[i] = row_and_squares(a[i], e[i], half)
        for i in range(TILE):
            copy_row(table, as_int(index[i]), rows, i)
        for i in range(TILE):
            wa, we, la, le = rows[4 * i], rows[4 * i + 1], rows[4 * i + 2], rows[4 * i + 3]
            out[i] += ta * (la - wa * a2[i]) + te * (le - we * e2[i])


@inlined
def direction_tile(x, y, z, terms, out):
    """`loglik_tile` for UNIT_VECTOR."""
    for j in range(terms.shape[0]):
        t = place(terms[j])
        for i in range(TILE):
            px, py, pz = x[i] - t[0], y[i] - t[1], z[i] - t[2]
            inverse = inverse_root(px * px + py * py + pz * pz + TINY)
            ex, ey, ez = t[3] - px * inverse, t[4] - py * inverse, t[5] - pz * inverse
            out[i] -= t[6] * (ex * ex + ey * ey + ez * ez)


@inlined
def loglik_tile(kind, x, y, z, terms, table, start, out, scratch):
    """Log likelihood of one step for one tile, plus `start`, into out (TILE,); see `loglik`."""
    for i in range(TILE):
        out[i] = start
    if terms.shape[0] == 0:
        return
    a, e = scratch[:TILE], scratch[TILE : 2 * TILE]
    if kind == UNIT_VECTOR:
        direction_tile(x, y, z, terms, out)
    elif kind == AZEL:
        azel_tile(x, y, z, terms, out, a, e)
    else:
        index, a2 = scratch[2 * TILE : 3 * TILE], scratch[3 * TILE : 4 * TILE]
        e2, rows = scratch[4 * TILE : 5 * TILE], scratch[5 * TILE :]
        adaptive_tile(x, y, z, terms, table, out, a, e, index, a2, e2, rows)


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
      `table` (4 ROWS,) holds, at elevations of -90, -89 ... 90 degrees, 1 / (2 variance) of
      azimuth and of elevation, and half the logarithms of these.
    """
    tile, scratch = carray(stack(TILE), TILE), carray(stack(SCRATCH), SCRATCH)
    for o in range(0, len(x), TILE):
        s = slice(o, o + TILE)
        loglik_tile(kind, x[s], y[s], z[s], terms, table, ZERO, tile, scratch)
        part = out[s]
        for i in range(TILE):
            part[i] = tile[i]
