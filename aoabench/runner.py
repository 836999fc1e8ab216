"""Cells to tasks over joblib: what is missing is computed, what is there is used again.

A task is one block of replications of one cell; the worker writes its parts itself, so nothing large travels back and
nothing finished is lost.
"""

from __future__ import annotations

import errno
import importlib
import math
import os
import platform
import sys
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from aoabench import montecarlo, statistics, store, tables
from aoabench.config import Cell, Until
from aoabench.types import RunError, UserError

_LARGEST_CHUNK = 1024  # replications per task, for an even load and bounded memory
_PATIENCE_S = 90  # for workers to come, and for a network file system to show what they wrote
_WAITING_TASKS = 256  # handed to a cluster ahead, for workers that come later
_CONNECT_S = 10  # for a scheduler to answer
_FEW = 100  # replications
_HOPELESS = 100  # so many replications, all of them lost, tell that the rest will be, too


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
class Loss:
    """What one estimator's exceptions and undeclared NaN cost: how many replications, and the first one's message."""

    count: int = 0
    first: int = -1
    message: str = ""

    def __add__(self, other: Loss) -> Loss:
        if not self.count or not other.count:
            return self if self.count else other
        early = min(self, other, key=lambda loss: loss.first)
        return Loss(self.count + other.count, early.first, early.message)

    @classmethod
    def of(cls, errors: Mapping[int, str]) -> Loss:
        """From messages by replication."""
        return cls(len(errors), min(errors), errors[min(errors)]) if errors else cls()


@dataclass(frozen=True)
class RunReport:
    """What a run did: estimator-replications computed and reused, wall seconds, and where the tables lie.

    `damaged`: parts that did not fit their checksums and were computed again. `precision`: where a cell ran until a
    precision was reached, what each estimator reached (as in precision.parquet).
    """

    out: Path
    computed: int
    reused: int
    seconds: float
    damaged: tuple[Path, ...] = ()
    precision: tuple[Mapping[str, Any], ...] = ()


def run(cells: Sequence[Cell], progress: bool = True) -> RunReport:
    """Compute what is missing of all cells and make the tables. The cells share one runner.out.

    Raises UserError if the output folder cannot be written, RunError for what happens on the way (a full disk, a worker
    that dies, more failures than allowed); what is finished by then is kept and in the tables as far as they can be
    made, and the same call goes on from there.
    """
    cells = merged(cells)
    out = writable(cells[0].runner.out)
    with _explained(out), store.locked(out, _tell):
        return _Run(out, cells, progress).run()


