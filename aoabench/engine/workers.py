"""Tasks on workers: processes, threads or a Dask cluster over joblib."""

from __future__ import annotations

import os
import sys
import threading
import time
import warnings
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, nullcontext
from pathlib import Path
from typing import Any

from aoabench.cell import RunnerOptions
from aoabench.engine.dask import cluster, compute_remotely, wait_until_seen
from aoabench.engine.tasks import Loss, Task, numbered
from aoabench.engine.threads import one_thread
from aoabench.kernels.loading import together
from aoabench.store.machine import machine

_WAITING_TASKS = 256  # queued on a cluster, for workers that connect later


_running: set[str] = set()  # backends whose workers this process has started


def idle(options: RunnerOptions) -> int:
    """Number of workers that a run with these options finds started; they wait for tasks for some
    minutes after a run.
    """
    return cores(options.n_jobs) if options.backend in _running else 0


def cores(n_jobs: int) -> int:
    """Number of workers for `n_jobs`; -1: all the process may use (affinity, containers)."""
    from joblib import cpu_count

    return cpu_count() if n_jobs < 0 else n_jobs


def compute_all(
    tasks: Sequence[Task],
    out: Path,
    progress: bool | str,
    note: Callable[[Task, Mapping[str, Loss]], None],
    skip: Callable[[Task], bool],
) -> None:
    """Compute the tasks, except those that `skip` selects when their turn comes, and pass each task
    with its losses to `note`.
    """
    if not tasks:
        return
    prepare(tasks, progress)
    options = tasks[0].cell.runner
    wanted = ((i, task) for i, task in enumerate(tasks) if not skip(task))
    if options.backend == "dask":
        results = _on_a_cluster(tasks, wanted, out)
    elif options.backend == "sequential" or min(cores(options.n_jobs), len(tasks)) == 1:
        results = (numbered(i, task, out) for i, task in wanted)
    else:
        results = _on_this_machine(tasks, wanted, out)
    with closing(results), _bar(sum(task.size for task in tasks), progress) as advance:
        for number, losses in results:
            note(tasks[number], losses)
            advance(tasks[number].size)


Numbered = tuple[int, Task]
Results = Generator[tuple[int, dict[str, Loss]], None, None]


def _on_this_machine(tasks: Sequence[Task], wanted: Iterable[Numbered], out: Path) -> Results:
    """The results of tasks on processes or threads, in the order in which they are done."""
    from joblib import Parallel, delayed

    options = tasks[0].cell.runner
    _running.add(options.backend)
    own: dict[str, Any] = {}
    if options.backend == "loky":
        own = {"initializer": _start_worker, "initargs": (list(sys.path), os.getpid())}
    parallel = Parallel(
        min(cores(options.n_jobs), len(tasks)),
        backend=options.backend,
        return_as="generator_unordered",
        pre_dispatch="2*n_jobs",
        max_nbytes=None,  # no memory-mapped copies of arrays on disk
        **own,
    )
    # threads share one BLAS: limit it here, once, not in each block
    with one_thread() if options.backend == "threading" else nullcontext():
        yield from _results(parallel(delayed(numbered)(i, task, out) for i, task in wanted))


def _results(found: Results) -> Results:
    """joblib's results, without its warning that some are not used after an exception."""
    try:
        for one in found:  # noqa: UP028 - `yield from` would close `found` before the context below
            yield one
    finally:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            found.close()


def _on_a_cluster(tasks: Sequence[Task], wanted: Iterable[Numbered], out: Path) -> Results:
    """The results of tasks on a Dask cluster, once their parts are visible here."""
    from joblib import Parallel, delayed

    # workers open the folder by its full name: their own working folder does not matter
    where = out.resolve()
    with cluster(tasks[0].cell.runner, tasks) as backend:
        parallel = Parallel(
            -1,
            backend=backend,
            return_as="generator_unordered",
            pre_dispatch=_WAITING_TASKS,
            batch_size=1,
        )
        calls = ((i, task, where, machine()) for i, task in wanted)
        for number, losses in _results(parallel(delayed(compute_remotely)(*c) for c in calls)):
            wait_until_seen(tasks[number], out)
            yield number, losses


def prepare(tasks: Sequence[Task], progress: bool | str) -> None:
    """Let estimators compile or load their data once in this process, before all workers need it at
    the same time.
    """
    printed: set[str] = set()

    def say(line: str) -> None:
        if progress and line not in printed:
            printed.add(line)
            print(line, file=sys.stderr, flush=True)

    estimators = {id(e): e for task in tasks for e in task.cell.estimators.values()}
    with together(say):
        for estimator in estimators.values():
            estimator.prepare(say)


def _start_worker(path: list[str], parent: int) -> None:
    """Set up a worker process: import from the parent's path, and exit once the parent ends."""
    sys.path[:] = path

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(0.25)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@contextmanager
def _bar(total: int, shown: bool | str) -> Iterator[Any]:
    """A progress bar on standard error with the text `shown`, replications done, rate and time
    left; hidden unless standard error is a terminal.
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
    # FORCE_COLOR makes rich take any file for a terminal
    if not (shown and console.is_terminal and sys.stderr.isatty()):
        yield lambda n: None
        return
    columns = (
        TextColumn(shown if isinstance(shown, str) else "replications"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, transient=True) as bar:
        line = bar.add_task("", total=total, rate="")

        def advance(n: int) -> None:
            bar.advance(line, n)
            speed = bar.tasks[0].finished_speed or bar.tasks[0].speed
            bar.update(line, rate=f"{speed:,.0f}/s" if speed else "")

        yield advance
