"""What `make bench` measures. Every function gives rows; nothing is asserted here, because a shared
machine is noisy.

What is compared is run in turn, and medians are taken, so that a load of the machine meets all of
it.
"""

from __future__ import annotations

import math
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from aoabench.cell import Cell
from aoabench.config.compose import compose_cells
from aoabench.engine import block, runner
from aoabench.engine.tiles import Draws, tile_of
from aoabench.store import tables
from aoabench.store.files import read_provenance
from aoabench.streams import Streams
from aoabench.studies import study
from benchmarks import peers

MODELS = ("vmf", "ae_nominal", "ae_fitted", "ae_adaptive")
PARTICLES = 10_000


@dataclass(frozen=True)
class Row:
    """One measured number; `target` says what it should reach, `how` how it was measured."""

    what: str
    detail: str
    value: float
    unit: str
    target: str
    how: str


def in_turn(actions: dict[str, Callable[[], Any]], repeats: int) -> dict[str, float]:
    """Median seconds of each action after one call of each to warm up."""
    seconds: dict[str, list[float]] = {name: [] for name in actions}
    for turn in range(repeats + 1):
        for name, action in actions.items():
            begin = time.perf_counter()
            action()
            if turn:
                seconds[name].append(time.perf_counter() - begin)
    return {name: statistics.median(found) for name, found in seconds.items()}


def _cell(names: list[str], *words: str) -> Cell:
    return compose_cells([f"filter=[{','.join(names)}]", *words])[0]


class _Laps:
    """One estimator, called on the next tile of replications each time; only its own work is in the
    time.
    """

    def __init__(self, cell: Cell, name: str, engine: str = "auto", tiles: int = 4) -> None:
        given = cell.estimators[name]
        self.estimator = replace(given, engine=engine) if hasattr(given, "engine") else given
        self.cell, self.next = cell, 0
        size = tile_of(self.estimator, cell.scenario)
        draws = Draws(cell.scenario, cell.noise, cell.seed)
        self.batches = [draws.tile(i * size, size)[1] for i in range(tiles)]
        self.streams = [
            Streams(cell.seed, cell.scenario.name, tuple(range(i * size, (i + 1) * size)))
            for i in range(tiles)
        ]
        self.steps = size * self.batches[0].azimuth.shape[1]

    def __call__(self) -> None:
        i = self.next % len(self.batches)
        self.next += 1
        self.estimator(self.batches[i], self.cell.scenario, self.streams[i])


def kalman(repeats: int) -> Iterator[Row]:
    """Microseconds per replication and step; against NumPy and against other libraries on the same
    work.
    """
    names = [f"{a}_{m}" for a in ("ekf", "ukf") for m in MODELS]
    cell = _cell(names, "noise=vmf")
    actions: dict[str, Callable[[], Any]] = {}
    laps = {name: (_Laps(cell, name), _Laps(cell, name, "numpy")) for name in names}
    for name, (fast, slow) in laps.items():
        actions[name], actions[name + " numpy"] = fast, slow
    _, batch = Draws(cell.scenario, cell.noise, cell.seed).tile(0, 1)
    others = {
        n: f(cell.scenario, batch, math.radians(10), 100) for n, f in peers.available().items()
    }
    for library, made in others.items():
        for kind in ("EKF", "UKF"):
            actions[f"{kind} {library}"] = made[kind]
    found = in_turn(actions, repeats)
    T = batch.azimuth.shape[1]
    how = f"median of {repeats}, in turn; tiles of 128 replications, {T} steps, 4 anchors; one core"
    for name, (fast, _) in laps.items():
        us = 1e6 * found[name] / fast.steps
        slow_us = 1e6 * found[name + " numpy"] / fast.steps
        yield Row("Kalman step", name, us, "us", "", how)
        yield Row("Kalman step in NumPy", name, slow_us, "us", "", how)
    for library in others:
        for kind, least in (("EKF", 5000), ("UKF", 1500)):
            us = 1e6 * found[f"{kind} {library}"] / T
            ours = (
                1e6
                * found[f"{kind.lower()}_ae_nominal"]
                / laps[f"{kind.lower()}_ae_nominal"][0].steps
            )
            same = (
                "one lap of one replication, all anchors in one update; "
                "the estimates agree with ours"
            )
            target = f"at least {least}" if "Stone" in library else ""
            yield Row(f"Kalman step in {library}", kind, us, "us", "", same)
            yield Row(
                f"against {library}",
                f"{kind}, AE-nominal",
                us / ours,
                "x",
                target,
                "from the two medians",
            )


