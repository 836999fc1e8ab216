"""Systematic resampling, tile by tile."""

from __future__ import annotations

import math

from numba import carray

from aoabench.kernels.compile import inlined, kernel
from aoabench.kernels.particle_likelihood import stack_f8, stack_i4
from aoabench.kernels.philox import TILE, f8, u4
from aoabench.kernels.single import i4

QUARTER = TILE // 4


@inlined
def cumulate(w, out):
    """Cumulative weights of each quarter of a tile into out (TILE,), and the sums of the quarters.

    The processor overlaps the four independent sums.
    """
    a = b = c = d = 0.0
    for i in range(QUARTER):
        a += w[i]
        out[i] = a
        b += w[QUARTER + i]
        out[QUARTER + i] = b
        c += w[2 * QUARTER + i]
        out[2 * QUARTER + i] = c
        d += w[3 * QUARTER + i]
        out[3 * QUARTER + i] = d
    return a, b, c, d


@inlined
def first_children(cumulative, scale, offset, end, first):
    """Index of the first child of each particle i + 1, at most `end`, into `first`; the scaled
    cumulative weights begin at `offset`.
    """
    for i in range(QUARTER):
        first[i] = min(i4(math.ceil(cumulative[i] * scale + offset)), end)


@inlined
def parents(w, scales, N, uniform, parent, cumulative, first):
    """Parents of first children into parent (M + 1,), 0 elsewhere; for weights w (M,), 0 from N on,
    times the scale of each tile, and one `uniform` in [0, 1).

    The first child of particle i + 1 is the first point above the cumulative weight of particle i.
    If several particles have the same first child, the last of them is its parent and the others
    have no children. A running maximum over the parents of first children gives the parents of all
    children, without a branch that could be mispredicted. `cumulative` and `first` (TILE,) are
    scratch.
    """
    total = 0.0
    for j in range(len(scales)):
        part = 0.0
        for i in range(TILE):
            part += f8(w[j * TILE + i])
        total += scales[j] * part
    parent[:] = i4(0)
    each, before, end = N / total, -uniform, i4(N)
    for j in range(len(scales)):
        o = j * TILE
        scale = scales[j] * each
        quarters = cumulate(w[o : o + TILE], cumulative)
        for m in range(4):
            s = slice(m * QUARTER, (m + 1) * QUARTER)
            first_children(cumulative[s], scale, before, end, first[s])
            before += scale * quarters[m]
        for i in range(min(TILE, N - 1 - o)):
            parent[u4(first[i])] = i4(o + i + 1)


@inlined
def family(parent, last, x, y, z, p, q, r):
    """Positions of the parents of one tile's particles into p, q, r, and the last of the parents;
    `last`: that of the tile before.
    """
    for i in range(TILE):
        last = max(last, parent[i])
        j = u4(last)
        p[i] = x[j]
        q[i] = y[j]
        r[i] = z[j]
    return last


@kernel("void(f4[::1], f8[::1], i8, f8, i4[::1], f4[:,::1], f4[:,::1])")
def resample(w, scales, N, uniform, parent, x, children):
    """Systematic resampling of particles x (3, M), M a multiple of TILE, into children (3, M); see
    `parents`.
    """
    cumulative, first = carray(stack_f8(TILE), TILE), carray(stack_i4(TILE), TILE)
    parents(w, scales, N, uniform, parent, cumulative, first)
    last = i4(0)
    for o in range(0, len(w), TILE):
        s = slice(o, o + TILE)
        last = family(
            parent[s], last, x[0], x[1], x[2], children[0, s], children[1, s], children[2, s]
        )
