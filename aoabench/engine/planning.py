"""Planning of a run: cells that share draws merged, and tasks for the replications to compute."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

from aoabench.cell import Cell
from aoabench.engine import tiles
from aoabench.engine.tasks import Task, kind_of
from aoabench.engine.workers import cores
from aoabench.store.keys import Origin
from aoabench.store.parts import Part, missing_ranges

_LARGEST_CHUNK = 1024  # replications per task, for an even load and bounded memory
_TASKS, _FEWEST = 16, 4  # per core: tasks of all cells together at least, and of each cell


def merged(cells: Sequence[Cell]) -> list[Cell]:
    """Merge cells of the same scenario, noise, seed and parameters into one with all their
    estimators; return the cells, largest first.
    """
    found: dict[str, Cell] = {}
    for cell in cells:
        other = found.setdefault(cell.id, cell)
        if other is not cell:
            config = dict(other.config)
            for group in ("filter", "estimator"):
                config[group] = {**(other.config[group] or {}), **(cell.config[group] or {})}
            found[cell.id] = replace(
                other,
                estimators={**other.estimators, **cell.estimators},
                config=config,
                reps=max(other.reps, cell.reps),
                swept=tuple(dict.fromkeys((*other.swept, *cell.swept))),
            )
    return sorted(found.values(), key=lambda cell: -cell.reps)


def tasks_of(
    cell: Cell,
    keys: Mapping[str, str],
    origin: Origin,
    done: Mapping[str, list[Part]],
    goal: int,
    cells: int = 1,
) -> Iterator[Task]:
    """Yield tasks of whole tiles for the missing replications of the estimators in `done` (name ->
    stored parts). The more `cells` are planned together, the fewer tasks each of them needs to keep
    all cores busy, and the fewer parts its replications are stored in.

    Estimators with the same tile size and the same gap share a task, and so its draws.
    """
    gaps: dict[tuple[int, int, int], dict[str, str]] = defaultdict(dict)
    for name, parts in done.items():
        ranges = [(part.start, part.stop) for part in parts if kind_of(cell) in part.files]
        for gap in missing_ranges(ranges, goal):
            gaps[*gap, tiles.tile_of(cell.estimators[name], cell.scenario)][name] = keys[name]
    for (start, stop, tile), names in sorted(gaps.items()):
        tasks = max(math.ceil(_TASKS / cells), _FEWEST) * cores(cell.runner.n_jobs)
        chunk = cell.runner.chunk or min(math.ceil((stop - start) / tasks), _LARGEST_CHUNK)
        chunk = math.ceil(chunk / tile) * tile
        for first in range(start - start % chunk, stop, chunk):
            yield Task(cell, names, origin, max(first, start), min(first + chunk, stop))


def spread(tasks: Sequence[Task], workers: int) -> list[Task]:
    """The tasks, those with several estimators divided until there is one for each worker.

    Each of the parts simulates the draws again, but no worker is idle.
    """
    found = list(tasks)
    while 0 < len(found) < workers:
        at = max(range(len(found)), key=lambda i: len(found[i].keys))
        names = list(found[at].keys.items())
        if len(names) == 1:
            break
        parts = (dict(names[::2]), dict(names[1::2]))
        found[at : at + 1] = [replace(found[at], keys=keys) for keys in parts]
    return found