def particle(repeats: int) -> Iterator[Row]:
    """Nanoseconds per particle and step of each particle filter, and of the same work elsewhere."""
    names = [f"pf_{m}" for m in MODELS]
    cells = [_cell(names, f"noise={noise}") for noise in ("ae_flip", "vmf")]
    cell = cells[1]
    actions: dict[str, Callable[[], Any]] = {}
    laps = {name: (_Laps(cell, name, tiles=8), _Laps(cell, name, "numpy")) for name in names}
    for name, (fast, slow) in laps.items():
        actions[name], actions[name + " numpy"] = fast, slow
    for engine in ("auto", "numpy"):
        actions["eight " + engine] = _eight(cells, engine)
    _, batch = Draws(cell.scenario, cell.noise, cell.seed).tile(0, 1)
    others = {
        n: f(cell.scenario, batch, math.radians(10), PARTICLES)["PF"]
        for n, f in peers.available().items()
    }
    found = in_turn({**actions, **others}, repeats)
    each = 1e9 / (batch.azimuth.shape[1] * PARTICLES)
    how = (
        f"median of {repeats}, in turn; 10 000 particles, 64 steps, "
        "4 anchors, random numbers and resampling included"
    )
    for name in names:
        yield Row("particle-step", name, each * found[name], "ns", "", how)
        yield Row("particle-step in NumPy", name, each * found[name + " numpy"], "ns", "", how)
    fast_ns, slow_ns = (each * found["eight " + engine] / 32 for engine in ("auto", "numpy"))
    shared = (
        "both data models x four filters, 4 replications of each, simulation and metrics included"
    )
    yield Row("particle-step, eight filters", "mean", fast_ns, "ns", "", shared)
    yield Row("against NumPy, eight filters", "mean", slow_ns / fast_ns, "x", "at least 30", shared)
    for library in others:
        ns = each * found[library]
        target = "at least 100" if "Stone" in library else ""
        yield Row(f"particle-step in {library}", "AE-nominal", ns, "ns", "", how)
        yield Row(
            f"against {library}",
            "PF, AE-nominal",
            ns / (each * found["pf_ae_nominal"]),
            "x",
            target,
            how,
        )


def _eight(cells: list[Cell], engine: str) -> Callable[[], None]:
    numbers = iter(range(10**6))
    given = [(c, {n: replace(e, engine=engine) for n, e in c.estimators.items()}) for c in cells]

    def once() -> None:
        r = 4 * next(numbers)
        for cell, estimators in given:
            block.run_block(cell.scenario, cell.noise, estimators, cell.seed, r, r + 4)

    return once


