"""The lock of a run's folder, and whether the folder is still the run's own."""

from __future__ import annotations

import contextlib
import os
import platform
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from aoabench import resources
from aoabench.errors import RunError, UserError
from aoabench.store.files import never_make

LOCK = ".lock"
Identity = tuple[int, int]


@dataclass(frozen=True)
class Lock:
    """A held lock: the run's folder, the open folder (a descriptor, None where folders cannot be
    opened), and device and inode of the folder and of its lock file.
    """

    out: Path
    opened: int | None
    folder: Identity | None
    file: Identity | None

    def check(self) -> None:
        """Raise RunError if the folder was moved, deleted or replaced since it was locked, or its
        lock file was.
        """
        if _identity(self.out) == self.folder:
            if _identity(self.out / LOCK) != self.file:
                raise RunError(
                    f"{self.out / LOCK} was deleted or replaced during the run, so that another "
                    "run could start; leave this file alone and run the same command again"
                )
            return
        place = _place(self.opened)
        if place is None:
            raise RunError(
                f"{self.out} was moved, deleted or replaced by another folder during the run; "
                "move it back, or run the same command again"
            )
        if _identity(place) != self.folder:
            raise RunError(
                f"{self.out} was deleted or replaced by another folder during the run; "
                "run the same command again"
            )
        raise RunError(
            f"{self.out} was moved or replaced during the run; the run's folder is now {place}; "
            f"its finished parts stay valid: move it back, or continue with runner.out={place}"
        )


def check_held(out: Path) -> None:
    """Raise RunError if `out` is not the locked folder of a run; for the workers of a run, which
    never make this folder again.
    """
    if not (out / LOCK).is_file():
        raise RunError(f"{out} was moved, deleted or replaced during the run")
    never_make(out)


@contextlib.contextmanager
def locked(out: Path, say: Callable[[str], None]) -> Iterator[Lock]:
    """Hold the folder's lock, so that one run at a time writes into the folder; call `say` with a
    line to print if another run has to end first.

    The folder and the file .lock in it are both locked, so that deleting .lock frees nothing
    (Windows locks the file alone, and deletes or moves neither while the file is open). The
    operating system releases the locks whatever ends the process. On file systems without locks,
    overlapping runs compute some parts twice, and the tables show the cells of the run that ended
    last. Raises UserError if .lock is no file, and RunError in place of any exception that follows
    after the folder was moved or deleted.
    """
    waiting = _Waiting(out, say)
    with contextlib.ExitStack() as stack:
        while (held := _taken(out, waiting, stack)) is None:
            stack.close()
        lock, file = held
        never_make(out)
        file.truncate(0)
        file.write(f" (process {os.getpid()} on {platform.node()})\n")
        file.flush()
        try:
            yield lock
        except Exception:
            lock.check()
            raise
        file.truncate(0)


def _taken(
    out: Path, waiting: _Waiting, stack: contextlib.ExitStack
) -> tuple[Lock, IO[str]] | None:
    """Lock folder and lock file; None if one of them was deleted or replaced meanwhile."""
    opened = _opened(out)
    if opened is not None:
        stack.callback(os.close, opened)
        waiting.lock(opened, needed=False)
    try:
        file = stack.enter_context((out / LOCK).open("a+", encoding="utf-8"))
    except (IsADirectoryError, PermissionError):
        if not (out / LOCK).is_dir():
            raise
        raise UserError(
            f"{out / LOCK} is a folder; allowed: the lock file of a run; move the folder away"
        ) from None
    waiting.lock(file.fileno(), needed=True)
    lock = Lock(out, opened, _identity(out if opened is None else opened), _identity(file.fileno()))
    whole = (_identity(out), _identity(out / LOCK)) == (lock.folder, lock.file)
    return (lock, file) if whole else None


@dataclass
class _Waiting:
    """Waits for the locks of the folder `out`, and says so once."""

    out: Path
    say: Callable[[str], None]
    said: bool = False

    def lock(self, descriptor: int, needed: bool) -> None:
        """Lock an open file or folder; without `needed`, errors of the file system are ignored."""
        try:
            if not resources.lock(descriptor, wait=False):
                self._say(
                    f"another run{_holder(self.out)} is writing into {self.out}: "
                    "waiting until it has ended ..."
                )
                resources.lock(descriptor, wait=True)
        except OSError as error:
            if needed:
                self._say(
                    f"{self.out}: the file system has no locks ({error.strerror}); "
                    "do not start two runs into this folder at once"
                )

    def _say(self, line: str) -> None:
        if not self.said:
            self.said = True
            self.say(line)


def _holder(out: Path) -> str:
    """The text about the process that holds the lock; "" if it has written none."""
    with contextlib.suppress(OSError, ValueError):
        return (out / LOCK).read_text(encoding="utf-8").partition("\n")[0].rstrip()
    return ""


def _opened(folder: Path) -> int | None:
    """A descriptor of a folder; None on systems that open no folders, or without the right to."""
    try:
        return os.open(folder, os.O_RDONLY)
    except PermissionError:
        return None


def _identity(place: Path | int) -> Identity | None:
    """Device and inode of a file or folder; None if it does not exist."""
    try:
        found = os.stat(place)
    except OSError:
        return None
    return found.st_dev, found.st_ino


def _place(opened: int | None) -> Path | None:
    """Where an open folder is now, by Linux's /proc; None if that is not known."""
    with contextlib.suppress(OSError):
        return None if opened is None else Path(os.readlink(f"/proc/self/fd/{opened}"))
    return None
