"""`locate` on a stream: from its text to the rows of fixes, as they come."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from aoabench.deployment.live import Fixes, Live
from aoabench.deployment.reader import Reader
from aoabench.deployment.request import Request
from aoabench.deployment.stream import pieces
from aoabench.deployment.summary import percent, sentence
from aoabench.errors import UserError
from aoabench.types import Outcome

_OK = Outcome.OK.name.lower()


@dataclass
class Run:
    """A stream that is being located, and what has been counted so far; `say` prints a line."""

    request: Request
    max_sigma_m: float | None
    say: Callable[[str], None]
    reader: Reader = field(init=False)
    live: Live | None = None
    fixes: int = 0
    given: int = 0
    bad: Counter[tuple[str, str]] = field(default_factory=Counter)

    def __post_init__(self) -> None:
        self.reader = Reader(self.request, self.say)

    def tables(self, file: int, wake: int | None = None) -> Iterator[Fixes]:
        """The tables of fixes of a stream, given by its file descriptor, until it ends, or until
        `wake`, another one, can be read.
        """
        for piece in pieces(file, self._wait_s, wake):
            yield from self.table(piece.text, piece.at, ended=False)
        yield from self.rest()

    def rest(self) -> Iterator[Fixes]:
        """The table of the fixes that are still open."""
        yield from self.table(b"", time.monotonic(), ended=True)
        if self.live is None:
            raise UserError(
                "LOG=-: the stream ended without a measurement; allowed: the lines of a log"
            )

    def _wait_s(self) -> float | None:
        return self.reader.wait_s() if self.live is None else self.live.wait_s()

    def table(self, text: bytes, now: float, ended: bool = False) -> Iterator[Fixes]:
        """The table of the fixes that close when `text` has arrived at the time `now`
        (time.monotonic) s, or when the stream has `ended`; nothing without any.
        """
        packets = self.reader.packets(text, now, ended)
        if self.live is None and packets is not None:
            reader = self.reader
            self.live = Live(reader.asked, self.say, reader.distinct, self.max_sigma_m)
        if self.live is None:
            return
        found = self.live.take(packets, now, ended)
        if found is not None:
            self._count(found)
            yield found

    def _count(self, frame: Fixes) -> None:
        self.fixes += len(frame["x_m"])
        self.given += int(np.isfinite(frame["x_m"]).sum())
        outcome, reason = frame["outcome"], frame["reason"]
        bad = outcome != _OK
        self.bad.update(zip(outcome[bad], reason[bad]))

    def lines(self) -> Iterator[str]:
        """What was counted, in lines."""
        if not self.fixes:
            return
        share = percent(self.given / self.fixes)
        name = self.reader.asked.name
        yield f"{name}: {self.fixes} fixes, {self.given} with a position ({share})"
        for (outcome, reason), n in self.bad.most_common():
            yield f"  {n} {outcome} ({percent(n / self.fixes)}): {sentence(reason)}"
        late = 0 if self.live is None or self.live.late is None else self.live.late.count
        if late:
            yield f"{late} packets came after their fix was complete, and are not used"
