"""A stream of bytes, such as standard input, in pieces as they arrive."""

from __future__ import annotations

import os
import select
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

PIECE = 2**18  # bytes that are read at once
GATHER_S = 0.005, 0.01  # what arrives within this time is read together: at least, at most
SHARE = 3  # times as long as the piece before took


@dataclass(frozen=True)
class Piece:
    """What arrived by the time `at` (time.monotonic) s; b"" if nothing did."""

    text: bytes
    at: float


def pieces(
    file: int, wait_s: Callable[[], float | None], wake: int | None = None
) -> Iterator[Piece]:
    """Yield what arrives at a file descriptor, until it ends, or until `wake`, another one, can be
    read.

    The busier the stream, the longer the pieces, because each has a cost of its own. An empty piece
    is yielded when nothing has arrived for `wait_s()` s; None: wait for ever.
    """
    least, most = GATHER_S
    took = 0.0
    while True:
        ready = _ready([file] if wake is None else [file, wake], wait_s())
        if wake in ready:
            return
        if not ready:
            yield Piece(b"", time.monotonic())
            continue
        time.sleep(min(max(SHARE * took, least), most))
        found = os.read(file, PIECE)
        if not found:
            return
        begin = time.process_time()
        yield Piece(found, time.monotonic())
        took = time.process_time() - begin


def _ready(files: list[int], wait_s: float | None) -> list[int]:
    """Those of the files that have something to read within `wait_s` s, or that have ended."""
    try:
        return select.select(files, [], [], wait_s)[0]
    except (ValueError, OSError):  # a system that waits for sockets alone
        return files[:1]