class _Run:
    """One run over cells that share an output folder, whose lock is held."""

    def __init__(self, out: Path, cells: Sequence[Cell], progress: bool) -> None:
        self.out, self.cells, self.progress = out, cells, progress
        self.options = cells[0].runner
        self.draws = {cell.id: store.draws_key(cell) for cell in cells}
        self.keys = {
            cell.id: {name: store.part_key(cell, name, self.draws[cell.id]) for name in cell.estimators}
            for cell in cells
        }
        self.losses: dict[str, Loss] = {}  # by part key
        self.there: dict[str, int] = {}  # by part key: replications computed, whichever
        self.goal: dict[str, int] = {}  # by cell: replications wanted so far
        self.stopped: dict[str, str] = {}  # by cell: why
        self.precision: dict[str, dict[str, dict[str, Any]]] = {}  # by cell and estimator
        self.damaged: list[Path] = []
        self.computed = 0

    def run(self) -> RunReport:
        """All of it."""
        begin = time.perf_counter()
        until = self.options.until
        running = list(self.cells)
        for count in until.counts if until else [None]:
            self.goal |= {cell.id: count or cell.reps for cell in running}
            self._compute_missing(running)
            running = [c for c in running if c.id not in self.stopped and until and not self._precise(c, until)]
            if not running:
                break
        reached = self._tabulate()
        if self.stopped:
            raise RunError("; ".join(self.stopped.values()))
        precision = [
            {"cell": cell, "estimator": name, **row}
            for cell, rows in self.precision.items()
            for name, row in rows.items()
        ]
        seconds = time.perf_counter() - begin
        reused = reached - self.computed
        return RunReport(self.out, self.computed, reused, seconds, tuple(self.damaged), tuple(precision))

    def _compute_missing(self, cells: Sequence[Cell]) -> None:
        """All replications up to the goals. Cells may share parts with one that was stopped: then once more."""
        while True:
            before = len(self.stopped)
            tasks = self._plan([cell for cell in cells if cell.id not in self.stopped])
            _compute(tasks, self.out, self.progress, self._note, lambda task: task.cell.id in self.stopped)
            if len(self.stopped) == before:
                return

    def _plan(self, cells: Sequence[Cell]) -> list[Task]:
        """What is missing of some cells, and what is known of the failures in what is there."""
        tasks: list[Task] = []
        claimed: set[str] = set()  # cells that differ in another estimator's parameter share parts
        for cell in cells:
            goal, done = self.goal[cell.id], {}
            for name, key in self.keys[cell.id].items():
                if key not in claimed:
                    claimed.add(key)
                    parts, damaged = store.examined(self.out, key)
                    for seal in damaged:
                        _tell(f"{seal.with_suffix('').with_suffix('')}: altered or torn; computed again")
                    self.damaged += damaged
                    self.losses[key] = Loss.of(tables.errors(parts, goal, lost=True))
                    self.there[key] = min(sum(part.stop - part.start for part in parts), goal)
                    done[name] = parts
                self._check(cell, name)
            if cell.id not in self.stopped:
                tasks += _tasks(cell, self.keys[cell.id], done, goal)
        return tasks

    def _note(self, task: Task, losses: Mapping[str, Loss]) -> None:
        """Enter what became of a task."""
        self.computed += task.size
        for name, key in task.keys.items():
            self.losses[key] += losses.get(name, Loss())
            self.there[key] += task.stop - task.start
            self._check(task.cell, name)

    def _check(self, cell: Cell, name: str) -> None:
        """Stop the cell if one estimator failed too often: more than the limit, or every one of the first hundred."""
        key, goal, most = self.keys[cell.id][name], self.goal[cell.id], self.options.max_failed
        loss, there = self.losses[key], self.there[key]
        hopeless = most < 1 and loss.count == there >= _HOPELESS
        if cell.id not in self.stopped and (loss.count > most * goal or hopeless):
            again = tables.replay_command(self.out, cell.id, name, loss.first, cell.config, cell.plugins)
            self.stopped[cell.id] = (
                f"cell {cell.id} ({cell.scenario_name}, {cell.noise_name}) stopped: {name!r} failed in {loss.count} of "
                f"{there} replications, more than runner.max_failed={most:g} of {goal}; "
                f"replication {loss.first}: {loss.message}{f' ({again})' if again else ''}"
            )

    def _precise(self, cell: Cell, until: Until) -> bool:
        """Whether the means of the cell's estimators are known well enough; one without any value does not count."""
        goal = self.goal[cell.id]
        rows: dict[str, dict[str, Any]] = {}
        for name, key in self.keys[cell.id].items():
            mean = statistics.mean(tables.values(self.out, key, until.metric, goal))
            relative = mean.se / abs(mean.value) if mean.value else math.nan
            wanted = [(mean.se, until.se), (relative, until.relative_se)]
            reached = all(limit is None or error <= limit for error, limit in wanted)
            rows[name] = {
                "metric": until.metric, "replications": goal, "mean": mean.value, "se": mean.se,
                "relative_se": relative, "wanted_se": until.se, "wanted_relative_se": until.relative_se,
                "reached": reached,
            }  # fmt: skip
        self.precision[cell.id] = rows
        return all(row["reached"] or math.isnan(row["mean"]) for row in rows.values())

    def _tabulate(self) -> int:
        """Make the tables and measure times; returns how many estimator-replications the cells show."""
        known, shown = tables.known_timing(self.out), 0
        for cell in self.cells:
            keys = self.keys[cell.id]
            reps = dict.fromkeys(keys, self.goal[cell.id])
            if cell.id in self.stopped:  # whatever is there without a gap
                reps = {name: self._prefix(cell, key) for name, key in keys.items()}
            shown += sum(reps.values())
            precision = self.precision.get(cell.id, {})
            tables.record_cell(self.out, cell, keys, self.draws[cell.id], known, reps, precision)
        tables.collect(self.out, {cell.id for cell in self.cells})
        fresh: dict[str, Any] = {}
        for cell in self.cells:
            if cell.id not in self.stopped:
                fresh |= _timed(cell, {n: key for n, key in self.keys[cell.id].items() if key not in known | fresh})
        tables.note_timing(self.out, fresh)
        return shown

    def _prefix(self, cell: Cell, key: str) -> int:
        done = [(part.start, part.stop) for part in store.intact_parts(self.out, key, _kind(cell))]
        gaps = store.missing_ranges(done, self.goal[cell.id])
        return gaps[0][0] if gaps else self.goal[cell.id]


def _kind(cell: Cell) -> str:
    """What a part must hold to be of use to the cell."""
    return "steps" if cell.runner.steps else "rows"


def _tell(line: str) -> None:
    print(f"aoabench: {line}", file=sys.stderr, flush=True)


