"""How users' files are read, and what an opened file offers to a table."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from aoabench.errors import BadValue, listed

if TYPE_CHECKING:
    import pandas as pd

SEPARATORS = {"tab": "\t", "\\t": "\t", "space": " ", "comma": ",", "semicolon": ";"}
ANCHOR = "{anchor}"  # stands for an anchor's id in the name of a column of a wide table
FILE = "file"  # the column that names each row's file, if several are read
UNREAD = "unread "  # precedes the name of a column that is only looked at, not read


@dataclass(frozen=True)
class Reading:
    """How a log is read; the defaults recognise the file.

    format: one of `formats.FORMATS`. header: the names of the columns of a table without a header.
    separator: the mark between cells, a blank for any white space. decimal: the decimal mark, `.`
    or `,`. patterns: the names of columns that contain {anchor}, which a wide table has once per
    anchor. encoding: Python's name of the encoding of a text, None for UTF-8; a mark of the byte
    order at its beginning wins.

    Raises BadValue with the key of the same name in a scenario.
    """

    format: str = "auto"
    header: tuple[str, ...] | None = None
    separator: str | None = None
    decimal: str | None = None
    patterns: tuple[str, ...] = ()
    encoding: str | None = None

    def __post_init__(self) -> None:
        mark = SEPARATORS.get(self.separator or "", self.separator)
        object.__setattr__(self, "separator", mark)
        if mark is not None and (len(mark) != 1 or mark.isalnum() or mark in "\"'.+-\r\n\0"):
            raise BadValue("separator", mark, "one character between cells, tab, space, or null")
        if self.decimal not in (None, ".", ","):
            raise BadValue("decimal", self.decimal, "'.', ',' or null")
        if self.encoding is not None and not _keeps_ascii(self.encoding):
            allowed = "an encoding that Python knows and that extends ASCII, such as cp1252 or "
            raise BadValue("encoding", self.encoding, f"{allowed}latin-1, or null for UTF-8")
        self._check_header()
        for name in self.patterns:
            if name.count(ANCHOR) != 1:
                raise BadValue("columns", name, f"{ANCHOR} once in the name of a column")

    def in_utf8(self, text: bytes) -> bytes:
        """A text of the declared encoding in UTF-8; raises UnicodeDecodeError for other bytes."""
        return text if self.encoding is None else text.decode(self.encoding).encode()

    def _check_header(self) -> None:
        if self.header is None:
            return
        if isinstance(self.header, str) or not isinstance(self.header, Sequence):
            raise BadValue("header", self.header, "a list of the columns' names, or null")
        names = tuple(str(name).strip() for name in self.header)
        twice = sorted({name for name in names if name and names.count(name) > 1})
        if not any(names) or twice:
            more = f"; {listed(twice)} occurs more than once" if twice else ""
            raise BadValue("header", list(names), f"the name of each column, each once{more}")
        object.__setattr__(self, "header", names)


def _keeps_ascii(encoding: object) -> bool:
    """Whether an encoding is known, and ASCII is the same in it."""
    ascii = "".join(map(chr, range(32, 127)))
    try:
        return ascii.encode(str(encoding)) == ascii.encode()
    except (LookupError, ValueError):
        return False


AUTO = Reading()


class Part(NamedTuple):
    """A file's rows in a table: the first row's place in it, the word and number for the file's
    first row in messages, and the file's path if the table has several.
    """

    start: int
    word: str
    first: int
    path: str = ""

    def at(self, place: int) -> str:
        """'line 17' or 'line 17 of b.csv' for a row of this part."""
        where = f" of {self.path}" if self.path else ""
        return f"{self.word} {place - self.start + self.first}{where}"


@dataclass(frozen=True)
class Content:
    """An opened file: the names of its columns, remarks to print, and the conventions that its
    format states, under the names of a scenario's parameters.
    """

    columns: Sequence[str]
    parts: tuple[Part, ...]
    notes: tuple[str, ...] = ()
    stated: Mapping[str, str] = ()  # type: ignore[assignment]

    def cells(self, names: Mapping[str, str]) -> pd.DataFrame:
        """The columns `names` (aoabench's name -> the file's) under aoabench's names; the index is
        the row's place in the file.
        """
        raise NotImplementedError

    def shown(self, name: str) -> str:
        """The name in messages of the column `name`."""
        return name


@dataclass(frozen=True)
class Rows(Content):
    """Rows in memory: `frame` has all columns, and the rows' places as its index."""

    frame: pd.DataFrame = None  # type: ignore[assignment]

    def cells(self, names: Mapping[str, str]) -> pd.DataFrame:
        """The chosen columns, NaN where a row has no such cell; raises ValueError for lists."""
        found = self.frame.reindex(columns=list(names.values()))
        for name in found.columns[found.dtypes.map(str) == "object"].unique():
            if found[[name]].iloc[:, 0].map(type).isin([list, dict]).any():
                raise ValueError(f"{name!r} has lists, not single texts, numbers or times")
        found.columns = list(names)
        return found


class Device(NamedTuple):
    """The text format of a device.

    name: its name in `scenario.format`; words: what messages call it; whole: how a whole message
    looks; recognised: whether the beginning of a text shows it; read: the rows of a text, whose
    path and number of the first line are given; end: the end of a message in a stream.
    """

    name: str
    words: str
    whole: str
    recognised: Callable[[str], bool]
    read: Callable[[str, str, int], Rows]
    end: re.Pattern[bytes] = re.compile(rb"\n")
