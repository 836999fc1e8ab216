"""How far a command that computes items has come, and how long the rest takes."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from aoabench.studies.choice import Pair

_ENOUGH_S = 10.0  # expected seconds of finished items that tell the speed of this machine


class Pace:
    """The items of a command in the order in which they are computed, at a scale."""

    def __init__(self, pairs: Sequence[Pair], scale: str) -> None:
        self.expected = [item.expected_s(scale) for _, item in pairs]
        self.spent: list[float] = []

    def done(self, seconds: float) -> None:
        """Note the seconds that the next item took."""
        self.spent.append(seconds)

    @property
    def left_s(self) -> float:
        """Expected seconds of the items that are not done, corrected by what the others took."""
        count = len(self.spent)
        expected = sum(self.expected[:count])
        speed = sum(self.spent) / expected if expected >= _ENOUGH_S else 1.0
        return speed * sum(self.expected[count:])

    def text(self) -> str:
        """Items done, and the time left, for example '3 of 42 done, about 4 min left'."""
        count, total = len(self.spent), len(self.expected)
        left = f", about {duration(self.left_s)} left" if count < total else ""
        return f"{count} of {total} done{left}"


def duration(seconds: float) -> str:
    """Seconds or minutes or hours as a short text, rounded."""
    if seconds < 90:
        return f"{max(round(seconds), 1)} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


@contextmanager
def shown(title: str) -> Iterator[None]:
    """Show a line on standard error, if that is a terminal, until the block ends."""
    if not sys.stderr.isatty():
        yield
        return
    from rich.console import Console

    with Console(stderr=True).status(title):
        yield
