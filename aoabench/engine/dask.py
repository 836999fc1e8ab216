"""Tasks on a Dask cluster, whose workers may run on other machines."""

from __future__ import annotations

import importlib
import logging
import os
import platform
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from aoabench.cell import RunnerOptions
from aoabench.engine.faults import report
from aoabench.engine.machines import check_same
from aoabench.engine.tasks import Loss, Task, kind_of, numbered
from aoabench.errors import BadValue, RunError, UserError
from aoabench.roles import PlainEstimator
from aoabench.store.lock import check_held
from aoabench.store.parts import has_part

_TIMEOUT_S = 90  # for a first worker to connect, and for written parts to become visible


_CONNECT_S = 10  # for a scheduler to answer


_LOOK_S = 5  # between two looks at the number of workers


# distributed's names of the options
_SECURITY = {
    "tls_ca_file": "tls_ca_file",
    "tls_cert": "tls_client_cert",
    "tls_key": "tls_client_key",
}


@contextmanager
def cluster(options: RunnerOptions, tasks: Sequence[Task]) -> Iterator[Any]:
    """Yield joblib's backend for the Dask cluster whose scheduler listens at options.address; its
    workers import from the same path as this process.

    Raises UserError if no scheduler answers, if the files of TLS cannot be used or if the scheduler
    cannot import the modules of the tasks, and RunError if no worker connects within the timeout.
    """
    try:
        from distributed import Client
    except ImportError:
        raise UserError(
            "runner.backend=dask needs Dask; install it with pip install 'aoabench[dask]'"
        ) from None
    connect: Any = Client  # untyped
    key = f"runner.address={options.address!r}"
    secured: dict[str, Any] = {}
    if str(options.address).startswith("tls://"):
        secured = {"security": _security(options)}
    try:
        client = connect(options.address, timeout=_CONNECT_S, set_as_default=False, **secured)
    except (OSError, TimeoutError) as error:
        raise UserError(
            f"{key}: no scheduler answers at this address ({type(error).__name__})"
        ) from None
    with _quiet(), client:
        try:  # a scheduler that cannot unpickle a task loses the task
            missing = client.run_on_scheduler(_add_path, sys.path, sorted(_modules(tasks)))
        except ImportError as error:
            missing = str(error)
        if missing:
            raise UserError(f"{key}: the scheduler cannot import a module of this run: {missing}")
        client.register_plugin(_path_plugin(sys.path))
        try:
            client.wait_for_workers(1, timeout=_TIMEOUT_S)
        except TimeoutError:
            raise RunError(f"{key}: no worker has connected within {_TIMEOUT_S} s") from None
        with _watched(client):
            yield _backend()(client=client)


@contextmanager
def _watched(client: Any) -> Iterator[None]:
    """Report meanwhile whenever the last worker of the cluster has gone."""
    ended = threading.Event()
    threading.Thread(target=_watch, args=(client, ended), daemon=True).start()
    try:
        yield
    finally:
        ended.set()


def _watch(client: Any, ended: threading.Event) -> None:
    """Look at the number of workers every _LOOK_S until `ended` is set; report when it gets 0."""
    waiting = False
    while not ended.wait(_LOOK_S):
        try:
            alone = not client.nthreads()
        except BaseException:  # the connection is lost or closed, which the run itself reports
            return
        if alone and not waiting and not ended.is_set():
            report("no worker is connected to the cluster any more: waiting for one ...")
        waiting = alone


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep Dask's remarks and tracebacks off standard error: what ends a run is reported once."""

    def critical(record: logging.LogRecord) -> bool:
        return record.levelno >= logging.CRITICAL

    handlers = logging.getLogger("distributed").handlers
    for handler in handlers:
        handler.addFilter(critical)
    try:
        yield
    finally:
        for handler in handlers:
            handler.removeFilter(critical)


