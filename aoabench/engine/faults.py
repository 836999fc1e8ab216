"""Errors of the machine (memory, disk, workers), reported as one clear line."""

from __future__ import annotations

import errno
import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from aoabench.errors import RunError, UserError, WriteError, printable, shorten

_LESS = "fewer workers (runner.n_jobs) or smaller tasks (runner.chunk) need less memory"
_FILES = "raise the limit on open files (ulimit -n) or use fewer workers (runner.n_jobs)"
_SERVER = "see whether its disk or file server answers"
_ADVICE = {
    errno.ENOSPC: "make room on the disk",
    errno.EDQUOT: "make room within your quota",
    errno.EFBIG: "raise the limit on the size of files (ulimit -f)",
    errno.EMFILE: _FILES,
    errno.ENFILE: _FILES,
    errno.ENOMEM: _LESS,
    errno.EAGAIN: _LESS,
    errno.EROFS: "use a folder that can be written",
    errno.EACCES: "see who owns it and who may read and write it",
    errno.EPERM: "see who owns it and who may read and write it",
    errno.EISDIR: "move away the folder that has the name of a file",
    errno.ENOTDIR: "move away the file that has the name of a folder",
    errno.EEXIST: "move away the file that has the name of a folder",
    errno.ENAMETOOLONG: "use a folder with a shorter name",
    errno.ENOENT: "see whether the folder was moved or deleted",
    errno.ELOOP: "see whether a link leads to itself",
    **dict.fromkeys((errno.EIO, errno.ESTALE, errno.ETIMEDOUT, errno.ENOTCONN), _SERVER),
}
_OTHER = "see whether the disk is in order"
KEPT = "finished parts are kept, the same command continues from them"


def report(line: str) -> None:
    """Print a line for the user on standard error."""
    print(f"aoabench: {printable(line)}", file=sys.stderr, flush=True)


@contextmanager
def explained(out: Path | None = None, then: str = "") -> Iterator[None]:
    """Turn an error of the machine (memory, files, workers, Dask) into a one-line RunError.

    `out` is the folder that is written or read, named if the error names no file; `then` ends the
    line. A broken pipe is passed on: its reader has gone.
    """
    try:
        yield
    except (UserError, RunError):
        raise
    except Exception as error:
        line = _line(error, out)
        if line is None or (type(error) is BrokenPipeError and error.errno == errno.EPIPE):
            raise
        raise RunError(f"{line}; {then}" if then else line) from error


def _line(error: Exception, out: Path | None) -> str | None:
    """The line about an error of the machine; None for any other exception."""
    from concurrent.futures import BrokenExecutor

    package = type(error).__module__.partition(".")[0]
    if isinstance(error, MemoryError):
        return f"out of memory ({error or 'no details'}); {_LESS}"
    if isinstance(error, BrokenExecutor):
        return f"a worker process was killed, perhaps because memory ran out; {_LESS}"
    if package == "distributed":
        return f"the Dask cluster failed: {_named(error)}"
    if isinstance(error, ConnectionError) or (isinstance(error, TimeoutError) and not error.errno):
        return f"the connection to another process or machine failed: {_named(error)}"
    if isinstance(error, OSError):
        return _about_file(error, out)
    if package == "pyarrow":
        return f"{_place(out)}a table cannot be read or written: {_first_line(error)}"
    if isinstance(error, RuntimeError) and "can't start new thread" in str(error):
        return "the system starts no more threads; fewer workers (runner.n_jobs) need fewer"
    return None


def _about_file(error: OSError, out: Path | None) -> str:
    """The line about an OSError: the file, what the system says, and what to do."""
    advice = _ADVICE.get(error.errno or 0, _OTHER)
    reason = os.strerror(error.errno) if error.errno else _first_line(error)
    if isinstance(error, WriteError):
        return f"{error.filename} cannot be written: {reason}; {advice}"
    if error.filename is not None:
        name = os.fsdecode(error.filename) if isinstance(error.filename, bytes) else error.filename
        return f"{name} cannot be read or written: {reason}; {advice}"
    text = _first_line(error)  # Arrow's, with the name of the file
    more = f" ({text})" if text not in (reason, type(error).__name__) else ""
    return f"{_place(out)}a file cannot be read or written: {reason}{more}; {advice}"


def _named(error: Exception) -> str:
    text = _first_line(error)
    return text if text == type(error).__name__ else f"{type(error).__name__}: {text}"


def _place(out: Path | None) -> str:
    return "" if out is None else f"{out}: "


def _first_line(error: Exception) -> str:
    """The first line of an exception's text, without the numbers of system errors."""
    lines = str(error).strip().splitlines()
    text = re.sub(r"\[Errno \d+\] |\. Detail: \[errno \d+\].*", "", lines[0]) if lines else ""
    return shorten(text) or type(error).__name__


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
