"""Particle filter kernels: single precision, vectorised over particles, random numbers by counter.

The kernels compute the same as `filters/particle.py`, in another order and precision:

- positions are relative to the prior's mean;
- loops run over tiles of `TILE` particles, the last one padded with weight 0; they have no calls,
  contiguous arrays and a constant length, so that the compiler vectorises them;
- sums of weights have single precision within a tile and double precision over tiles; cumulative
  weights have double precision.

`tests/theory/test_particle_kernels.py` reads the generated machine code.
"""

from __future__ import annotations

import math

import numpy as np
from numba import carray

from aoabench.kernels.compile import inlined, kernel
from aoabench.kernels.limits import ONE_PARTICLE
from aoabench.kernels.particle_likelihood import SCRATCH, loglik_tile, stack
from aoabench.kernels.philox import TILE, f8, normals, turn, u4, u8
from aoabench.kernels.single import ZERO, exponential, f4, i4, larger


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
    """Sums over one tile of the weights, of their squares and of the first moments about c.

    The weights, relative to the largest one with the logarithm `top`, go into w.
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
def weighed(x, y, z, log_w, w, top, c):
    """`weigh` for all tiles: sums of the weights, of their squares and of first moments about c."""
    S = S2 = Sx = Sy = Sz = 0.0
    for o in range(0, len(w), TILE):
        s = slice(o, o + TILE)
        a, a2, ax, ay, az = weigh(x[s], y[s], z[s], log_w[s], w[s], top, c)
        S, S2, Sx, Sy, Sz = S + a, S2 + a2, Sx + ax, Sy + ay, Sz + az
    return S, S2, Sx, Sy, Sz


@inlined
def spread(x, y, z, w, c):
    """`squares` for all tiles: sums of second moments about c: xx, xy, xz, yy, yz, zz."""
    Sxx = Sxy = Sxz = Syy = Syz = Szz = 0.0
    for o in range(0, len(w), TILE):
        s = slice(o, o + TILE)
        xx, xy, xz, yy, yz, zz = squares(x[s], y[s], z[s], w[s], c)
        Sxx, Sxy, Sxz = Sxx + xx, Sxy + xy, Sxz + xz
        Syy, Syz, Szz = Syy + yy, Syz + yz, Szz + zz
    return Sxx, Sxy, Sxz, Syy, Syz, Szz


@inlined
def first_children(cumulative, scale, offset, end, first):
    """Index of the first child of each particle i + 1, at most `end`, into `first`; the scaled
    cumulative weights begin at `offset`.
    """
    for i in range(len(cumulative)):
        first[i] = min(i4(math.ceil(cumulative[i] * scale + offset)), end)


@kernel("void(f4[::1], i8, f8, f8[::1], i4[::1], f4[::1], f4[:,::1], f4[:,::1])")
def resample(w, N, uniform, cumulative, first, parent, x, children):
    """Systematic resampling of particles x (3, M) with weights w (M,), 0 from N on, into children
    (3, M), with one `uniform` in [0, 1).

    The first child of particle i + 1 is the first point above the cumulative weight of particle i.
    If several particles have the same first child, the last of them is its parent and the others
    have no children. A running maximum over the parents of first children gives the parents of all
    children, without a branch that could be mispredicted. Numbers of parents are float32, exact up
    to 2^24. `cumulative`, `first` (M,) and `parent` (M + 1,) are scratch.
    """
    q = len(w) // 4
    c0 = c1 = c2 = c3 = 0.0  # independent sums of four quarters, which the processor overlaps
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
    "void(i8, i8, f4[:,:,::1], u8, u8, u8, f8[:,::1], f8[::1], f8[:,::1], f8[:,::1], "
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
    with theta = F theta + b + n. `noise` (T + 1, 3, M), M = N rounded up to whole tiles, holds the
    normals of the prior and of each step; if it is (1, 3, M), the kernel draws them into it.
    `chosen` (T, 2, N) receives, at each step that ends in resampling, every particle's parent and
    the weights by which parents were chosen; if it is (0, 2, N), they are not stored.
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
        S, S2, Sx, Sy, Sz = weighed(x, y, z, log_w, w, top, c)
        mx, my, mz = c[0] + Sx / S, c[1] + Sy / S, c[2] + Sz / S
        effective = S * S / S2
        c = (f4(mx), f4(my), f4(mz))
        xx, xy, xz, yy, yz, zz = spread(x, y, z, w, c)
        row = out[k]
        row[0], row[1], row[2], row[12] = mx, my, mz, effective
        if effective < ONE_PARTICLE:  # the covariance is 0
            S = math.inf
        row[3], row[7], row[11] = xx / S, yy / S, zz / S
        row[4] = row[6] = xy / S
        row[5] = row[9] = xz / S
        row[8] = row[10] = yz / S
        if effective < resample_below * N:
            uniform = turn(u8(k + 1), replication, k0, k1)
            resample(w, N, uniform, cumulative, first, parent, particles, children)
            particles, children = children, particles
            log_w[:N] = ZERO
            if chosen.shape[0] > 0:
                last = ZERO
                for i in range(N):
                    last = larger(last, parent[i])
                    chosen[k, 0, i] = last
                    chosen[k, 1, i] = w[i]
