"""The dialect of a delimited text: separator, decimal mark, comment lines, names of columns."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

from aoabench.devices.readers.reading import Reading
from aoabench.errors import BadValue

MARKS = ("\t", ";", "|", ",")  # separators that are recognised, the surest first
_SAMPLE = 50  # lines
_COMMENT = re.compile(r"[ \t]*(#|%|//)")
_COMMENT_BYTES = re.compile(rb"^[ \t]*(?:#|%|//)[^\r\n]*", re.M)
_SEP_LINE = re.compile(r'^"?sep=(.)"?\r?$', re.I)  # the first line of Excel's CSV
_COMMA = re.compile(r"\s*[+-]?\d*,\d+(?:[eE][+-]?\d+)?\s*")
_POINT = re.compile(r"\s*[+-]?\d*\.\d+(?:[eE][+-]?\d+)?\s*")
_NUMBER = re.compile(r"\s*[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?\s*|\s*nan\s*|", re.I)


@dataclass(frozen=True)
class Dialect:
    """A delimited text: its marks, the names of its columns, the number of lines before its first
    row of data, and whether lines that begin with #, % or // are comments.
    """

    separator: str
    decimal: str
    names: tuple[str, ...]
    skipped: int
    comments: bool


COMMAS = Dialect(",", ".", (), 0, False)


def dialect_of(text: bytes, key: str, path: str, given: Reading) -> Dialect:
    """The dialect of a text in UTF-8, recognised from its first lines where it is not given.

    Raises BadValue for names given to another number of columns, and ValueError for a text without
    names of columns and for bytes that are not UTF-8.
    """
    lines = first_lines(text)
    start = _next(lines, -1)
    start = start if start is None else _past_comments(lines, start)
    mark = given.separator
    if start is not None and (stated := _SEP_LINE.match(lines[start])):
        mark, start = mark or stated[1], _next(lines, start)
    if start is None:
        raise ValueError("line 1 is empty: the first line names the columns")
    start = _past_comments(lines, start)
    rows = [line for line in lines[start:] if not is_void(line)][:_SAMPLE]
    likely = _separator(rows)
    mark = mark or likely
    names = cells_of(lines[start], mark)
    if given.separator and len(names) < 2 <= len(cells_of(lines[start], likely)):
        allowed = f"the mark between the cells of {path}; separated by {likely!r}?"
        raise BadValue("separator", mark, allowed)
    _check_title(start + 1, names, rows[1:])
    comments = not _hash_is_data(rows, names, mark)
    rows = [line for line in rows if not (comments and _COMMENT.match(line))]
    found = Dialect(mark, given.decimal or _decimal(rows, mark, text), (), start, comments)
    if given.header is not None:
        return _named(found, given.header, names, key, path)
    above = _commented_names(lines, start, names, mark)
    if above:
        return replace(found, names=tuple(above))
    return replace(found, names=tuple(names), skipped=start + 1)


def first_lines(text: bytes) -> list[str]:
    """The first complete lines of a text, as a sample."""
    size = 1 << 16
    while size < len(text) and text.count(b"\n", 0, size) < 3:
        size *= 8
    head = text[:size]
    if size < len(text):
        head = head[: head.rfind(b"\n") + 1]
    return head.decode().splitlines()


def shows_marks(head: bytes) -> bool:
    """Whether a text has a second line, comments apart, so that its marks can be recognised."""
    lines = head.decode(errors="replace").splitlines()
    return sum(not (is_void(x) or _COMMENT.match(x) or _SEP_LINE.match(x)) for x in lines) > 1


def is_void(line: str) -> bool:
    return not line.strip()


def cells_of(line: str, separator: str) -> list[str]:
    """The cells of one line, without white space around them."""
    if separator == " ":
        return line.split()
    if '"' not in line:
        return [cell.strip() for cell in line.split(separator)]
    return [cell.strip() for cell in next(csv.reader([line], delimiter=separator), [])]


def without_comments(text: bytes) -> bytes:
    """The text with its comment lines left empty, so that lines keep their numbers."""
    return _COMMENT_BYTES.sub(b"", text) if _COMMENT_BYTES.search(text) else text


def is_number(cell: str) -> bool:
    """Whether a cell is empty, or a number with any decimal mark."""
    return _NUMBER.fullmatch(cell) is not None


def _next(lines: Sequence[str], start: int) -> int | None:
    return next((i for i in range(start + 1, len(lines)) if not is_void(lines[i])), None)


def _past_comments(lines: Sequence[str], start: int) -> int:
    """The first line that is neither empty nor a comment, else `start`."""
    found = range(start, len(lines))
    return next((i for i in found if not is_void(lines[i]) and not _COMMENT.match(lines[i])), start)


def _check_title(line: int, names: Sequence[str], rows: Sequence[str]) -> None:
    """Raise ValueError if the line that should name the columns has one cell and the `rows` have
    several.
    """
    mark = _separator(rows)
    counts = [len(cells_of(row, mark)) for row in rows]
    if len(names) == 1 and len(counts) > 1 and min(counts) == max(counts) > 1:
        raise ValueError(
            f"line {line} has one cell and the lines below have {counts[0]}: "
            "lines above the names of columns begin with #"
        )


def _separator(rows: Sequence[str]) -> str:
    """The mark that cuts the lines into equally many cells: the first line has it, and so have
    most others; a comma if none does.
    """
    if len(rows) < 2:
        return ","
    best, most = ",", 0
    for mark in MARKS:
        counts = [len(cells_of(row, mark)) for row in rows]
        same = sum(count == counts[0] for count in counts)
        if counts[0] > 1 and same > max(most, 1):
            best, most = mark, same
    if most:
        return best
    counts = [len(row.split()) for row in rows]
    blanks = counts[0] > 1 and all(count == counts[0] for count in counts)
    return " " if blanks and not any(mark in row for row in rows for mark in MARKS) else ","


def _decimal(rows: Sequence[str], mark: str, text: bytes) -> str:
    """The decimal mark: a comma if cells have it and none has a point."""
    cells = [cell for row in rows for cell in cells_of(row, mark)]
    if any(_POINT.fullmatch(cell) for cell in cells):
        return "."
    if any(_COMMA.fullmatch(cell) for cell in cells):
        return ","
    if mark == "," or b"," not in text:
        return "."
    around = rb"[ \t\r\n]" if mark == " " else rb"[\r\n" + re.escape(mark.encode()) + rb"]"
    later = re.search(around + rb"[ \t]*[+-]?\d+,\d+[ \t]*" + around, text)
    return "," if later else "."


def _hash_is_data(rows: Sequence[str], names: Sequence[str], mark: str) -> bool:
    """Whether the first row after the names begins like a comment, but has a cell per name."""
    return len(rows) > 1 and bool(
        _COMMENT.match(rows[1]) and len(names) > 1 and len(cells_of(rows[1], mark)) == len(names)
    )


def _commented_names(
    lines: Sequence[str], start: int, first: Sequence[str], mark: str
) -> list[str] | None:
    """The names of columns in the last comment above a first row of numbers, as NumPy writes."""
    above = [line for line in lines[:start] if not is_void(line)]
    if not above or not _COMMENT.match(above[-1]) or all(not is_number(c) for c in first):
        return None
    names = cells_of(_COMMENT.sub("", above[-1], count=1), mark)
    fits = len(names) == len(first) and all(names) and not any(is_number(c) for c in names)
    return names if fits else None


def _named(
    found: Dialect, header: Sequence[str], first: Sequence[str], key: str, path: str
) -> Dialect:
    """The dialect of a text whose columns are called `header`; `first` are the first row's cells.

    A first row that repeats the names is no data.
    """
    if len(header) != len(first):
        allowed = f"{len(first)} names, one for each column of {path}"
        raise BadValue("header", list(header), allowed)
    own = [name.lower() for name in header] == [cell.lower() for cell in first]
    return replace(found, names=tuple(header), skipped=found.skipped + own)
