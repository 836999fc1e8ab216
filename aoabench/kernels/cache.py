"""The folders that keep compiled kernels: one for each state of the source of a module of kernels.

numba compares the time stamp of the file that defines a kernel, but not those of the files that it
imports. Therefore the folder's name holds a hash of all these files: any change gives a new folder,
and kernels of other versions are never loaded. Old folders stay; they can be deleted safely.
"""

from __future__ import annotations

import ast
import hashlib
import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import NamedTuple

from aoabench.resources import lock
from aoabench.types import Outcome, Reason


class Kept(NamedTuple):
    """The folder of compiled kernels, None if no folder can be written, and the usual folder if it
    cannot be written.
    """

    folder: Path | None
    refused: Path | None = None


def kept(stated: str, module: str) -> Kept:
    """Return the folder of the compiled kernels of a module, which is created if it is missing.

    It lies below `stated` (NUMBA_CACHE_DIR), or below the user's cache folder if `stated` is empty.
    If that folder cannot be written, it lies below the folder for temporary files.
    """
    wanted = Path(stated) if stated else _user_cache()
    inner = f"{module.rpartition('.')[2]}-{source_digest(module)}"
    if found := _written(wanted / "aoabench" / inner):
        return Kept(found)
    own = Path(tempfile.gettempdir()) / f"aoabench-{_user_id()}"
    found = _written(own / inner) if _private(own) else None
    return Kept(found, wanted)


def source_digest(module: str) -> str:
    """Hash of outcomes, reasons, a module of aoabench.kernels and all files of this folder and of
    aoabench.maths that it imports, directly or not; it identifies machine code.
    """
    numbers = repr([(o.name, o.value) for o in (*Outcome, *Reason)])
    read = hashlib.blake2b(numbers.encode(), digest_size=10)
    todo, found = [Path(__file__).with_name(f"{module.rpartition('.')[2]}.py")], set[Path]()
    while todo:
        file = todo.pop()
        if file not in found:
            found.add(file)
            todo += _imported(file, file.stat().st_mtime_ns)
    for file in sorted(found):
        text = file.read_bytes()
        read.update(f"{file.name} {len(text)}\n".encode())
        read.update(text)
    return read.hexdigest()


@cache
def _imported(file: Path, _changed: int) -> list[Path]:
    """The files of kernels and maths whose names stand in a file's imports."""
    names = set[str]()
    for node in ast.walk(ast.parse(file.read_bytes())):
        if isinstance(node, ast.Import | ast.ImportFrom):
            inside = (node.module or "") if isinstance(node, ast.ImportFrom) else ""
            for dotted in (inside, *(alias.name for alias in node.names)):
                names |= set(dotted.split("."))
    package = file.parents[1]
    places = [package / room / f"{name}.py" for room in ("kernels", "maths") for name in names]
    return [place for place in places if place.exists()]


@contextmanager
def alone(folder: Path | None, kernel: str) -> Iterator[None]:
    """Compile a kernel in this context while other processes that need it wait, and note in the
    folder that it was compiled. Where files cannot be locked, several may compile it.
    """
    if folder is None:
        yield
        return
    with (folder / f"{kernel}.lock").open("a", encoding="ascii") as file:
        with suppress(OSError):
            lock(file.fileno(), wait=True)
        yield
        if not file.tell():
            file.write("compiled")


def noted(folder: Path | None, kernel: str) -> bool:
    """Whether `alone` noted in the folder that a kernel was compiled."""
    with suppress(OSError):
        return folder is not None and (folder / f"{kernel}.lock").stat().st_size > 0
    return False


def _user_cache() -> Path:
    """The folder for caches by the platform's convention."""
    stated = os.environ.get("LOCALAPPDATA" if sys.platform == "win32" else "XDG_CACHE_HOME", "")
    if os.path.isabs(stated):
        return Path(stated)
    below = {"darwin": "Library/Caches", "win32": "AppData/Local"}.get(sys.platform, ".cache")
    return Path(os.path.expanduser("~")) / below


def _written(folder: Path) -> Path | None:
    """`folder`, created if it is missing; None if no file can be written into it."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except OSError:
        return None


def _private(folder: Path) -> bool:
    """Whether `folder`, created if it is missing, is a folder that only this user can write.

    Any user can create folders among the temporary files, and the cached machine code is executed.
    """
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        status = folder.lstat()
    except OSError:
        return False
    own = sys.platform == "win32" or (status.st_uid == _user_id() and not status.st_mode & 0o022)
    return own and folder.is_dir() and not folder.is_symlink()


def _user_id() -> int:
    return 0 if sys.platform == "win32" else os.getuid()
