"""Tasks on workers: processes, threads or a Dask cluster over joblib.

A task is one block of replications of one cell; the worker writes its parts itself, so nothing
large travels back and nothing finished is lost.
"""

from __future__ import annotations

import importlib
import os
import platform
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from aoabench import montecarlo, store
from aoabench.config import Cell
from aoabench.types import RunError, UserError

_PATIENCE_S = 90  # for workers to come, and for a network file system to show what they wrote
_WAITING_TASKS = 256  # handed to a cluster ahead, for workers that come later
_CONNECT_S = 10  # for a scheduler to answer


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
    """What one estimator's exceptions and undeclared NaN cost: how many replications, and the first
    one's message.
    """

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


def kind_of(cell: Cell) -> str:
    """What a part must hold to be of use to the cell."""
    return "steps" if cell.runner.steps else "rows"


def cores(n_jobs: int) -> int:
    """Number of workers for `n_jobs`; -1: all the process may use (affinity, containers)."""
    from joblib import cpu_count

    return cpu_count() if n_jobs < 0 else n_jobs


def compute(task: Task, out: Path) -> dict[str, Loss]:
    """Compute one task and write its parts; returns what was lost by estimator. Runs in a worker.

    What somebody finished since the task was planned (a worker that outlived its killed parent) is
    not computed again.
    """
    cell = task.cell
    kind, span = kind_of(cell), (task.start, task.stop)
    missing = [name for name, key in task.keys.items() if not store.has_part(out, key, *span, kind)]
    estimators = {name: cell.estimators[name] for name in missing}
    blocks = montecarlo.run_block(
        cell.scenario, cell.noise, estimators, cell.seed, *span, cell.runner.steps
    )
    losses = {}
    for name, block in blocks.items():
        origin = store.provenance({**cell.config, "this_estimator": name})
        store.write_part(out, task.keys[name], *span, block, origin)
        if "failures" in block:
            errors = dict(
                zip(block["failures"]["replication"].tolist(), block["failures"]["error"])
            )
            losses[name] = Loss.of(
                {r: errors[r] for r in block["failures"]["replication"][block["failures"]["lost"]]}
            )
    return losses


def compute_all(
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
            # every worker opens the folder by its full name, so that its own working folder does
            # not matter
            where, codes = (
                out.resolve(),
                {task.cell.id: store.code_key(task.cell) for task in tasks},
            )
            with _cluster(options.address, tasks) as backend:
                parallel = Parallel(
                    -1,
                    backend=backend,
                    return_as="generator_unordered",
                    pre_dispatch=_WAITING_TASKS,
                    batch_size=1,
                )
                calls = (
                    (i, t, where, codes[t.cell.id]) for i, t in enumerate(tasks) if not skip(t)
                )
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
            {"initializer": _settle, "initargs": (list(sys.path), os.getpid())}
            if options.backend == "loky"
            else {}
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
            for found in parallel(
                delayed(_numbered)(i, task, out) for i, task in enumerate(tasks) if not skip(task)
            ):
                finish(*found)


def _numbered(number: int, task: Task, out: Path) -> tuple[int, dict[str, Loss]]:
    return number, compute(task, out)


@contextmanager
def _cluster(address: str | None, tasks: Sequence[Task]) -> Iterator[Any]:
    """joblib's way to the Dask cluster of that scheduler, which imports from where this process
    does.
    """
    from joblib._dask import DaskDistributedBackend

    try:
        from distributed import Client, WorkerPlugin
    except ImportError:
        raise UserError("runner.backend=dask: needs Dask; pip install 'aoabench[dask]'") from None

    class Backend(DaskDistributedBackend):
        def effective_n_jobs(self, n_jobs: int) -> int:
            return max(
                super().effective_n_jobs(n_jobs), 2
            )  # the work of a single thread would be kept here

    class SamePath(WorkerPlugin):  # a plug-in reaches workers that come later, too
        name = "aoabench-path"

        def __init__(self, path: list[str]) -> None:
            self.path = path

        def setup(self, worker: Any) -> None:
            _add_path(self.path, ())

    try:
        client = Client(address, timeout=_CONNECT_S, set_as_default=False)
    except (OSError, TimeoutError) as error:
        raise UserError(
            f"runner.address={address!r}: no scheduler answers there ({type(error).__name__})"
        ) from None
    with client:
        used = (
            o for t in tasks for o in (t.cell.scenario, t.cell.noise, *t.cell.estimators.values())
        )
        modules = {type(one).__module__ for one in used} - {"__main__"}
        try:  # a scheduler that cannot read a task loses it
            missing = client.run_on_scheduler(_add_path, sys.path, sorted(modules))
        except ImportError as error:
            missing = str(error)
        if missing:
            raise UserError(
                f"runner.address={address!r}: "
                f"the scheduler does not import what this run does: {missing}"
            )
        client.register_plugin(SamePath(sys.path))
        try:
            client.wait_for_workers(1, timeout=_PATIENCE_S)
        except TimeoutError:
            raise RunError(
                f"runner.address={address!r}: no worker has come within {_PATIENCE_S} s"
            ) from None
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
    """Compute a task on a machine that may be another one; RunError if its numbers would differ or
    not be seen here.
    """
    here = platform.node()
    if store.code_key(task.cell) != code:
        raise RunError(
            f"the worker on {here} has another version of the code, "
            "of a plug-in or of a library than this run"
        )
    if not (out / ".lock").exists():
        raise RunError(
            f"the worker on {here} does not see {out}: "
            "all workers need the file system that it is on"
        )
    return _numbered(number, task, out)


def _wait_until_seen(task: Task, out: Path) -> None:
    """Until the task's parts are visible here: network file systems take their time."""
    deadline = time.monotonic() + _PATIENCE_S
    while not all(
        store.has_part(out, key, task.start, task.stop, kind_of(task.cell))
        for key in task.keys.values()
    ):
        if time.monotonic() > deadline:
            raise RunError(
                f"what the workers wrote does not show up in {out}: "
                "they need the file system that it is on"
            )
        time.sleep(0.5)


def prepare(tasks: Sequence[Task], progress: bool) -> None:
    """Let estimators compile or load what they need here, once, before workers ask for it all at
    the same time.
    """
    said: set[str] = set()

    def say(line: str) -> None:
        if progress and line not in said:
            said.add(line)
            print(line, file=sys.stderr, flush=True)

    for estimator in {id(e): e for task in tasks for e in task.cell.estimators.values()}.values():
        if hasattr(estimator, "prepare"):
            estimator.prepare(say)


def _settle(path: list[str], parent: int) -> None:
    """In a worker process: import from where the parent does, and end when it is gone, however it
    went.
    """
    sys.path[:] = path

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(0.25)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@contextmanager
def _bar(total: int, shown: bool) -> Iterator[Any]:
    """A progress bar on standard error: replications done, rate, time left. Quiet where nobody
    watches.
    """
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn,
    )

    console = Console(stderr=True)
    columns = (
        TextColumn("replications"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeRemainingColumn(),
    )
    with Progress(
        *columns, console=console, disable=not (shown and console.is_terminal), transient=True
    ) as bar:
        line = bar.add_task("", total=total, rate="")

        def advance(n: int) -> None:
            bar.advance(line, n)
            speed = bar.tasks[0].finished_speed or bar.tasks[0].speed
            bar.update(line, rate=f"{speed:,.0f}/s" if speed else "")

        yield advance
