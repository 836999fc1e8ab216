"""Delimited texts (CSV and its sisters) as the content of a table."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from io import BytesIO
from typing import TYPE_CHECKING, Any

import numpy as np

from aoabench.devices.readers.dialects import (
    COMMAS,
    Dialect,
    cells_of,
    dialect_of,
    without_comments,
)
from aoabench.devices.readers.reading import Content, Part, Reading
from aoabench.errors import BadValue

if TYPE_CHECKING:
    import pandas as pd

TEXTS = ("fix", "anchor", "id", "tag")  # read as text: 007 is not 7, and 1E5 is not a number
_MANY = 64  # columns; of more, only those needed are parsed
EMPTY = ["", "nan", "NaN", "NAN", "NA", "N/A", "null", "None"]


@dataclass(frozen=True)
class Delimited(Content):
    """A delimited text in UTF-8; `key` and `path` are for messages. head: the line that names the
    columns, empty without one; where it comes again, as in files joined by `cat`, it is no row.
    """

    key: str = ""
    path: str = ""
    text: bytes = b""
    dialect: Dialect = COMMAS
    head: bytes = b""

    def cells(self, names: Mapping[str, str]) -> pd.DataFrame:
        """The chosen columns; raises BadValue for a row with more cells than there are names."""
        import pandas as pd

        at = self.dialect.names
        places = {ours: at.index(theirs) for ours, theirs in names.items()}
        beyond = len(at)  # one extra column, to find cells beyond the header
        texts = {place for ours, place in places.items() if ours in TEXTS} | {beyond}
        used: list[int] | range = range(beyond + 1)
        if beyond > _MANY:
            used = sorted({*places.values(), beyond})
        try:
            found = self._parsed(used, texts)
        except ValueError:
            if beyond <= _MANY:
                raise
            found = self._parsed(used[:-1], texts).assign(**{str(beyond): np.nan})
            found = found.rename(columns={str(beyond): beyond})
        long = np.flatnonzero(found[beyond].notna())
        if len(long):
            more = f"{self.parts[0].at(int(long[0]))} has more"
            words = f"{beyond} cells in every row, as in the header; {more}"
            if (self.dialect.separator, self.dialect.decimal) == (",", "."):
                words += ": decimal commas? (cells are then separated by another mark)"
            raise BadValue(self.key, self.path, words)
        return pd.DataFrame({ours: found[place] for ours, place in places.items()})

    def _parsed(self, used: Sequence[int], texts: set[int]) -> pd.DataFrame:
        """The columns at the places `used`, those of `texts` as texts."""
        import pandas as pd

        known = self.dialect
        empty: dict[Any, list[str]] = {p: [""] if p in texts else EMPTY for p in used}
        return pd.read_csv(
            BytesIO(without_comments(self.text) if known.comments else self.text),
            sep=r"\s+" if known.separator == " " else known.separator,
            decimal=known.decimal,
            header=None,
            skiprows=known.skipped,
            names=range(len(known.names) + (len(known.names) in used)),
            usecols=np.array(used) if len(known.names) > _MANY else None,
            index_col=False,
            dtype={place: str for place in texts if place in used},
            na_values=empty,
            keep_default_na=False,
            skip_blank_lines=False,
            skipinitialspace=True,
            low_memory=False,
            encoding="utf-8",
        )


def delimited(
    text: bytes, key: str, path: str, given: Reading, known: Dialect | None = None
) -> Delimited:
    """The content of a text; its dialect is `known`, or else recognised.

    A last line that is cut, because the file is still being written, is left out and named.
    """
    dialect = known or dialect_of(text, key, path, given)
    part = Part(0, "line", dialect.skipped + 1)
    whole, notes = _complete(text, dialect, path)
    head, start = _head(whole, dialect.skipped)
    once, more = _without_line(whole, head, start)
    if more:
        words = "that name the columns again are left out, as of several files in one"
        notes = (*notes, f"{path}: {more} lines {words}")
    return Delimited(list(dialect.names), (part,), notes, {}, key, path, once, dialect, head)


def following(before: Delimited, text: bytes, line: int) -> Delimited:
    """The content of a text that goes on where `before` ends; `line` is its first line's number."""
    dialect = replace(before.dialect, skipped=0)
    rows, _ = _without_line(text, before.head, 0)
    return replace(before, parts=(Part(0, "line", line),), text=rows, dialect=dialect, notes=())


def _head(text: bytes, skipped: int) -> tuple[bytes, int]:
    """The last of the `skipped` first lines, with its end, and the place after it; b"" and 0
    without any.
    """
    start = end = 0
    for _ in range(skipped):
        start, end = end, text.find(b"\n", end) + 1
        if not end:
            return b"", 0
    return text[start:end], end


def _without_line(text: bytes, line: bytes, start: int) -> tuple[bytes, int]:
    """The text with the `line`, wherever it stands from the place `start` on, left empty, so that
    lines keep their numbers; and how often that is.
    """
    if not line.strip() or text.find(line, start) < 0:
        return text, 0
    again = re.compile(rb"^(?:\xef\xbb\xbf)?" + re.escape(line), re.M)
    rows, count = again.subn(b"\n", text[start:])
    return text[:start] + rows, count


def _complete(text: bytes, dialect: Dialect, path: str) -> tuple[bytes, tuple[str, ...]]:
    """The text without a cut last line, and a remark on it."""
    end = text.rfind(b"\n") + 1
    before = text[text.rfind(b"\n", 0, max(end - 1, 0)) + 1 : end]
    number = text.count(b"\n") + 1
    if not text[end:].strip() or b'"' in before + text[end:] or number <= dialect.skipped + 1:
        return text, ()
    counts = [len(cells_of(line.decode(errors="replace"), dialect.separator)) for line in
              (before, text[end:])]  # fmt: skip
    if counts[1] >= min(counts[0], len(dialect.names)):
        return text, ()
    words = "is cut, as in a file that is still being written, and not read"
    return text[:end], (f"{path}: line {number} {words}",)