@contextmanager
def _explained(out: Path) -> Iterator[None]:
    """Turn what the machine does to a run into one clear line."""
    from concurrent.futures import BrokenExecutor

    kept = "what was finished is kept, the same command goes on from there"
    less = "fewer workers (runner.n_jobs) or smaller tasks (runner.chunk) need less memory"
    try:
        yield
    except MemoryError as error:
        raise RunError(f"out of memory ({error or 'no more to be had'}); {less}; {kept}") from error
    except BrokenExecutor as error:
        raise RunError(f"a worker process was killed, for using too much memory perhaps; {less}; {kept}") from error
    except Exception as error:
        if type(error).__module__.partition(".")[0] == "distributed":
            raise RunError(f"the Dask cluster gave up: {type(error).__name__}: {error}; {kept}") from error
        disk = (errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EACCES, errno.EPERM, errno.EIO)
        if not isinstance(error, OSError) or error.errno not in disk:
            raise
        raise RunError(f"{out} cannot be written any more: {os.strerror(error.errno)}; {kept}") from error


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


def _tasks(cell: Cell, keys: Mapping[str, str], done: Mapping[str, list[store.Part]], goal: int) -> Iterator[Task]:
    """Blocks of whole tiles of what is missing of the estimators in `done`, whose parts are there.

    Estimators of one tile size that miss the same share a block, and so its draws.
    """
    gaps: dict[tuple[int, int, int], dict[str, str]] = defaultdict(dict)
    for name, parts in done.items():
        ranges = [(part.start, part.stop) for part in parts if _kind(cell) in part.files]
        for gap in store.missing_ranges(ranges, goal):
            gaps[*gap, montecarlo.tile_of(cell.estimators[name], cell.scenario)][name] = keys[name]
    for (start, stop, tile), names in sorted(gaps.items()):
        chunk = cell.runner.chunk or min(math.ceil((stop - start) / (16 * cores(cell.runner.n_jobs))), _LARGEST_CHUNK)
        chunk = math.ceil(chunk / tile) * tile
        for first in range(start - start % chunk, stop, chunk):
            yield Task(cell, names, max(first, start), min(first + chunk, stop))


def cores(n_jobs: int) -> int:
    """Workers that `n_jobs` stands for; -1: as many as the process may use (affinity, containers)."""
    from joblib import cpu_count

    return cpu_count() if n_jobs < 0 else n_jobs


def compute(task: Task, out: Path) -> dict[str, Loss]:
    """Compute one task and write its parts; returns what was lost by estimator. Runs in a worker.

    What somebody finished since the task was planned (a worker that outlived its killed parent) is not computed again.
    """
    cell = task.cell
    kind, span = _kind(cell), (task.start, task.stop)
    missing = [name for name, key in task.keys.items() if not store.has_part(out, key, *span, kind)]
    estimators = {name: cell.estimators[name] for name in missing}
    blocks = montecarlo.run_block(cell.scenario, cell.noise, estimators, cell.seed, *span, cell.runner.steps)
    losses = {}
    for name, block in blocks.items():
        origin = store.provenance({**cell.config, "this_estimator": name})
        store.write_part(out, task.keys[name], *span, block, origin)
        if "failures" in block:
            errors = dict(zip(block["failures"]["replication"].tolist(), block["failures"]["error"]))
            losses[name] = Loss.of({r: errors[r] for r in block["failures"]["replication"][block["failures"]["lost"]]})
    return losses


def _compute(
    tasks: Sequence[Task],
    out: Path,
    progress: bool,
    note: Callable[[Task, Mapping[str, Loss]], None],
    skip: Callable[[Task], bool],
) -> None:
    """Compute tasks, but those to skip when their turn comes, and note what became of each."""
    from joblib import Parallel, delayed

    if not tasks:
        return
    prepare(tasks, progress)
    options = tasks[0].cell.runner
    workers = min(cores(options.n_jobs), len(tasks))
    with _bar(sum(task.size for task in tasks), progress) as advance:

        def finish(number: int, losses: Mapping[str, Loss]) -> None:
            note(tasks[number], losses)
            advance(tasks[number].size)

        if options.backend == "dask":
            # every worker opens the folder by its full name, so that its own working folder does not matter
            where, codes = out.resolve(), {task.cell.id: store.code_key(task.cell) for task in tasks}
            with _cluster(options.address, tasks) as backend:
                parallel = Parallel(
                    -1, backend=backend, return_as="generator_unordered", pre_dispatch=_WAITING_TASKS, batch_size=1
                )
                calls = ((i, t, where, codes[t.cell.id]) for i, t in enumerate(tasks) if not skip(t))
                for found in parallel(delayed(_far_away)(*call) for call in calls):
                    _wait_until_seen(tasks[found[0]], out)
                    finish(*found)
            return
        if workers == 1 or options.backend == "sequential":
            for i, task in enumerate(tasks):
                if not skip(task):
                    finish(*_numbered(i, task, out))
            return
        # threads share one BLAS: limit it here, once, not in each block
        limit = threadpool_limits(1) if options.backend == "threading" else nullcontext()
        settle = (
            {"initializer": _settle, "initargs": (list(sys.path), os.getpid())} if options.backend == "loky" else {}
        )
        parallel = Parallel(
            workers,
            backend=options.backend,
            return_as="generator_unordered",
            pre_dispatch="2*n_jobs",
            max_nbytes=None,  # no arrays by way of pickles on disk
            **settle,
        )
        with limit:
            for found in parallel(delayed(_numbered)(i, task, out) for i, task in enumerate(tasks) if not skip(task)):
                finish(*found)


