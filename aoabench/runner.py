"""Cells to tasks over joblib: what is missing is computed, what is there is used again.

A task is one block of replications of one cell; the worker writes its parts itself, so nothing large travels back and
nothing finished is lost.
"""

from __future__ import annotations

import math
import os
import sys
import time
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from aoabench import montecarlo, store, tables
from aoabench.config import Cell
from aoabench.types import UserError

_LARGEST_CHUNK = 1024  # replications per task, for an even load and bounded memory


@dataclass(frozen=True)
class Task:
    """Replications start..stop-1 of one cell for some of its estimators (name -> part key)."""

    cell: Cell
    keys: Mapping[str, str]
    start: int
    stop: int

    @property
    def size(self) -> int:
        """Replications times estimators."""
        return (self.stop - self.start) * len(self.keys)


@dataclass(frozen=True)
class RunReport:
    """What a run did: estimator-replications computed and reused, wall seconds, and where the tables lie."""

    out: Path
    computed: int
    reused: int
    seconds: float


def run(cells: Sequence[Cell], progress: bool = True) -> RunReport:
    """Compute what is missing of all cells and make the tables. The cells share one runner.out.

    Raises UserError if the output folder cannot be written.
    """
    begin = time.perf_counter()
    cells = merged(cells)
    out = writable(cells[0].runner.out)
    keys = {cell.id: {name: store.part_key(cell, name) for name in cell.estimators} for cell in cells}
    claimed: set[str] = set()  # cells that differ in another estimator's parameter share parts
    tasks = [task for cell in cells for task in _tasks(cell, keys[cell.id], out, claimed)]
    wanted = sum(cell.reps * len(cell.estimators) for cell in cells)
    computed = sum(task.size for task in tasks)
    _compute(tasks, out, progress)
    with store.locked(out):
        known = tables.known_timing(out)
        for cell in cells:
            tables.record_cell(out, cell, keys[cell.id], store.draws_key(cell), known)
        tables.collect(out, {cell.id for cell in cells})
    fresh: dict[str, Any] = {}
    for cell in cells:
        fresh |= _timed(cell, {name: key for name, key in keys[cell.id].items() if key not in known | fresh})
    with store.locked(out):
        tables.note_timing(out, fresh)
    return RunReport(out, computed, wanted - computed, time.perf_counter() - begin)


def merged(cells: Sequence[Cell]) -> list[Cell]:
    """Cells that are the same scenario, noise, seed and parameters as one, with all their estimators; largest first."""
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


def writable(folder: str, key: str = "runner.out") -> Path:
    """The folder, made if need be; UserError naming `key` if that, or writing into it, is not possible."""
    try:
        path = Path(folder).expanduser()
        path.mkdir(parents=True, exist_ok=True)
        probe = path / f".probe-{os.getpid()}"
        probe.touch()
        probe.unlink()
    except (OSError, ValueError, RuntimeError) as error:
        why = getattr(error, "strerror", None) or error
        raise UserError(f"{key}={folder!r} cannot be written: {why}; allowed: a writable folder") from None
    return path


def _tasks(cell: Cell, keys: Mapping[str, str], out: Path, claimed: set[str]) -> Iterator[Task]:
    """Blocks of whole tiles; estimators of one tile size that miss the same share a block, and so its draws."""
    gaps: dict[tuple[int, int, int], dict[str, str]] = defaultdict(dict)
    kind = "steps" if cell.runner.steps else "rows"
    for name, key in keys.items():
        if key in claimed:
            continue
        claimed.add(key)
        done = [(part.start, part.stop) for part in store.intact_parts(out, key, kind)]
        for gap in store.missing_ranges(done, cell.reps):
            gaps[*gap, montecarlo.tile_of(cell.estimators[name], cell.scenario)][name] = key
    for (start, stop, tile), names in sorted(gaps.items()):
        chunk = cell.runner.chunk or min(math.ceil((stop - start) / (16 * cores(cell.runner.n_jobs))), _LARGEST_CHUNK)
        chunk = math.ceil(chunk / tile) * tile
        for first in range(start - start % chunk, stop, chunk):
            yield Task(cell, names, max(first, start), min(first + chunk, stop))


def cores(n_jobs: int) -> int:
    """Workers that `n_jobs` stands for; -1: as many as the process may use (affinity, containers)."""
    from joblib import cpu_count

    return cpu_count() if n_jobs < 0 else n_jobs


def compute(task: Task, out: Path) -> int:
    """Compute one task and write its parts; returns its size. Runs in a worker."""
    cell = task.cell
    estimators = {name: cell.estimators[name] for name in task.keys}
    steps = cell.runner.steps
    blocks = montecarlo.run_block(cell.scenario, cell.noise, estimators, cell.seed, task.start, task.stop, steps)
    for name, block in blocks.items():
        origin = store.provenance({**cell.config, "this_estimator": name})
        store.write_part(out, task.keys[name], task.start, task.stop, block, origin)
    return task.size


def _compute(tasks: Sequence[Task], out: Path, progress: bool) -> None:
    from joblib import Parallel, delayed

    if not tasks:
        return
    prepare(tasks, progress)
    options = tasks[0].cell.runner
    workers = min(cores(options.n_jobs), len(tasks))
    with _bar(sum(task.size for task in tasks), progress) as advance:
        if workers == 1 or options.backend == "sequential":
            for task in tasks:
                advance(compute(task, out))
            return
        # threads share one BLAS: limit it here, once, not in each block
        limit = threadpool_limits(1) if options.backend == "threading" else nullcontext()
        paths = {"initializer": _find_plugins, "initargs": (list(sys.path),)} if options.backend == "loky" else {}
        parallel = Parallel(
            workers, backend=options.backend, return_as="generator_unordered", pre_dispatch="2*n_jobs", **paths
        )
        with limit:
            for size in parallel(delayed(compute)(task, out) for task in tasks):
                advance(size)


def prepare(tasks: Sequence[Task], progress: bool) -> None:
    """Let estimators compile or load what they need here, once, before workers ask for it all at the same time."""
    said: set[str] = set()

    def say(line: str) -> None:
        if progress and line not in said:
            said.add(line)
            print(line, file=sys.stderr, flush=True)

    for estimator in {id(e): e for task in tasks for e in task.cell.estimators.values()}.values():
        if hasattr(estimator, "prepare"):
            estimator.prepare(say)


def _find_plugins(path: list[str]) -> None:
    """In a worker: import from where the parent does."""
    sys.path[:] = path


@contextmanager
def _bar(total: int, shown: bool) -> Iterator[Any]:
    """A progress bar on standard error: replications done, rate, time left. Quiet where nobody watches."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    columns = (
        TextColumn("replications"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, disable=not (shown and console.is_terminal), transient=True) as bar:
        line = bar.add_task("", total=total, rate="")

        def advance(n: int) -> None:
            bar.advance(line, n)
            speed = bar.tasks[0].finished_speed or bar.tasks[0].speed
            bar.update(line, rate=f"{speed:,.0f}/s" if speed else "")

        yield advance


def _timed(cell: Cell, keys: Mapping[str, str]) -> dict[str, Any]:
    """Serial timings, by part key, of some of the cell's estimators."""
    if not keys:
        return {}
    estimators = {name: cell.estimators[name] for name in keys}
    measured = montecarlo.time_estimators(cell.scenario, cell.noise, estimators, cell.seed)
    return {
        keys[name]: {
            "seconds_per_step": seconds / (replications * steps),
            "seconds_per_replication": seconds / replications,
            "replications": replications,
            "steps": steps,
        }
        for name, (seconds, replications, steps) in measured.items()
    }
