"""Signals that end a command between two steps, so that none is lost in the middle of one."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

_NAMES = ("SIGINT", "SIGTERM", "SIGHUP")
_GRACE_S = 5.0  # further signals within this time of the first are ignored


@dataclass
class Stop:
    """`wake`: a file descriptor that can be read once a signal has come; number: the signal's, or
    None before it.
    """

    wake: int
    number: int | None = None


@contextmanager
def held() -> Iterator[Stop]:
    """Yield what tells that a signal has come, in place of KeyboardInterrupt, which comes only from
    a signal _GRACE_S later. Signals that are ignored stay ignored; afterwards all are, if one has
    come, because it has ended the command and the process ends too.
    """
    source, sink = os.pipe()
    stop, first = Stop(source), [0.0]

    def note(number: int, _frame: object) -> None:
        if stop.number is None:
            stop.number, first[0] = number, time.monotonic()
            os.write(sink, b"x")
        elif time.monotonic() > first[0] + _GRACE_S:
            raise KeyboardInterrupt

    mine = threading.current_thread() is threading.main_thread()
    numbers = [getattr(signal, name) for name in _NAMES if mine and hasattr(signal, name)]
    others = [number for number in numbers if signal.getsignal(number) != signal.SIG_IGN]
    before = {number: signal.signal(number, note) for number in others}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler if stop.number is None else signal.SIG_IGN)
        os.close(source)
        os.close(sink)
