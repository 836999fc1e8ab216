"""The folder that keeps compiled kernels: one for each state of the kernels' source.

numba compares the time stamp of the file that defines a kernel and knows nothing of what that file
imports. So the folder's name is a hash of all these files: any change gives a new folder, and what
other versions left in theirs is never read. Old folders stay; to delete them is safe.
"""

from __future__ import annotations

import hashlib
import os
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

from aoabench.types import Outcome


class Kept(NamedTuple):
    """The folder that keeps compiled kernels, None where none can be written, and the usual place
    if that cannot be written.
    """

    folder: Path | None
    refused: Path | None = None


def kept(stated: str = "") -> Kept:
    """The folder, created where it is missing: below `stated` (NUMBA_CACHE_DIR) if that is not
    empty, else below the user's cache folder; where that cannot be written, below the folder for
    temporary files.
    """
    wanted = Path(stated) if stated else _user_cache()
    if found := _written(wanted / "aoabench" / source_digest()):
        return Kept(found)
    own = Path(tempfile.gettempdir()) / f"aoabench-{_user_id()}"
    found = _written(own / source_digest()) if _private(own) else None
    return Kept(found, wanted)


def source_digest() -> str:
    """A hash of everything of ours that the machine code of the kernels depends on."""
    read = hashlib.blake2b(repr([(o.name, o.value) for o in Outcome]).encode(), digest_size=10)
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
    """`folder`, created where it is missing; None where no file can be written into it."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except OSError:
        return None


def _private(folder: Path) -> bool:
    """Whether `folder`, created where it is missing, is a folder that only this user can write.

    Everybody can create folders among the temporary files, and what the cache holds is executed.
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
