"""The folder that keeps compiled kernels: one for each state of the kernels' source.

numba compares the time stamp of the file that defines a kernel, but not those of the files that it
imports. Therefore the folder's name is a hash of all these files: any change gives a new folder,
and kernels of other versions are never loaded. Old folders stay; they can be deleted safely.
"""

from __future__ import annotations

import hashlib
import os
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

from aoabench.types import Outcome, Reason


class Kept(NamedTuple):
    """The folder of compiled kernels, None if no folder can be written, and the usual folder if it
    cannot be written.
    """

    folder: Path | None
    refused: Path | None = None


def kept(stated: str = "") -> Kept:
    """Return the folder of compiled kernels, which is created if it is missing.

    It lies below `stated` (NUMBA_CACHE_DIR), or below the user's cache folder if `stated` is empty.
    If that folder cannot be written, it lies below the folder for temporary files.
    """
    wanted = Path(stated) if stated else _user_cache()
    if found := _written(wanted / "aoabench" / source_digest()):
        return Kept(found)
    own = Path(tempfile.gettempdir()) / f"aoabench-{_user_id()}"
    found = _written(own / source_digest()) if _private(own) else None
    return Kept(found, wanted)


def source_digest() -> str:
    """Hash of outcomes, reasons and the files of aoabench.kernels; it identifies machine code."""
    numbers = repr([(o.name, o.value) for o in (*Outcome, *Reason)])
    read = hashlib.blake2b(numbers.encode(), digest_size=10)
    for file in sorted(Path(__file__).parent.glob("*.py")):
        text = file.read_bytes()
        read.update(f"{file.name} {len(text)}\n".encode())
        read.update(text)
    return read.hexdigest()


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
