"""Tasks on a Dask cluster, whose workers may run on other machines."""

from __future__ import annotations

import importlib
import platform
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from aoabench.engine.tasks import Loss, Task, kind_of, numbered
from aoabench.errors import RunError, UserError
from aoabench.roles import PlainEstimator
from aoabench.store.keys import code_key
from aoabench.store.parts import has_part

_TIMEOUT_S = 90  # for workers to come, and for a network file system to show what they wrote


_CONNECT_S = 10  # for a scheduler to answer


@contextmanager
def cluster(address: str | None, tasks: Sequence[Task]) -> Iterator[Any]:
    """joblib's way to the Dask cluster of that scheduler, whose workers import from where this
    process does.

    Raises UserError where no scheduler answers or it cannot import what the tasks need, RunError
    where no worker comes in time.
    """
    try:
        from distributed import Client
    except ImportError:
        raise UserError("runner.backend=dask: needs Dask; pip install 'aoabench[dask]'") from None
    connect: Any = Client  # untyped
    key = f"runner.address={address!r}"
    try:
        client = connect(address, timeout=_CONNECT_S, set_as_default=False)
    except (OSError, TimeoutError) as error:
        raise UserError(f"{key}: no scheduler answers there ({type(error).__name__})") from None
    with client:
        try:  # a scheduler that cannot read a task loses it
            missing = client.run_on_scheduler(_add_path, sys.path, sorted(_modules(tasks)))
        except ImportError as error:
            missing = str(error)
        if missing:
            raise UserError(f"{key}: the scheduler does not import what this run does: {missing}")
        client.register_plugin(_path_plugin(sys.path))
        try:
            client.wait_for_workers(1, timeout=_TIMEOUT_S)
        except TimeoutError:
            raise RunError(f"{key}: no worker has come within {_TIMEOUT_S} s") from None
        yield _backend()(client=client)


def _modules(tasks: Sequence[Task]) -> set[str]:
    """The modules of the classes that the tasks use."""
    found = set()
    for cell in (task.cell for task in tasks):
        for one in (cell.scenario, cell.noise, *cell.estimators.values()):
            inner = one.function if isinstance(one, PlainEstimator) else one
            found.add(type(inner).__module__)
    return found - {"__main__", "builtins"}


def _path_plugin(path: list[str]) -> Any:
    """A plug-in that gives workers this import path, those that come later too."""
    from distributed import WorkerPlugin

    class SamePath(WorkerPlugin):
        name = "aoabench-path"

        def setup(self, worker: Any) -> None:
            _add_path(path, ())

    return SamePath()


def _backend() -> Any:
    """joblib's backend for Dask, which would keep the work of a single thread in this process."""
    from joblib._dask import DaskDistributedBackend

    base: Any = DaskDistributedBackend

    class Backend(base):  # type: ignore[misc]
        def effective_n_jobs(self, n_jobs: int) -> int:
            return max(int(super().effective_n_jobs(n_jobs)), 2)

    return Backend


def _add_path(path: Sequence[str], modules: Sequence[str]) -> str | None:
    """Import from these folders too; says what keeps the modules from being imported."""
    sys.path.extend(p for p in path if p not in sys.path)
    try:
        for module in modules:
            importlib.import_module(module)
    except ImportError as error:
        return str(error)
    return None


def compute_remotely(number: int, task: Task, out: Path, code: str) -> tuple[int, dict[str, Loss]]:
    """Compute a task on a machine that may be another one; RunError if its numbers would differ or
    not be seen here.
    """
    here = platform.node()
    if code_key(task.cell) != code:
        raise RunError(
            f"the worker on {here} has another version of the code, "
            "of a plug-in or of a library than this run"
        )
    if not (out / ".lock").exists():
        raise RunError(
            f"the worker on {here} does not see {out}: "
            "all workers need the file system that it is on"
        )
    return numbered(number, task, out)


def wait_until_seen(task: Task, out: Path) -> None:
    """Until the task's parts are visible here: network file systems take their time."""
    deadline = time.monotonic() + _TIMEOUT_S
    while not all(
        has_part(out, key, task.start, task.stop, kind_of(task.cell)) for key in task.keys.values()
    ):
        if time.monotonic() > deadline:
            raise RunError(
                f"what the workers wrote does not show up in {out}: "
                "they need the file system that it is on"
            )
        time.sleep(0.5)