def generality(repeats: int) -> Iterator[Row]:
    """Cost of any number of anchors and particles against a likelihood written for four anchors."""
    from aoabench.kernels import loading

    K = loading.load("kernels.particle")
    if K is None:
        return
    four = _four_anchors(K)
    rng = np.random.default_rng(0)
    M = -(-PARTICLES // K.TILE) * K.TILE
    particles = rng.standard_normal((3, M)).astype(np.float32)
    x, y, z = particles
    terms, out = rng.random((4, K.TERMS), dtype=np.float32), np.empty(M, dtype=np.float32)
    table, w = np.ones(2 * K.PAIRS, dtype=np.float32), rng.random(M, dtype=np.float32)
    children = np.empty_like(particles)
    w[PARTICLES:] = 0
    scratch = np.empty(M), np.empty(M, dtype=np.int32), np.empty(M + 1, dtype=np.float32)

    def hundred(action: Callable[..., Any], *given: Any) -> Callable[[], Any]:
        return lambda: [action(*given) for _ in range(100)]

    models = {"VMF": K.UNIT_VECTOR, "AE": K.AZEL, "AE-adaptive": K.AZEL_ADAPTIVE}
    actions = {
        "normals": hundred(K.normals, children, 1, 2, 3, 4),
        **{
            f"likelihood, {name}": hundred(K.loglik, kind, x, y, z, terms, table, out)
            for name, kind in models.items()
        },
        "resampling": hundred(K.resample, w, PARTICLES, 0.3, *scratch, particles, children),
        "four": hundred(four, x, y, z, terms, out),
    }
    ns = {
        name: 1e9 * seconds / 100 / PARTICLES for name, seconds in in_turn(actions, repeats).items()
    }
    how = (
        "a kernel alone on 10 000 particles, 4 anchors; "
        "normals are drawn once for all filters of a replication, and "
    )
    how += "resampling happens in a third (VMF) to two thirds (AE-nominal) of the steps"
    for name in list(actions)[:-1]:
        yield Row("part of a particle-step", name, ns[name], "ns", "", how)
    how = (
        "log likelihood (VMF): any number of anchors, against their loop unrolled by hand for four"
    )
    yield Row(
        "cost of generality",
        "4 anchors",
        100 * (ns["likelihood, VMF"] / ns["four"] - 1),
        "%",
        "",
        how,
    )


def _four_anchors(K: Any) -> Callable[..., None]:
    from numba import njit

    one, tiny, tile, options = K.ONE, K.TINY, K.TILE, K.OPTIONS

    @njit(forceinline=True, **options)
    def term(x, y, z, t):  # type: ignore[no-untyped-def]
        px, py, pz = x - t[0], y - t[1], z - t[2]
        inverse = one / math.sqrt(px * px + py * py + pz * pz + tiny)
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
    """What single precision does to the RMSE, in units of its Monte Carlo standard error at 1000
    replications.

    The kernel against `engine=double`, which follows it draw by draw and parent by parent, so that
    rounding is all that differs. The worse of the two data models counts, with three of the mean
    difference's own standard errors added.
    """
    reps = 200
    how = (
        "mean difference + 3 of its s.e. from double precision on the same draws and parents, "
        f"{reps} replications, in"
    )
    how += " s.e. of the RMSE at 1000; 10 000 particles, the worse data model; mean"
    with tempfile.TemporaryDirectory() as folder:
        for model in MODELS:
            name, found = f"pf_{model}", []
            for noise in ("vmf", "ae_flip"):
                cells = [
                    _cell(
                        [name],
                        f"noise={noise}",
                        f"reps={reps}",
                        f"runner.out={folder}",
                        f"filter.{name}.engine={e}",
                    )
                    for e in ("auto", "double")
                ]
                runner.run(cells, progress=False)
                frame = tables.load(Path(folder))
                frame = frame[frame["estimator"] == name].set_index("replication")
                fast, exact = (frame.loc[frame["cell"] == c.id, "rmse_3d_m"] for c in cells)
                unit, difference = exact.std() / math.sqrt(1000), fast - exact
                mean, se = abs(difference.mean()) / unit, difference.std() / math.sqrt(reps) / unit
                found.append((mean + 3 * se, f"{how} {mean:.2g} +- {se:.1g}"))
            value, says = max(found)
            yield Row("single precision", name, value, "s.e.", "at most 0.1", says)


def snapshot(repeats: int) -> Iterator[Row]:
    """Fixes per second of the snapshot estimators, start included; one fix alone; against NumPy and
    SciPy.
    """
    from scipy.optimize import least_squares

    from aoabench.maths.geometry import wrap
    from aoabench.models.azel import AzEl

    names = ["ls", "ml_arctan", "ml_atan2", "ml_kcorr"]
    cell = compose_cells(
        [
            "scenario=bs_grid",
            "noise=ae_normal",
            "noise.sigma_deg=2",
            f"estimator=[{','.join(names)}]",
        ]
    )[0]
    laps = {
        name: (_Laps(cell, name, tiles=8), _Laps(cell, name, "numpy", tiles=8)) for name in names
    }
    actions: dict[str, Callable[[], Any]] = {}
    for name, (fast, slow) in laps.items():
        actions[name], actions[name + " numpy"] = fast, slow
    truth, batch = Draws(cell.scenario, cell.noise, cell.seed).tile(0, 1)
    angles = {
        f: getattr(batch, f)[:, :1]
        for f in ("azimuth", "elevation", "azimuth_sigma", "elevation_sigma")
    }
    alone, estimator, streams = (
        replace(batch, **angles),
        cell.estimators["ml_kcorr"],
        laps["ls"][0].streams[0],
    )
    actions["alone"] = lambda: [estimator(alone, cell.scenario, streams) for _ in range(100)]
    h, anchors = AzEl(1.0), cell.scenario.known_anchors
    y = np.stack([batch.azimuth[0], batch.elevation[0]], axis=-1).reshape(truth.shape[1], -1)
    begin = replace(cell.estimators["ls"])(batch, cell.scenario, streams).position[0]

    def scipys() -> None:
        for i in range(20):
            least_squares(
                lambda x, i=i: wrap(y[i] - h.predict(x[None], anchors)[0]),
                begin[i],
                method="lm",
                xtol=1e-5,
            )

    actions["scipy"] = scipys
    found = in_turn(actions, repeats)
    how = (
        f"median of {repeats}, in turn; 1000 positions, 12 base stations, 2 deg; "
        "one core, least-squares start included"
    )
    for name, (fast, _) in laps.items():
        rate, numpy_rate = fast.steps / found[name], fast.steps / found[name + " numpy"]
        yield Row(
            "fixes per second",
            name,
            rate,
            "/s",
            "at least 300000" if name == "ml_kcorr" else "",
            how,
        )
        yield Row("fixes per second in NumPy", name, numpy_rate, "/s", "", how)
    us = {
        "ml_kcorr": 1e6 * found["ml_kcorr"] / laps["ml_kcorr"][0].steps,
        "scipy": 1e6 * found["scipy"] / 20,
    }
    yield Row(
        "one fix",
        "ml_kcorr",
        1e6 * found["alone"] / 100,
        "us",
        "at most 50",
        "a batch of one; median of 100 calls",
    )
    other = "Levenberg-Marquardt (MINPACK) on our residual, fix by fix, from the same start"
    yield Row("against SciPy", "ml_kcorr", us["scipy"] / us["ml_kcorr"], "x", "", other)


def room(repeats: int) -> Iterator[Row]:
    """Microseconds per fix of the office room's estimators, three anchors."""
    names = [
        "anchor_mean",
        "ls_lines",
        "ls_anchor_discarding",
        "vmf_ml",
        "discrepancy",
        "discrepancy_exact",
    ]
    words = ["scenario=ble_room", "noise=ble_multipath", "scenario.packets=24"]
    cell = compose_cells([*words, f"estimator=[{','.join(names)}]"])[0]
    laps = {name: _Laps(cell, name) for name in names}
    found = in_turn({**laps}, repeats)
    how = (
        f"median of {repeats}, in turn; 42 points x 24 packets, 3 anchors, "
        "the shipped noise; one core"
    )
    targets = {"discrepancy": "at most 0.8", "discrepancy_exact": "at most 18"}
    for name, lap in laps.items():
        yield Row(
            "time per fix", name, 1e6 * found[name] / lap.steps, "us", targets.get(name, ""), how
        )


def access_nodes(repeats: int) -> Iterator[Row]:
    """Microseconds per trial and step on the indoor map: EKFs with nine states at eight access
    nodes, the centroid.
    """
    names = ["ekf_toa_aoa", "ekf_aoa", "wcg"]
    cell = compose_cells(
        [
            "scenario=indoor_map",
            "noise=ofdm_crlb",
            "noise.an_sigma_m=0.5",
            "filter=[ekf_toa_aoa,ekf_aoa]",
        ]
        + ["estimator=[wcg]"]
    )[0]
    laps = {name: _Laps(cell, name, tiles=2) for name in names}
    actions: dict[str, Callable[[], Any]] = dict(laps)
    slow = _Laps(cell, "ekf_toa_aoa", "numpy", tiles=1)
    found = in_turn({**actions, "numpy": slow}, min(repeats, 5))
    begin = time.perf_counter()
    fresh = replace(cell.scenario)
    route = fresh.truth(np.random.default_rng(0))
    fresh.line_of_sight(route[:, :3])
    sight = time.perf_counter() - begin
    how = (
        "median, in turn; tiles of 8 trials, 3065 steps, 9 states, 8 of 107 access nodes; one core"
    )
    for name in names:
        target = "at most 4" if name == "ekf_toa_aoa" else ""
        yield Row("access-node step", name, 1e6 * found[name] / laps[name].steps, "us", target, how)
    yield Row(
        "access-node step in NumPy", "ekf_toa_aoa", 1e6 * found["numpy"] / slow.steps, "us", "", how
    )
    how = (
        "files read again, the whole route (3065 points) against all 107 access nodes and 85 walls"
    )
    yield Row("line of sight", "indoor_map", sight, "s", "at most 1", how)


def start(repeats: int) -> Iterator[Row]:
    """Seconds to import the package, to answer `aoabench list`, and of runs of one replication."""
    how = f"median wall time of {repeats} fresh processes"
    command = [sys.executable, "-m", "aoabench.cli"]
    yield Row(
        "start",
        "import aoabench",
        _command([sys.executable, "-c", "import aoabench"], repeats),
        "s",
        "",
        how,
    )
    yield Row(
        "start", "aoabench list", _command([*command, "list"], repeats), "s", "at most 1.5", how
    )
    with tempfile.TemporaryDirectory() as folder:
        words = ["run", "filter=[pf_vmf,ekf_vmf]", "reps=1", "runner.n_jobs=1"]
        cached = {"NUMBA_CACHE_DIR": f"{folder}/cache"}
        compile_ = _command([*command, *words, f"runner.out={folder}/first"], 1, cached)
        yield Row(
            "start",
            "run, kernels not yet compiled",
            compile_,
            "s",
            "",
            "one process, an empty cache of kernels",
        )
        fresh = [
            _command([*command, *words, f"runner.out={folder}/{i}"], 1, cached)
            for i in range(repeats)
        ]
        yield Row(
            "start",
            "run reps=1",
            statistics.median(fresh),
            "s",
            "at most 4",
            how + ", kernels cached",
        )
        again = _command([*command, *words, f"runner.out={folder}/0"], repeats, cached)
        yield Row("start", "run reps=1, all reused", again, "s", "at most 4", how)


def interrupt(repeats: int) -> Iterator[Row]:
    """Seconds from Ctrl-C to the end of a run of particle filters with two workers."""
    seconds = []
    with tempfile.TemporaryDirectory() as folder:
        for i in range(3):
            words = [
                "run",
                "filter=[pf_vmf]",
                "reps=100000",
                "runner.n_jobs=2",
                f"runner.out={folder}/{i}",
            ]
            command = [sys.executable, "-m", "aoabench.cli", *words]
            run = subprocess.Popen(
                command,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                start_new_session=True,
                preexec_fn=lambda: signal.signal(
                    signal.SIGINT, signal.SIG_DFL
                ),  # a shell's background jobs ignore it
            )
            while not list(Path(folder, str(i)).glob("parts/*/*.json")) and run.poll() is None:
                time.sleep(0.05)
            begin = time.perf_counter()
            os.killpg(run.pid, signal.SIGINT)
            run.wait()
            seconds.append(time.perf_counter() - begin)
    how = "from the signal to the end of the command; median of 3"
    yield Row("Ctrl-C", "two workers", statistics.median(seconds), "s", "at most 2", how)


def scaling(repeats: int) -> Iterator[Row]:
    """One worker process against two on the same work, in turn."""
    names = ",".join(f"pf_{m}" for m in MODELS)
    ratios = []
    with tempfile.TemporaryDirectory() as folder:
        for i in range(3):
            seconds = []
            for n_jobs in (1, 2):
                cells = compose_cells(
                    [
                        f"filter=[{names}]",
                        f"runner.n_jobs={n_jobs}",
                        f"runner.out={folder}/{i}-{n_jobs}",
                        "reps=3000",
                    ]
                )
                begin = time.perf_counter()
                runner.run(cells, progress=False)
                seconds.append(time.perf_counter() - begin)
            ratios.append(seconds[0] / seconds[1])
    how = (
        "median of 3 pairs: 3000 replications x 4 particle filters, "
        "start of the workers, tables and timing included"
    )
    yield Row(
        "two workers against one",
        "particle filters",
        statistics.median(ratios),
        "x",
        "at least 1.7",
        how,
    )


def memory(repeats: int) -> Iterator[Row]:
    """Peak memory of a whole run against the number of replications (Linux only)."""
    if not Path("/proc/self/status").exists():
        return
    runs = [("ekf_vmf", 1_000), ("ekf_vmf", 10_000), ("pf_vmf", 100), ("pf_vmf", 1_000)]
    with tempfile.TemporaryDirectory() as folder:
        for name, reps in runs:
            words = [
                "run",
                f"filter=[{name}]",
                f"reps={reps}",
                "runner.n_jobs=1",
                f"runner.out={folder}/{name}{reps}",
            ]
            script = (
                f"from aoabench.cli.main import dispatch\ndispatch({words!r})\n"
                "print('PEAK', *(line.split()[1] "
                "for line in open('/proc/self/status') if 'VmHWM' in line))"
            )
            done = subprocess.run(
                [sys.executable, "-c", script], capture_output=True, text=True, check=True
            )
            peak = int(done.stdout.rsplit("PEAK", 1)[1]) / 1024
            how = "peak resident memory of the process that does all the work"
            yield Row(
                "peak memory", f"{name}, {reps} replications", peak, "MiB", "at most 1024", how
            )


def studies(repeats: int) -> Iterator[Row]:
    """How long the committed tables took, by their own provenance."""
    for name in study.names():
        s = study.load(name)
        origins = [read_provenance(study.table_path(Path("results"), s, item)) for item in s.items]
        scales = {o.get("scale") for o in origins}
        total = sum(o.get("seconds", math.nan) for o in origins)
        how = "seconds of each item, as noted in the committed tables; two cores"
        yield Row(
            f"reproduce {name}", f"scale {'/'.join(map(str, scales))}", total / 60, "min", "", how
        )
        for item, origin in zip(s.items, origins):
            if item.name == "fig4":
                least = (
                    "at most 6" if name == "nurminen2018" and origin.get("scale") == "paper" else ""
                )
                yield Row(f"reproduce {name}", "fig4", origin["seconds"] / 60, "min", least, how)


def _command(words: list[str], repeats: int, environment: dict[str, str] | None = None) -> float:
    given = {**os.environ, **(environment or {})}
    seconds = []
    for _ in range(repeats):
        begin = time.perf_counter()
        subprocess.run(words, check=True, capture_output=True, env=given)
        seconds.append(time.perf_counter() - begin)
    return statistics.median(seconds)


ALL = (
    kalman,
    particle,
    snapshot,
    room,
    access_nodes,
    generality,
    start,
    interrupt,
    scaling,
    memory,
    studies,
    precision,
)
