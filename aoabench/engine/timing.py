"""Serial timings of estimators."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from aoabench.cell import Cell
from aoabench.engine.draws import Draws, placed
from aoabench.engine.threads import one_thread
from aoabench.engine.tiles import call, checked, tile_of
from aoabench.roles import Estimator, Noise, Scenario

_SIMULATED = 8  # replications that fill a larger tile, as the simulation is not timed
_ENOUGH_S = 1.0
FEW = 100  # replications; cells with fewer are timed once, others up to three times


@dataclass(frozen=True)
class Timing:
    """Median seconds of one tile, and its numbers of replications and steps; of a recording, those
    of its first track.
    """

    seconds: float
    replications: int
    steps: int

    def columns(self) -> dict[str, Any]:
        """The columns of the timing table."""
        return {
            "seconds_per_step": self.seconds / (self.replications * self.steps),
            "seconds_per_replication": self.seconds / self.replications,
            "replications": self.replications,
            "steps": self.steps,
        }


class Timings:
    """Timings of a run's estimators, by part key; those in `known` are not measured again.

    Cells of few replications that share scenario and estimator, and so differ in noise or seed
    alone, share one measurement: timing must not delay many small cells.
    """

    def __init__(self, known: Mapping[str, Any]) -> None:
        self.known = dict(known)
        self._shared: dict[tuple[int, int], Any] = {}  # by scenario and estimator, which cells keep

    def measure(self, cell: Cell, keys: Mapping[str, str]) -> dict[str, Any]:
        """Enter and return the timings of those estimators of the cell that have none."""
        few = cell.reps < FEW
        pairs = {n: (id(cell.scenario), id(cell.estimators[n])) for n in keys}
        found = {
            keys[n]: self._shared[pair]
            for n, pair in pairs.items()
            if few and pair in self._shared and keys[n] not in self.known
        }
        rest = [n for n in keys if keys[n] not in self.known and keys[n] not in found]
        if rest:
            estimators = {name: cell.estimators[name] for name in rest}
            given = (cell.scenario, cell.noise, estimators, cell.seed, cell.reps)
            for name, timing in time_estimators(*given, 1 if few else 3).items():
                found[keys[name]] = self._shared[pairs[name]] = timing.columns()
        self.known |= found
        return found


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
    with one_thread():
        draws = Draws(scenario, noise, seed)
        for name, estimator in estimators.items():
            estimator.prepare(lambda line: None)  # compiling is not the estimator's time
            size = tile_of(estimator, scenario)
            few = min(size, _SIMULATED, max(reps, 2))  # `placed` takes a single one as shared
            passes = min(1 + repeats, -(-reps // size))
            seconds: list[float] = []
            per_step: list[float] = []
            for number in range(passes):
                if sum(seconds) >= _ENOUGH_S:
                    break
                first = max(number - 1, 0) if size == 1 else 0
                one = _one_pass(draws, estimator, range(first, first + size), few)
                seconds += one
                per_step += [value / draws.drawn(first, few).truth.shape[1] for value in one]
            if seconds:
                steps = draws.drawn(0, few).truth.shape[1]
                middle = float(np.median(per_step[1:] or per_step))
                result[name] = Timing(steps * middle, size, steps)
    return result


def _one_pass(draws: Draws, estimator: Estimator, tile: range, few: int) -> list[float]:
    """Seconds that a tile takes, filled with `few` replications, in a list; empty if it raises."""
    truth, batch = draws.tile(tile.start, few, estimator.heard_only)
    if few < len(tile):
        at = np.arange(len(tile)) % few
        truth, batch = truth[at], placed(batch, at)
    begin = time.perf_counter()
    try:
        checked(call(estimator, batch, draws, tuple(tile), truth), truth.shape[:2], estimator.label)
    except Exception:  # the run itself has counted this failure
        return []
    return [time.perf_counter() - begin]
