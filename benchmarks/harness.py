"""What the framework itself costs around an estimator: simulation, metrics, rows."""

from __future__ import annotations

import cProfile
import pstats
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

import aoabench
from aoabench.cell import Cell
from aoabench.engine.block import run_block
from aoabench.engine.tiles import Draws, tile_of
from aoabench.roles import Scenario
from aoabench.streams import Streams
from aoabench.types import Batch, Estimates, Outcome
from benchmarks.timing import Row, cell_of, in_turn

# overrides of a cell, and its number of replications
PLACES = {
    "square track": (["scenario=square_track", "noise=vmf"], 1024),
    "base stations": (["scenario=bs_grid", "noise=ae_normal"], 64),
    "indoor map": (["scenario=indoor_map", "noise=ofdm_crlb"], 32),
    "room": (["scenario=ble_room", "noise=ble_multipath"], 64),
}
SHOWN = 4  # functions of a profile


def nothing(batch: Batch, scenario: Scenario, streams: Streams) -> Estimates:
    """The origin for every fix, with covariance: an estimator that costs nothing."""
    shape = batch.azimuth.shape[:2]
    ok = np.full(shape, Outcome.OK, dtype=np.int8)
    return Estimates(np.zeros((*shape, 3)), np.broadcast_to(np.eye(3), (*shape, 3, 3)), None, ok)


def harness(repeats: int) -> Iterator[Row]:
    """Microseconds per replication and step of a block whose estimator costs nothing, of its
    simulation, and of a single replication; with the functions that take most of the rest.
    """
    for place, (words, reps) in PLACES.items():
        cell = cell_of(*words, own={"own": nothing})
        block = _block(cell, reps)
        found = in_turn({"all": block, "draws": _draws(cell, reps)}, min(repeats, 5))
        steps = reps * Draws(cell.scenario, cell.noise, 0).tile(0, 2)[0].shape[1]
        how = (
            f"median, in turn; {reps} replications, {steps // reps} steps, an own estimator that "
            "costs nothing; one core"
        )
        parts = {"all": f"{how}; most of it in {_most(block)}", "draws": how}
        names = {"all": "simulation, metrics, rows", "draws": "simulation alone"}
        for key, name in names.items():
            us = 1e6 * found[key] / steps
            yield Row("harness, per step", f"{place}: {name}", us, "us", "", parts[key])
    cell = cell_of(*PLACES["square track"][0], own={"own": nothing})
    small = in_turn({"two": _block(cell, 2)}, 10 * repeats)["two"]
    how = f"a block of two replications, an own estimator; median of {10 * repeats}"
    yield Row("harness, smallest block", "square track", 1e3 * small, "ms", "", how)


def _block(cell: Cell, reps: int) -> Callable[[], object]:
    return lambda: run_block(cell.scenario, cell.noise, cell.estimators, cell.seed, 0, reps)


def _draws(cell: Cell, reps: int) -> Callable[[], None]:
    size = tile_of(cell.estimators["own"], cell.scenario)

    def once() -> None:
        draws = Draws(cell.scenario, cell.noise, cell.seed)
        for first in range(0, reps, size):
            draws.tile(first, size)

    return once


def _most(action: Callable[[], object]) -> str:
    """The functions with the largest own time and their share of all, as text."""
    profile = cProfile.Profile()
    begin = time.perf_counter()
    profile.runcall(action)
    seconds = time.perf_counter() - begin
    stats = pstats.Stats(profile).stats  # type: ignore[attr-defined]
    largest = sorted(stats.items(), key=lambda item: -item[1][2])[:SHOWN]
    return ", ".join(f"{_named(*key)} {100 * of[2] / seconds:.0f} %" for key, of in largest)


def _named(file: str, line: int, function: str) -> str:
    """A function's name with its module, or with its package if it is not ours."""
    root = Path(aoabench.__file__).parent
    if Path(file).is_relative_to(root):
        return f"{Path(file).relative_to(root).with_suffix('').as_posix()}.{function}"
    name = function.removeprefix("<").removesuffix(">")
    return name.split("'")[1] if "'" in name else name
