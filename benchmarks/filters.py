"""Speed of the filters, against NumPy and against other libraries on the same work."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from aoabench.cell import Cell
from aoabench.engine import block
from aoabench.engine.draws import Draws
from aoabench.scenarios.indoor_map import IndoorMap
from benchmarks import peers
from benchmarks.timing import MODELS, Laps, Row, both_engines, by_engine, cell_of, in_turn

PARTICLES = 10_000


def kalman(repeats: int) -> Iterator[Row]:
    """Microseconds per replication and step; against NumPy and against other libraries on the same
    work.
    """
    names = [f"{a}_{m}" for a in ("ekf", "ukf") for m in MODELS]
    cell = cell_of("noise=vmf", filters=names)
    laps = both_engines(cell, names)
    _, batch = Draws(cell.scenario, cell.noise, cell.seed).tile(0, 1)
    libraries = peers.available(cell.scenario, batch, math.radians(10), 100)
    others = {
        f"{k} {n}": lap for n, made in libraries.items() for k, lap in made.items() if k != "PF"
    }
    found = in_turn({**laps, **others}, repeats)
    T = batch.azimuth.shape[1]
    how = f"median of {repeats}, in turn; tiles of 128 replications, {T} steps, 4 anchors; one core"
    us = {name: 1e6 * found[name] / lap.steps for name, lap in laps.items()}
    us |= {name: 1e6 * found[name] / (T * lap.laps) for name, lap in others.items()}
    for name in names:
        yield Row("Kalman step", name, us[name], "us", "", how)
        yield Row("Kalman step in NumPy", name, us[f"{name} numpy"], "us", "", how)
    same = "one lap of one replication, all anchors in one update; the estimates agree with ours"
    for library, (kind, least) in itertools.product(libraries, (("EKF", 9000), ("UKF", 6000))):
        if kind not in libraries[library]:
            continue
        theirs, ours = us[f"{kind} {library}"], us[f"{kind.lower()}_ae_nominal"]
        target = f"at least {least}" if "Stone" in library else ""
        detail, medians = f"{kind}, AE-nominal", "from the two medians"
        yield Row(f"Kalman step in {library}", kind, theirs, "us", "", same)
        yield Row(f"against {library}", detail, theirs / ours, "x", target, medians)


def particle(repeats: int) -> Iterator[Row]:
    """Nanoseconds per particle and step of each particle filter, in our code and in other
    libraries.
    """
    names = [f"pf_{m}" for m in MODELS]
    cells = [cell_of(f"noise={noise}", filters=names) for noise in ("ae_flip", "vmf")]
    cell = cells[1]
    laps = both_engines(cell, names, tiles=8)
    actions: dict[str, Callable[[], Any]] = {**laps}
    actions |= {f"eight {engine}": _eight(cells, engine) for engine in ("auto", "numpy")}
    _, batch = Draws(cell.scenario, cell.noise, cell.seed).tile(0, 1)
    libraries = peers.available(cell.scenario, batch, math.radians(10), PARTICLES)
    actions |= {name: made["PF"] for name, made in libraries.items()}
    found, T = in_turn(actions, repeats), batch.azimuth.shape[1]
    steps: dict[str, int] = dict.fromkeys(found, T) | {n: lap.steps for n, lap in laps.items()}
    ns = {name: 1e9 * seconds / (steps[name] * PARTICLES) for name, seconds in found.items()}
    how = (
        f"median of {repeats}, in turn; 10 000 particles, 64 steps, "
        "4 anchors, random numbers and resampling included"
    )
    for name in names:
        yield Row("particle-step", name, ns[name], "ns", "", how)
        yield Row("particle-step in NumPy", name, ns[f"{name} numpy"], "ns", "", how)
    fast, slow = (ns[f"eight {engine}"] / 32 for engine in ("auto", "numpy"))
    shared = (
        "both data models x four filters, 4 replications of each, simulation and metrics included"
    )
    yield Row("particle-step, eight filters", "mean", fast, "ns", "", shared)
    yield Row("against NumPy, eight filters", "mean", slow / fast, "x", "at least 45", shared)
    for library in libraries:
        target = "at least 150" if "Stone" in library else ""
        times = ns[library] / ns["pf_ae_nominal"]
        yield Row(f"particle-step in {library}", "AE-nominal", ns[library], "ns", "", how)
        yield Row(f"against {library}", "PF, AE-nominal", times, "x", target, how)


def _eight(cells: list[Cell], engine: str) -> Callable[[], None]:
    """An action that simulates and filters the next four replications of each cell."""
    numbers = itertools.count()
    given = [(c, {n: by_engine(e, engine) for n, e in c.estimators.items()}) for c in cells]

    def once() -> None:
        r = 4 * next(numbers)
        for cell, estimators in given:
            block.run_block(cell.scenario, cell.noise, estimators, cell.seed, r, r + 4)

    return once


def access_nodes(repeats: int) -> Iterator[Row]:
    """Microseconds per trial and step on the indoor map, of EKFs with nine states and eight access
    nodes, and of the centroid; seconds of the line of sight along the route.
    """
    ekfs = ["ekf_toa_aoa", "ekf_aoa"]
    words = ["scenario=indoor_map", "noise=ofdm_crlb", "noise.an_sigma_m=0.5"]
    cell = cell_of(*words, filters=ekfs, estimators=["wcg"])
    laps = {name: Laps(cell, name, tiles=2) for name in (*ekfs, "wcg")}
    slow = Laps(cell, "ekf_toa_aoa", "numpy", tiles=1)
    found = in_turn({**laps, "numpy": slow}, min(repeats, 5))
    how = (
        "median, in turn; tiles of 32 trials, 3065 steps, 9 states, 8 of 107 access nodes; one core"
    )
    for name, lap in laps.items():
        target = "at most 0.5" if name == "wcg" else "at most 1"
        yield Row("access-node step", name, 1e6 * found[name] / lap.steps, "us", target, how)
    us = 1e6 * found["numpy"] / slow.steps
    yield Row("access-node step in NumPy", "ekf_toa_aoa", us, "us", "", how)
    assert isinstance(cell.scenario, IndoorMap)
    begin = time.perf_counter()
    fresh = replace(cell.scenario)
    fresh.line_of_sight(fresh.truth(np.random.default_rng(0))[:, :3])
    sight = time.perf_counter() - begin
    how = (
        "files read again, the whole route (3065 points) against all 107 access nodes and 85 walls"
    )
    yield Row("line of sight", "indoor_map", sight, "s", "at most 1", how)
