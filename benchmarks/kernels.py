"""The cost of generality and the error of single precision in the particle filters' kernel."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from aoabench.engine import runner
from aoabench.kernels import loading
from aoabench.store import tables
from benchmarks.filters import PARTICLES
from benchmarks.timing import MODELS, Row, cell_of, in_turn

CALLS = 100  # of a piece, as one of them takes microseconds


def generality(repeats: int) -> Iterator[Row]:
    """Time of the kernel's pieces, and the additional time of the likelihood for any number of
    anchors over one written for four anchors.
    """
    if loading.load("kernels.particle") is None:
        return
    actions = pieces()
    ns = {
        name: 1e9 * seconds / CALLS / PARTICLES
        for name, seconds in in_turn(actions, repeats).items()
    }
    how = (
        "a kernel alone on 10 000 particles, 4 anchors; "
        "normals are drawn once for all filters of a replication, and "
        "resampling happens in a third (VMF) to two thirds (AE-nominal) of the steps"
    )
    for name in list(actions)[:-1]:
        yield Row("part of a particle-step", name, ns[name], "ns", "", how)
    how = (
        "log likelihood (VMF): any number of anchors, against their loop unrolled by hand for four"
    )
    more = 100 * (ns["likelihood, VMF"] / ns["four"] - 1)
    yield Row("cost of generality", "4 anchors", more, "%", "", how)


def pieces() -> dict[str, Callable[[], Any]]:
    """The pieces of a particle-step, each called CALLS times, and last the likelihood for four
    anchors.
    """
    from aoabench.kernels import particle_likelihood, particle_resampling, philox, small

    rng = np.random.default_rng(0)
    M = -(-PARTICLES // philox.TILE) * philox.TILE
    particles = rng.standard_normal((3, M)).astype(np.float32)
    x, y, z = particles
    terms, out = (
        rng.random((4, particle_likelihood.TERMS), dtype=np.float32),
        np.empty(M, dtype=np.float32),
    )
    table, w = (
        np.ones(4 * particle_likelihood.ROWS, dtype=np.float32),
        rng.random(M, dtype=np.float32),
    )
    children = np.empty_like(particles)
    w[PARTICLES:] = 0
    scales, parent = np.ones(M // philox.TILE), np.empty(M + 1, dtype=np.int32)

    def often(action: Callable[..., Any], *given: Any) -> Callable[[], Any]:
        return lambda: [action(*given) for _ in range(CALLS)]

    models = {"VMF": small.UNIT_VECTOR, "AE": small.AZEL, "AE-adaptive": small.AZEL_ADAPTIVE}
    return {
        "normals": often(philox.normals, children, 1, 2, 3, 4),
        **{
            f"likelihood, {name}": often(
                particle_likelihood.loglik, kind, x, y, z, terms, table, out
            )
            for name, kind in models.items()
        },
        "resampling": often(
            particle_resampling.resample, w, scales, PARTICLES, 0.3, parent, particles, children
        ),
        "four": often(_four_anchors(), x, y, z, terms, out),
    }


def _four_anchors() -> Callable[..., None]:
    from numba import njit

    from aoabench.kernels.compile import OPTIONS as options
    from aoabench.kernels.particle_likelihood import TINY as tiny
    from aoabench.kernels.philox import TILE as tile
    from aoabench.kernels.single import inverse_root

    @njit(forceinline=True, **options)
    def term(x, y, z, t):  # type: ignore[no-untyped-def]
        px, py, pz = x - t[0], y - t[1], z - t[2]
        inverse = inverse_root(px * px + py * py + pz * pz + tiny)
        ex, ey, ez = t[3] - px * inverse, t[4] - py * inverse, t[5] - pz * inverse
        return t[6] * (ex * ex + ey * ey + ez * ez)

    @njit(**options)
    def four(x, y, z, terms, out):  # type: ignore[no-untyped-def]
        a, b, c, d = terms[0], terms[1], terms[2], terms[3]
        a, b = (
            (a[0], a[1], a[2], a[3], a[4], a[5], a[6]),
            (b[0], b[1], b[2], b[3], b[4], b[5], b[6]),
        )
        c, d = (
            (c[0], c[1], c[2], c[3], c[4], c[5], c[6]),
            (d[0], d[1], d[2], d[3], d[4], d[5], d[6]),
        )
        for o in range(0, len(x), tile):
            xs, ys, zs, os = x[o : o + tile], y[o : o + tile], z[o : o + tile], out[o : o + tile]
            for i in range(tile):
                p, q, r = xs[i], ys[i], zs[i]
                os[i] = -(term(p, q, r, a) + term(p, q, r, b) + term(p, q, r, c) + term(p, q, r, d))

    return four


def precision(repeats: int) -> Iterator[Row]:
    """Change of the RMSE by single precision, in units of the RMSE's Monte Carlo standard error at
    1000 replications.

    The kernel is compared with `engine=double`, which uses the kernel's draws and parents, so that
    only rounding differs. The row holds the mean difference plus three of its standard errors, for
    the worse of the two data models.
    """
    with tempfile.TemporaryDirectory() as folder:
        for model in MODELS:
            name = f"pf_{model}"
            value, how = max(_rounding(name, noise, folder) for noise in ("vmf", "ae_flip"))
            yield Row("single precision", name, value, "s.e.", "at most 0.1", how)


def _rounding(name: str, noise: str, folder: str, reps: int = 200) -> tuple[float, str]:
    """Change of a filter's RMSE by single precision on one data model, and how it was measured."""
    words = [f"noise={noise}", f"reps={reps}", f"runner.out={folder}"]
    cells = [
        cell_of(*words, f"filter.{name}.engine={engine}", filters=[name])
        for engine in ("auto", "double")
    ]
    runner.run(cells, progress=False)
    frame = tables.load(Path(folder))
    frame = frame[frame["estimator"] == name].set_index("replication")
    fast, exact = (frame.loc[frame["cell"] == c.id, "rmse_3d_m"] for c in cells)
    unit, difference = exact.std() / math.sqrt(1000), fast - exact
    mean, se = abs(difference.mean()) / unit, difference.std() / math.sqrt(reps) / unit
    how = (
        "mean difference + 3 of its s.e. from double precision on the same draws and parents, "
        f"{reps} replications, in s.e. of the RMSE at 1000; 10 000 particles, "
        f"the worse data model; mean {mean:.2g} +- {se:.1g}"
    )
    return mean + 3 * se, how
