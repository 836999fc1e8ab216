"""A log that arrives in pieces, as from a pipe: rows as soon as they are whole."""

from __future__ import annotations

import csv
import re
from dataclasses import replace

from aoabench.devices.readers.delimited import Delimited, following
from aoabench.devices.readers.dialects import shows_marks
from aoabench.devices.readers.formats import DEVICES, looks_like, text_content, why
from aoabench.devices.readers.reading import AUTO, Content, Reading, Rows
from aoabench.devices.readers.sources import KINDS
from aoabench.devices.readers.stamps import DAY_S
from aoabench.devices.readers.wide import widened
from aoabench.errors import BadValue

_LONGEST = 1 << 24  # bytes without an end of a line
_CR_ALONE = re.compile(rb"\r[^\r\n]")


class LineEnds:
    """LF in place of CR in a stream whose lines end with CR alone, until an LF comes."""

    def __init__(self) -> None:
        self._held, self._alone, self._known = b"", False, False

    def of(self, piece: bytes, ended: bool = False) -> bytes:
        """The piece with LF; a CR at its end waits for the next piece until it is known that no LF
        follows a CR, or the stream has `ended`.
        """
        if self._known:
            return piece
        text, self._held = self._held + piece, b""
        if b"\n" in text:
            self._known = True
            return text
        self._alone |= _CR_ALONE.search(text) is not None
        if text.endswith(b"\r") and not (self._alone or ended):
            text, self._held = text[:-1], b"\r"
        return text.replace(b"\r", b"\n")


class Live:
    """Contents of a log in pieces; the format is recognised from the first lines.

    Tables are delimited texts or JSON lines. `key` and `path` are for messages, such as "path" and
    "-".
    """

    def __init__(self, key: str, path: str, given: Reading = AUTO) -> None:
        self._key, self._path, self._given = key, path, given
        self._rest = b""
        self._line = 1  # the number of the first line of the rest
        self._format = "" if given.format == "auto" else given.format
        self._first: Delimited | None = None
        self._time_s: float | None = None
        self._days = 0

    def feed(self, piece: bytes) -> Content | None:
        """The rows that are whole with this piece, or None if no row is.

        Raises BadValue for a text that is no log.
        """
        self._rest += piece
        if len(self._rest) > _LONGEST and b"\n" not in self._rest:
            raise BadValue(self._key, self._path, f"a {KINDS}; its lines do not end")
        return self._content(self._cut())

    def end(self) -> Content | None:
        """The rows of a last line that has no end; to be called once, after the last piece."""
        whole, self._rest = self._rest, b""
        return self._content(whole + b"\n") if whole.strip() else None

    def _cut(self) -> bytes:
        """The whole rows at the beginning of what has arrived; taken out of the rest."""
        if not self._format:
            head = self._rest[: self._rest.rfind(b"\n") + 1]
            looks = looks_like(head.decode(errors="replace"))
            if looks == "table" and not shows_marks(head):
                return b""  # a header alone shows neither separator nor decimal mark
            self._format = looks
        end = self._rest.rfind(b"\n") + 1
        if device := DEVICES.get(self._format):
            end = max((one.end() for one in device.end.finditer(self._rest)), default=0)
        whole, self._rest = self._rest[:end], self._rest[end:]
        return whole

    def _content(self, whole: bytes) -> Content | None:
        if not whole.strip():
            self._line += whole.count(b"\n")
            return None
        line, self._line = self._line, self._line + whole.count(b"\n")
        try:
            found = self._parsed(self._given.in_utf8(whole), line)
        except BadValue:
            raise
        except (ValueError, csv.Error) as error:
            reason = why(error, self._key, self._given)
            raise BadValue(self._key, self._path, f"a readable {KINDS}; {reason}") from None
        return widened(found, self._given.patterns)

    def _parsed(self, whole: bytes, line: int) -> Content:
        if device := DEVICES.get(self._format):
            return self._timed(device.read(whole.decode(errors="replace"), self._path, line))
        if self._first is not None:
            return following(self._first, whole, line)
        given = replace(self._given, format="auto")
        found = text_content(whole, self._key, self._path, given)
        if isinstance(found, Rows):
            return replace(found, parts=(found.parts[0]._replace(first=line),))
        if isinstance(found, Delimited):
            self._first = found
        return found

    def _timed(self, found: Rows) -> Rows:
        """The rows with times of day that go on after midnight, from one piece to the next."""
        if "time_s" in found.columns and len(times := found.frame["time_s"].dropna()):
            if self._time_s is not None and times.iloc[0] < DAY_S:
                self._days += round((self._time_s - self._days * DAY_S - times.iloc[0]) / DAY_S)
                found.frame["time_s"] += self._days * DAY_S
            self._time_s = found.frame["time_s"].dropna().iloc[-1]
        return found
