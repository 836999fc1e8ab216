"""What lies where in a run's folder: files and folders of the right kind, and temporary files that
killed runs have left.
"""

from __future__ import annotations

import contextlib
import os
import re
import time
from collections.abc import Iterable
from pathlib import Path

from aoabench.errors import UserError
from aoabench.store.files import STALE_S

_FOLDERS = ("cells", "parts", ".tables", "replications.parquet", "steps.parquet")
_TABLES = ("cells", "summary", "tidy", "timing", "failures", "precision")
_FILES = ("tables.json", *(f"{name}.parquet" for name in _TABLES))
_TEMPORARY = re.compile(r"\..+\.\d+\.[0-9a-f]{8}")  # the names that write_atomically gives


def check_kinds(out: Path) -> None:
    """Raise UserError if a file lies where a folder of the run belongs, or a folder where a file
    does.
    """
    for name in _FOLDERS:
        if (out / name).exists() and not (out / name).is_dir():
            raise UserError(
                f"{out / name} is a file; allowed here: a folder of the run; move the file away, "
                "or use another runner.out"
            )
    for name in _FILES:
        if (out / name).is_dir():
            raise UserError(
                f"{out / name} is a folder; allowed here: a file of the run; move the folder away, "
                "or use another runner.out"
            )


def sweep(out: Path, keys: Iterable[str]) -> None:
    """Delete the temporary files that killed runs have left in the folder, and in the folders of
    these part keys. The caller holds the folder's lock.

    Files younger than STALE_S stay, as a worker that outlived its killed parent may be writing
    them, perhaps on another machine.
    """
    old = time.time() - STALE_S
    for folder in (out, *(out / name for name in _FOLDERS), *(out / "parts" / key for key in keys)):
        with contextlib.suppress(FileNotFoundError), os.scandir(folder) as entries:
            for entry in entries:
                if _TEMPORARY.fullmatch(entry.name) and entry.is_file(follow_symlinks=False):
                    _delete_if_older(Path(entry.path), old)


def _delete_if_older(file: Path, moment: float) -> None:
    with contextlib.suppress(FileNotFoundError, PermissionError):
        if file.stat().st_mtime < moment:
            file.unlink()
