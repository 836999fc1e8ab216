"""Plain rows of a delimited text, in NumPy alone: quick for the small pieces of a stream.

Rows are plain if each has all cells, without quotes and comments, and if the numbers are finite
decimal numbers. Other rows are left to `Table.of`, which knows empty cells, dates and mistakes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from aoabench.devices.readers.delimited import TEXTS, Delimited
from aoabench.devices.readers.reading import UNREAD, Content
from aoabench.devices.readers.table import Table
from aoabench.maths.geometry import Array

_TEXTS = frozenset(TEXTS)
_OTHERS = (b'"', b"#", b"%", b"//")  # quotes and comments


@dataclass(frozen=True)
class Plain(Table):
    """Columns of plain rows: `floats` (N,) and `words` (N), under aoabench's names. There are no
    lines for messages.
    """

    floats: Mapping[str, Array] = field(default_factory=dict)
    words: Mapping[str, Sequence[str]] = field(default_factory=dict)
    rows: int = 0

    @property
    def count(self) -> int:
        return self.rows

    def where(self, keep: np.ndarray) -> Table:
        raise self.bad("rows that are all used")

    def at(self, row: int, *columns: str) -> str:
        return f"row {row}"

    def is_number(self, column: str) -> bool:
        return column in self.floats

    def numbers(self, column: str, empty: bool = True) -> Array:
        return self.floats[column]

    def texts(self, column: str) -> tuple[np.ndarray, list[str]]:
        place: dict[str, int] = {}
        code = [place.setdefault(word, len(place)) for word in self.words[column]]
        return np.array(code), list(place)


def plain_rows(content: Content, key: str, path: Any, names: Mapping[str, str]) -> Plain | None:
    """The columns `names` (aoabench's name -> the file's) of a text; None if it is not plain."""
    if not isinstance(content, Delimited) or any(mark in content.text for mark in _OTHERS):
        return None
    marks, known = content.dialect, list(content.dialect.names)
    if marks.separator == " " or marks.decimal != "." or marks.skipped:
        return None
    try:
        lines = content.text.decode().replace("\r\n", "\n").rstrip("\n").split("\n")
        columns = list(zip(*(line.split(marks.separator) for line in lines), strict=True))
        if len(columns) != len(known):
            return None
        taken = {o: columns[known.index(n)] for o, n in names.items() if not o.startswith(UNREAD)}
        words = {ours: _words(cells) for ours, cells in taken.items() if ours in _TEXTS}
        floats = {ours: _floats(cells) for ours, cells in taken.items() if ours not in _TEXTS}
    except ValueError:
        return None
    shown = {ours: content.shown(names[ours]) for ours in taken}
    return Plain(
        key=key,
        path=path,
        names=shown,
        frame=None,  # type: ignore[arg-type]
        parts=content.parts,
        stated=content.stated,
        floats=floats,
        words=words,
        rows=len(lines),
    )


def _words(cells: Sequence[str]) -> list[str]:
    """The cells as texts; raises ValueError for an empty one."""
    found = [cell.strip() for cell in cells]
    if not all(found):
        raise ValueError
    return found


def _floats(cells: Sequence[str]) -> Array:
    """The cells as finite numbers (N,); raises ValueError for others."""
    text = "".join(cells)
    found = np.array([float(cell) for cell in cells])
    if "_" in text or not text.isascii() or not np.isfinite(found).all():
        raise ValueError
    return found
