"""The folder of a run's tables belongs to runs alone, so that no other file is overwritten."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

from aoabench.errors import BadValue, shorten
from aoabench.store.files import write_atomically

MARKER = ".aoabench"  # in each folder that runs write into
FORMAT = 1  # of the folder


def claim(out: Path, name: str) -> None:
    """Mark the folder `out` as one of runs; `name` is the folder as the user gave it.

    Raises BadValue for a folder that holds anything but a run. Hidden files do not count.
    """
    if (out / MARKER).exists():
        return
    others = list(_visible(out))
    if others and not (out / "parts").is_dir():  # the parts of a run by an earlier version
        shown = " and ".join(shorten(repr(path.name), 60) for path in others[:2])
        more = f" and {len(others) - 2} more" * (len(others) > 2)
        allowed = f"a new or empty folder, or one of runs; this one holds {shown}{more}"
        raise BadValue("runner.out", name, allowed)
    text = json.dumps({"format": FORMAT})
    write_atomically(out / MARKER, lambda temporary: temporary.write_text(text, encoding="utf-8"))


def _visible(folder: Path) -> Iterator[Path]:
    return (path for path in sorted(folder.iterdir()) if not path.name.startswith("."))
