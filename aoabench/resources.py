"""What the installation and the system offer: shipped folders, the folder that output goes to,
versions of installed libraries, locks of files.
"""

from __future__ import annotations

import errno
import functools
import os
import time
from importlib import metadata
from pathlib import Path
from typing import Any

fcntl: Any  # POSIX
try:
    import fcntl
except ImportError:
    fcntl = None
msvcrt: Any  # Windows
try:
    import msvcrt
except ImportError:
    msvcrt = None

_BYTE = 2**30  # locked on Windows: behind all text, because others cannot read a locked byte
_POLL_S = 0.1


def shipped(folder: str) -> Path:
    """Path of `configs` or `experiments`: inside the installed package, or beside it in a
    checkout.
    """
    package = Path(__file__).resolve().parent
    inside = package / folder
    return inside if inside.is_dir() else package.parent / folder


def committing() -> bool:
    """Whether COMMIT=1 stands in the environment: committed files may be replaced."""
    return os.environ.get("COMMIT") == "1"


def output_folder() -> Path:
    """`results`, whose files are committed, if `committing`; else results/draft, which git
    ignores.
    """
    return Path("results") if committing() else Path("results/draft")


@functools.cache
def printed(study: str) -> dict[str, Any]:
    """Numbers printed in a study's paper, by the ids of their claims; None for a claim without a
    number.
    """
    import yaml

    path = shipped("experiments") / study / "claims.yaml"
    entries = yaml.safe_load(path.read_text(encoding="utf-8"))["claims"]
    return {entry["id"]: entry.get("printed") for entry in entries}


@functools.cache
def version(name: str) -> str | None:
    """Version of an installed library; None if it is not installed."""
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def lock(descriptor: int, wait: bool) -> bool:
    """Lock an open file against other processes, and other openings in this one, until it is
    closed; return whether it is locked, which it always is with `wait`. POSIX locks folders, too.

    Raises OSError where the file system or the system has no locks.
    """
    if fcntl is not None:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        except BlockingIOError:
            return False
        return True
    if msvcrt is None:
        raise OSError(errno.ENOSYS, os.strerror(errno.ENOSYS))
    while not (locked := _lock_byte(descriptor)) and wait:
        time.sleep(_POLL_S)
    return locked


def _lock_byte(descriptor: int) -> bool:
    """Lock one byte of an open file as Windows does; return whether no other opening holds it."""
    position = os.lseek(descriptor, 0, os.SEEK_CUR)
    os.lseek(descriptor, _BYTE, os.SEEK_SET)
    try:
        msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
    except OSError as error:
        if error.errno not in (errno.EACCES, errno.EDEADLK):
            raise
        return False
    finally:
        os.lseek(descriptor, position, os.SEEK_SET)
    return True
