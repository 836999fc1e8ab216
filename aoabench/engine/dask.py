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
from aoabench.store.keys import code_key
from aoabench.store.parts import has_part

_PATIENCE_S = 90  # for workers to come, and for a network file system to show what they wrote


_CONNECT_S = 10  # for a scheduler to answer


@contextmanager
def cluster(address: str | None, tasks: Sequence[Task]) -> Iterator[Any]:
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
    deadline = time.monotonic() + _PATIENCE_S
    while not all(
        has_part(out, key, task.start, task.stop, kind_of(task.cell)) for key in task.keys.values()
    ):
        if time.monotonic() > deadline:
            raise RunError(
                f"what the workers wrote does not show up in {out}: "
                "they need the file system that it is on"
            )
        time.sleep(0.5)
