"""Errors of the machine (memory, disk, workers), reported as one clear line."""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from aoabench.errors import RunError, UserError, shorten


def report(line: str) -> None:
    """Print a line for the user on standard error."""
    print(f"aoabench: {line}", file=sys.stderr, flush=True)


@contextmanager
def explained(out: Path) -> Iterator[None]:
    """Turn an error of the machine (memory, disk, workers, Dask) into a one-line RunError."""
    from concurrent.futures import BrokenExecutor

    kept = "finished parts are kept, the same command continues from them"
    less = "fewer workers (runner.n_jobs) or smaller tasks (runner.chunk) need less memory"
    try:
        yield
    except MemoryError as error:
        raise RunError(f"out of memory ({error or 'no details'}); {less}; {kept}") from error
    except BrokenExecutor as error:
        raise RunError(
            f"a worker process was killed, perhaps because memory ran out; {less}; {kept}"
        ) from error
    except Exception as error:
        if type(error).__module__.partition(".")[0] == "distributed":
            raise RunError(
                f"the Dask cluster failed: {type(error).__name__}: {error}; {kept}"
            ) from error
        disk = (errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EACCES, errno.EPERM, errno.EIO)
        if not isinstance(error, OSError) or error.errno not in disk:
            raise
        raise RunError(
            f"{out} cannot be written any more: {os.strerror(error.errno)}; {kept}"
        ) from error


def writable(folder: str, key: str = "runner.out") -> Path:
    """Return the folder, created if needed; UserError naming `key` if it cannot be created or
    written.
    """
    try:
        path = Path(folder)
        path.mkdir(parents=True, exist_ok=True)
        probe = path / f".probe-{os.getpid()}"
        probe.touch()
        probe.unlink()
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or error
        raise UserError(
            f"{key}={shorten(repr(folder))} cannot be written: {why}; allowed: a writable folder"
        ) from None
    return path