def _security(options: RunnerOptions) -> Any:
    """distributed's Security of an encrypted connection, from the given files, or else from Dask's
    own configuration. Raises UserError if there are none, or if they cannot be used.
    """
    from distributed.security import Security

    make: Any = Security  # untyped
    files = {name: os.path.expanduser(file) for name, file in options.tls.items() if file}
    names = ", ".join(f"runner.{name}" for name in options.tls)
    if files and "ENCRYPTED" in Path(files["tls_key"]).read_text(errors="replace"):
        raise BadValue("runner.tls_key", options.tls_key, "the file of a key without a passphrase")
    try:
        found = make(require_encryption=True, **{_SECURITY[name]: files[name] for name in files})
        context = found.get_connection_args("client").get("ssl_context")
    except (OSError, ValueError) as error:  # of ssl
        raise UserError(f"{names}: cannot be used: {error}") from None
    if context is None:
        raise UserError(
            f"runner.address={options.address!r}: an encrypted connection needs {names}, "
            "or distributed.comm.tls in Dask's own configuration"
        )
    return found


def _modules(tasks: Sequence[Task]) -> set[str]:
    """The modules of the classes that the tasks use."""
    found = set()
    for cell in (task.cell for task in tasks):
        for one in (cell.scenario, cell.noise, *cell.estimators.values()):
            inner = one.function if isinstance(one, PlainEstimator) else one
            found.add(type(inner).__module__)
    return found - {"__main__", "builtins"}


def _path_plugin(path: list[str]) -> Any:
    """A worker plug-in that adds this import path to all workers, including those that connect
    later.
    """
    from distributed import WorkerPlugin

    class SamePath(WorkerPlugin):
        name = "aoabench-path"

        def setup(self, worker: Any) -> None:
            _add_path(path, ())

    return SamePath()


def _backend() -> Any:
    """joblib's Dask backend, changed to send work to the cluster even if it has a single thread."""
    from joblib._dask import DaskDistributedBackend

    base: Any = DaskDistributedBackend

    class Backend(base):  # type: ignore[misc]
        def effective_n_jobs(self, n_jobs: int) -> int:
            return max(int(super().effective_n_jobs(n_jobs)), 2)

    return Backend


def _add_path(path: Sequence[str], modules: Sequence[str]) -> str | None:
    """Add folders to the import path and import the modules; return the error's text if one cannot
    be imported, else None.
    """
    sys.path.extend(p for p in path if p not in sys.path)
    try:
        for module in modules:
            importlib.import_module(module)
    except ImportError as error:
        return str(error)
    return None


def compute_remotely(
    number: int, task: Task, out: Path, kind: dict[str, str]
) -> tuple[int, dict[str, Loss]]:
    """Compute a task on a worker, possibly on another machine; return its number and losses.

    Raises RunError if the worker's code differs from this run's, if the worker does not see the
    folder `out`, or if the run refuses processors of another `kind` than its own and this is one.
    """
    here = platform.node()
    if task.cell.runner.other_machines == "refuse":
        check_same(kind, here)
    for name, _ in task.origin.differences():
        raise RunError(
            f"the worker on {here} has another version of {name} than this run; "
            "install the same versions of the code, the plug-ins and the libraries, and restart it"
        )
    if not (out / ".lock").exists():
        raise RunError(
            f"the worker on {here} does not see {out}: "
            "runner.out must be on a file system that all workers share"
        )
    return numbered(number, task, out)


def wait_until_seen(task: Task, out: Path) -> None:
    """Wait until the task's parts are visible here, as network file systems show new files late.

    Raises RunError after the timeout, or if the folder is gone.
    """
    deadline = time.monotonic() + _TIMEOUT_S
    while not all(
        has_part(out, key, task.start, task.stop, kind_of(task.cell)) for key in task.keys.values()
    ):
        check_held(out)
        if time.monotonic() > deadline:
            raise RunError(
                f"the files that the workers wrote do not appear in {out}: "
                "runner.out must be on a file system that all workers share"
            )
        time.sleep(0.5)
