"""Unexpected exceptions, reported as one line; the traceback goes into a file."""

from __future__ import annotations

import re
import sysconfig
import tempfile
import traceback
from pathlib import Path

from aoabench.errors import shorten

DEBUG = "AOABENCH_DEBUG"  # environment variable: every error is printed with its traceback


def reported(error: Exception) -> str:
    """Return a line about an exception that no check has foreseen: where it was raised, who can
    mend it, and the file that its traceback has been written to.
    """
    text = "".join(traceback.format_exception(error))
    what = shorten(f"{type(error).__name__}: {error}" if str(error) else type(error).__name__)
    place = _place(error)
    fault = "this is a fault of aoabench, please report it with the traceback"
    if place is not None and not place[0].is_relative_to(_PACKAGE):
        fault = f"this is a fault in {place[0]}, line {place[1]}; the traceback is"
    return f"{what}; {fault} {_stored(text)}"


_PACKAGE = Path(__file__).resolve().parents[1]


def _place(error: BaseException) -> tuple[Path, int] | None:
    """File and line of the innermost call outside libraries; also of a call in a worker process."""
    while error.__cause__ is not None:
        error = error.__cause__
    text = "".join(traceback.format_exception(error))  # a worker's cause is its traceback as text
    found = [
        (Path(file), int(line)) for file, line in re.findall(r'File "(.+?)", line (\d+)', text)
    ]
    ours = [place for place in found if not _is_library(place[0])]
    return ours[-1] if ours else None


def _is_library(file: Path) -> bool:
    folders = {sysconfig.get_path(name) for name in ("stdlib", "purelib", "platlib")}
    inside = any(file.is_relative_to(folder) for folder in folders if folder)
    return inside and not file.is_relative_to(_PACKAGE)


def _stored(text: str) -> str:
    """Write the traceback into a new temporary file; return where it is, or how to see it."""
    try:
        with tempfile.NamedTemporaryFile(
            "w", prefix="aoabench-", suffix=".txt", delete=False, encoding="utf-8"
        ) as file:
            file.write(text)
    except OSError:
        return f"that {DEBUG}=1 prints"
    return f"in {file.name} ({DEBUG}=1 prints it)"
