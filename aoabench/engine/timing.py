"""Serial timings of estimators."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from aoabench.cell import Cell
from aoabench.engine.tiles import Draws, call, checked, placed, tile_of
from aoabench.roles import Estimator, Noise, Scenario

_SIMULATED = 8  # replications that fill a larger tile, as the simulation is not timed
_ENOUGH_S = 1.0
_FEW = 100  # replications; cells with fewer are timed once, others up to three times


@dataclass(frozen=True)
class Timing:
    """Median seconds of one tile, and its numbers of replications and steps."""

    seconds: float
    replications: int
    steps: int


def timed(cell: Cell, keys: Mapping[str, str]) -> dict[str, Any]:
    """Serial timings, by part key, of some of the cell's estimators."""
    if not keys:
        return {}
    estimators = {name: cell.estimators[name] for name in keys}
    repeats = 1 if cell.reps < _FEW else 3  # timing must not delay many small cells
    given = (cell.scenario, cell.noise, estimators, cell.seed, cell.reps)
    measured = time_estimators(*given, repeats)
    return {
        keys[name]: {
            "seconds_per_step": timing.seconds / (timing.replications * timing.steps),
            "seconds_per_replication": timing.seconds / timing.replications,
            "replications": timing.replications,
            "steps": timing.steps,
        }
        for name, timing in measured.items()
    }


def time_estimators(
    scenario: Scenario,
    noise: Noise,
    estimators: Mapping[str, Estimator],
    seed: int,
    reps: int,
    repeats: int = 3,
) -> dict[str, Timing]:
    """Timings of the estimators, measured one after the other, BLAS at one thread.

    After a first pass, which warms up, up to `repeats` more follow until all passes take about a
    second. The number of passes is at most the number of tiles in the `reps` replications of the
    run, so that timing costs no more than the run. A pass in which the estimator raises does not
    count; an estimator without any other pass gets no timing.
    """
    result = {}
    with threadpool_limits(1):
        draws = Draws(scenario, noise, seed)
        for name, estimator in estimators.items():
            estimator.prepare(lambda line: None)  # compiling is not the estimator's time
            size = tile_of(estimator, scenario)
            few = min(size, _SIMULATED, max(reps, 2))  # `placed` takes a single one as shared
            passes = min(1 + repeats, -(-reps // size))
            seconds: list[float] = []
            for number in range(passes):
                if sum(seconds) >= _ENOUGH_S:
                    break
                first = max(number - 1, 0) if size == 1 else 0
                seconds += _one_pass(draws, estimator, range(first, first + size), few)
            seconds = seconds[1:] or seconds
            if seconds:
                steps = draws.tile(0, few)[0].shape[1]
                result[name] = Timing(float(np.median(seconds)), size, steps)
    return result


def _one_pass(draws: Draws, estimator: Estimator, tile: range, few: int) -> list[float]:
    """Seconds that a tile takes, filled with `few` replications, in a list; empty if it raises."""
    truth, batch = draws.tile(tile.start, few)
    if few < len(tile):
        at = np.arange(len(tile)) % few
        truth, batch = truth[at], placed(batch, at)
    begin = time.perf_counter()
    try:
        checked(call(estimator, batch, draws, tuple(tile), truth), truth.shape[:2], estimator.label)
    except Exception:  # the run itself has counted this failure
        return []
    return [time.perf_counter() - begin]
