"""From the bytes of a stream to packets, piece by piece, with the readers of files.

The beginning of the stream is read as a file: what it shows holds for the rest.
"""

from __future__ import annotations

import codecs
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from aoabench.deployment.mixing import joined, without_rows
from aoabench.deployment.request import Asked, Request
from aoabench.devices.readers.live import LineEnds, Live
from aoabench.devices.readers.reading import Content, Rows
from aoabench.devices.tracks.packets import Packets
from aoabench.errors import BadValue, UserError

BEGIN_S = 1.0  # s and bytes after which a mistake in the beginning is told: until then, more of
BEGIN_BYTES = 2**16  # the log may mend it, such as further anchors
LONGEST = 2**20  # bytes of a first line
_NO_TEXT = {  # first bytes of what is read in a file alone
    b"\x1f\x8b": "this is packed with gzip: `gzip -cd FILE | aoabench locate - ...`, or LOG=FILE",
    b"PAR1": "Parquet is read in a file: LOG=FILE",
    b"PK\x03\x04": "Excel is read in a file: LOG=FILE",
    codecs.BOM_UTF16_LE: "this is UTF-16: `iconv -f UTF-16 -t UTF-8`, or LOG=FILE",
    codecs.BOM_UTF16_BE: "this is UTF-16: `iconv -f UTF-16 -t UTF-8`, or LOG=FILE",
}
_TAGS, _COMBINE = "scenario.tags=", "scenario.combine="


class Reader:
    """The reader of one stream; `asked` once its beginning has been read. `say` prints a line.

    A wanted tag may come late, so that tags are chosen here and not by the scenario. distinct:
    whether packets of an anchor in a fix that differ are all used, in place of the error of a file.
    """

    asked: Asked

    def __init__(self, request: Request, say: Callable[[str], None]) -> None:
        self.tags = _tags(request)
        self.distinct = _last(request, _COMBINE) in (None, "error")
        others = [word for word in request.settings if not word.startswith(_TAGS)]
        others += [f"{_COMBINE}each"] * self.distinct
        self.request, self.say = replace(request, settings=tuple(others)), say
        self._beginning, self._since = b"", np.inf
        self._live: Live | None = None
        self._ends = LineEnds()

    def wait_s(self) -> float | None:
        """The time in s until the beginning is read again if nothing comes; None before it."""
        return BEGIN_S / 4 if self._beginning else None

    def packets(self, piece: bytes, now: float, ended: bool = False) -> Packets | None:
        """The packets in the rows that are whole with this piece, which arrived at the time `now`
        (time.monotonic) s; None without any.

        The beginning is kept until it shows how to read it, and until the stream has `ended`.
        Raises UserError as for a file.
        """
        piece = self._ends.of(piece, ended)
        if self._live is None:
            self._beginning += piece
            if not self._begun(now, ended):
                return None
            piece, self._beginning = self._beginning, b""
            self._live = Live("path", "-", self.asked.scenario.reading)
        contents = [self._live.feed(piece), self._live.end() if ended else None]
        found = [packets for one in contents if one is not None for packets in self._of(one)]
        return None if not found else found[0] if len(found) == 1 else joined(*found)

    def _begun(self, now: float, ended: bool) -> bool:
        """Whether the beginning shows what is asked for."""
        text = self._beginning
        whole = text if ended else text[: text.rfind(b"\n") + 1]
        for start, words in _NO_TEXT.items():
            if text.startswith(start):
                raise BadValue("LOG", "-", f"a text; {words}")
        if len(text) > LONGEST and b"\n" not in text:
            raise BadValue("LOG", "-", f"a log; its first line is longer than {LONGEST} bytes")
        if not whole.strip():
            return False
        try:
            self.asked = self._asked(whole)
        except UserError:
            self._since = min(self._since, now)
            if ended or len(text) > BEGIN_BYTES or now - self._since > BEGIN_S:
                raise
            return False
        return True

    def _asked(self, beginning: bytes) -> Asked:
        """What is asked for, from the beginning of the stream."""
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "stream.log"
            path.write_bytes(beginning)
            try:
                found = replace(self.request, log=str(path)).asked(self.say)
            except UserError as error:
                raise UserError(str(error).replace(str(path), "-")) from None
        for line in found.cell.notes[1:]:  # the first counts the rows of the beginning
            self.say(line.replace(str(path), "-"))
        return found

    def _of(self, content: Content) -> list[Packets]:
        """The packets of the wanted tags in some rows, [] without any."""
        if isinstance(content, Rows) and not len(content.frame):
            return []
        found, _ = self.asked.scenario.packets_of(content, "-", quick=True)
        packets = without_rows(found)
        if self.tags is not None:
            wanted = np.array([tag in self.tags for tag in packets.tags])
            packets = packets.where(wanted[packets.tag])
        return [packets] if packets.count else []


def _tags(request: Request) -> set[str] | None:
    """The tags that are wanted; None for all."""
    found = _last(request, _TAGS)
    if found is None:
        return None
    if isinstance(found, str) or not isinstance(found, Sequence):
        raise BadValue("scenario.tags", found, "a list of tags, or null")
    return {str(tag) for tag in found}


def _last(request: Request, key: str) -> Any:
    """The last value that the settings give to a key, with its `=`; None without any."""
    from aoabench.config.overrides import read

    found = [read([word])[0].value for word in request.settings if word.startswith(key)]
    return found[-1] if found else None