def _numbered(number: int, task: Task, out: Path) -> tuple[int, dict[str, Loss]]:
    return number, compute(task, out)


@contextmanager
def _cluster(address: str | None, tasks: Sequence[Task]) -> Iterator[Any]:
    """joblib's way to the Dask cluster of that scheduler, which imports from where this process does."""
    from joblib._dask import DaskDistributedBackend

    try:
        from distributed import Client, WorkerPlugin
    except ImportError:
        raise UserError("runner.backend=dask: needs Dask; pip install 'aoabench[dask]'") from None

    class Backend(DaskDistributedBackend):
        def effective_n_jobs(self, n_jobs: int) -> int:
            return max(super().effective_n_jobs(n_jobs), 2)  # the work of a single thread would be kept here

    class SamePath(WorkerPlugin):  # a plug-in reaches workers that come later, too
        name = "aoabench-path"

        def __init__(self, path: list[str]) -> None:
            self.path = path

        def setup(self, worker: Any) -> None:
            _add_path(self.path, ())

    try:
        client = Client(address, timeout=_CONNECT_S, set_as_default=False)
    except (OSError, TimeoutError) as error:
        raise UserError(f"runner.address={address!r}: no scheduler answers there ({type(error).__name__})") from None
    with client:
        used = (o for t in tasks for o in (t.cell.scenario, t.cell.noise, *t.cell.estimators.values()))
        modules = {type(one).__module__ for one in used} - {"__main__"}
        try:  # a scheduler that cannot read a task loses it
            missing = client.run_on_scheduler(_add_path, sys.path, sorted(modules))
        except ImportError as error:
            missing = str(error)
        if missing:
            raise UserError(f"runner.address={address!r}: the scheduler does not import what this run does: {missing}")
        client.register_plugin(SamePath(sys.path))
        try:
            client.wait_for_workers(1, timeout=_PATIENCE_S)
        except TimeoutError:
            raise RunError(f"runner.address={address!r}: no worker has come within {_PATIENCE_S} s") from None
        yield Backend(client=client)


def _add_path(path: Sequence[str], modules: Sequence[str]) -> str | None:
    """Import from these folders too; says what keeps the modules from being imported."""
    sys.path.extend(p for p in path if p not in sys.path)
    try:
        for module in modules:
            importlib.import_module(module)
    except ImportError as error:
        return str(error)
    return None


def _far_away(number: int, task: Task, out: Path, code: str) -> tuple[int, dict[str, Loss]]:
    """Compute a task on a machine that may be another one; RunError if its numbers would differ or not be seen here."""
    here = platform.node()
    if store.code_key(task.cell) != code:
        raise RunError(
            f"the worker on {here} has another version of the code, of a plug-in or of a library than this run"
        )
    if not (out / ".lock").exists():
        raise RunError(f"the worker on {here} does not see {out}: all workers need the file system that it is on")
    return _numbered(number, task, out)


def _wait_until_seen(task: Task, out: Path) -> None:
    """Until the task's parts are visible here: network file systems take their time."""
    deadline = time.monotonic() + _PATIENCE_S
    while not all(store.has_part(out, key, task.start, task.stop, _kind(task.cell)) for key in task.keys.values()):
        if time.monotonic() > deadline:
            raise RunError(f"what the workers wrote does not show up in {out}: they need the file system that it is on")
        time.sleep(0.5)


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


def _settle(path: list[str], parent: int) -> None:
    """In a worker process: import from where the parent does, and end when it is gone, however it went."""
    sys.path[:] = path

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(0.25)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


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
    repeats = 1 if cell.reps < _FEW else 3  # of many small cells nobody wants to wait for the timing
    measured = montecarlo.time_estimators(cell.scenario, cell.noise, estimators, cell.seed, repeats)
    return {
        keys[name]: {
            "seconds_per_step": seconds / (replications * steps),
            "seconds_per_replication": seconds / replications,
            "replications": replications,
            "steps": steps,
        }
        for name, (seconds, replications, steps) in measured.items()
    }
