"""Helpers of all parts: a measured row, calls in turn, and estimators on ready measurements."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

from aoabench.cell import Cell
from aoabench.config.compose import compose_cells
from aoabench.engine.tiles import Draws, tile_of
from aoabench.kernels.loading import Compiled
from aoabench.roles import Estimator
from aoabench.streams import Streams

MODELS = ("vmf", "ae_nominal", "ae_fitted", "ae_adaptive")


@dataclass(frozen=True)
class Row:
    """One measured number; `target` is the value to reach, `how` describes the measurement."""

    what: str
    detail: str
    value: float
    unit: str
    target: str
    how: str


def in_turn(actions: Mapping[str, Callable[[], Any]], repeats: int) -> dict[str, float]:
    """Median seconds of each action after one call of each to warm up."""
    seconds: dict[str, list[float]] = {name: [] for name in actions}
    for turn in range(repeats + 1):
        for name, action in actions.items():
            begin = time.perf_counter()
            action()
            if turn:
                seconds[name].append(time.perf_counter() - begin)
    return {name: statistics.median(found) for name, found in seconds.items()}


def cell_of(
    *words: str,
    filters: Sequence[str] = (),
    estimators: Sequence[str] = (),
    own: Mapping[str, Any] | None = None,
) -> Cell:
    """The cell of some overrides, filters and snapshot estimators, and own estimators by name."""
    chosen = [f"filter=[{','.join(filters)}]"] if filters else []
    chosen += [f"estimator=[{','.join(estimators)}]"] if estimators else []
    return compose_cells([*words, *chosen], extra=own)[0]


def by_engine(estimator: Estimator, engine: str) -> Estimator:
    """The estimator with another engine; unchanged if it has no choice of engines."""
    if not isinstance(estimator, Compiled):
        return estimator
    other: Any = replace(cast("Any", estimator), engine=engine)
    return cast("Estimator", other)


class Laps:
    """One estimator, called on the next tile of replications each time; the tiles are simulated
    beforehand.
    """

    def __init__(self, cell: Cell, name: str, engine: str = "auto", tiles: int = 4) -> None:
        self.estimator = by_engine(cell.estimators[name], engine)
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


def both_engines(
    cell: Cell, names: Sequence[str], tiles: int = 4, numpy_tiles: int = 4
) -> dict[str, Laps]:
    """Laps of each estimator by its kernel, NAME, and in NumPy, "NAME numpy"."""
    found = {}
    for name in names:
        found[name] = Laps(cell, name, tiles=tiles)
        found[f"{name} numpy"] = Laps(cell, name, "numpy", tiles=numpy_tiles)
    return found
