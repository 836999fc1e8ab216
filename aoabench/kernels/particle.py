"""Particle filter kernels: single precision, vectorised over particles, random numbers by counter.

The kernels compute the same as `filters/particle.py`, in another order and precision:

- positions are relative to the prior's mean;
- a step goes once through the particles, in tiles of `TILE` particles, the last one padded with
  weight 0; loops over a tile have no calls and a constant length, and work on arrays on the stack,
  so that the compiler vectorises them;
- a tile's weights are relative to its largest one; sums of weights have single precision within a
  tile and double precision over tiles; cumulative weights have double precision.

`tests/theory/test_particle_kernels.py` reads the generated machine code.
"""

from __future__ import annotations

import numpy as np
from numba import carray

from aoabench.kernels.compile import inlined, kernel
from aoabench.kernels.particle_likelihood import SCRATCH, loglik_tile, stack, stack_f8, stack_i4
from aoabench.kernels.particle_resampling import family, parents
from aoabench.kernels.particle_sums import SUMS, added, report, summed
from aoabench.kernels.philox import TILE, draw, normals, turn, u8
from aoabench.kernels.single import ZERO, f4, i4, larger

__all__ = ["TILE", "draw", "lap", "normals", "turn"]


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
def flat(A):
    """The 3 x 3 matrix A as nine float32."""
    a, b, c = A[0], A[1], A[2]
    return f4(a[0]), f4(a[1]), f4(a[2]), f4(b[0]), f4(b[1]), f4(b[2]), f4(c[0]), f4(c[1]), f4(c[2])


@inlined
def aligned(M):
    """Zeros (3, M), M a multiple of 16, that begin at a multiple of 64 bytes."""
    memory = np.zeros(3 * M + 16, f4)
    skip = (-memory.ctypes.data % 64) // 4
    return memory[skip : skip + 3 * M].reshape(3, M)


@kernel(
    "void(i8, i8, f4[:,:,::1], u8, u8, u8, f8[:,:,::1], f8[:,::1], f8[:,:,::1], f8[:,::1], "
    "f4[:,:,::1], f4[::1], f8, f8[:,::1], f4[:,:,::1])"
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

    `terms` (T, B, TERMS) and `table` as for `loglik`; positions are relative to the prior's mean,
    with theta = F theta + b + root_Q n; F, root_Q (T|1, 3, 3) and b (T|1, 3). `noise` (T + 1, 3,
    M), M = N rounded up to whole tiles, holds the normals of the prior and of each step; if it is
    (1, 3, M), the kernel draws them into it. `chosen` (T, 2, N) receives, at each step that ends in
    resampling, every particle's parent and the weights by which parents were chosen; if it is (0,
    2, N), they are not stored.
    """
    M = noise.shape[2]
    T = terms.shape[0]
    particles, children = aligned(M), aligned(M)
    log_w, w, parent = np.empty(M, f4), np.empty(M, f4), np.empty(M + 1, i4)
    tiles, total = np.empty((M // TILE, SUMS)), np.empty(SUMS)
    tops, scales = np.empty(M // TILE, f4), np.empty(M // TILE)
    cumulative, first = carray(stack_f8(TILE), TILE), carray(stack_i4(TILE), TILE)
    tile, scratch = carray(stack(TILE), TILE), carray(stack(SCRATCH), SCRATCH)
    log_w[:N] = ZERO
    log_w[N:] = f4(-np.inf)
    P_, none = flat(root_P), (ZERO, ZERO, ZERO)
    shared = noise.shape[0] > 1
    if not shared:
        normals(noise[0], u8(0), replication, k0, k1)
    for o in range(0, M, TILE):
        s = slice(o, o + TILE)
        x, y, z = particles[0, s], particles[1, s], particles[2, s]
        move(x, y, z, noise[0, 0, s], noise[0, 1, s], noise[0, 2, s], P_, none, P_)
    start, resampled, c = ZERO, False, none
    for k in range(T):
        plane = k + 1
        if not shared:
            plane = 0
            normals(noise[0], u8(k + 1), replication, k0, k1)
        n, last = noise[plane], i4(0)
        shift, i = b[min(k, len(b) - 1)], min(k, len(root_Q) - 1)
        b_ = f4(shift[0]), f4(shift[1]), f4(shift[2])
        F_, L = flat(F[min(k, len(F) - 1)]), flat(root_Q[i])
        if resampled:
            particles, children = children, particles
        for o in range(0, M, TILE):
            s = slice(o, o + TILE)
            x, y, z, ls = particles[0, s], particles[1, s], particles[2, s], log_w[s]
            if resampled:
                last = family(parent[s], last, children[0], children[1], children[2], x, y, z)
            move(x, y, z, n[0, s], n[1, s], n[2, s], F_, b_, L)
            loglik_tile(kind, x, y, z, terms[k], table, start, tile, scratch)
            top = f4(-np.inf)
            for i in range(TILE):
                l = ls[i] + tile[i]
                ls[i] = l
                top = larger(top, l)
            tops[o // TILE] = top
            summed(x, y, z, ls, w[s], top, c, tiles[o // TILE])
        start = -added(tiles, tops, scales, total)
        row = out[k]
        report(total, c, row)
        c = f4(row[0]), f4(row[1]), f4(row[2])
        resampled = row[12] < resample_below * N
        if resampled:
            uniform = turn(u8(k + 1), replication, k0, k1)
            parents(w, scales, N, uniform, parent, cumulative, first)
            start = ZERO
            log_w[:N] = ZERO
            if chosen.shape[0] > 0:
                last = i4(0)
                for i in range(N):
                    last = max(last, parent[i])
                    chosen[k, 0, i] = last
                    chosen[k, 1, i] = w[i] * scales[i // TILE]
