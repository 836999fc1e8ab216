"""How far a command that computes items has come, and how long the rest takes."""

from __future__ import annotations

import sys
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import yaml

from aoabench.resources import shipped
from aoabench.store.files import write_atomically
from aoabench.studies.choice import Pair

_UNKNOWN_S = 10.0  # expected of an item that was never timed
_ENOUGH_S = 10.0  # expected seconds of finished items that tell the speed of this machine


def expected(scale: str) -> Mapping[str, float]:
    """About how many seconds each STUDY/ITEM takes at a scale, for order and progress alone: those
    that experiments/pace.yaml holds from an earlier run, _UNKNOWN_S for others.
    """
    held = yaml.safe_load(_pace_file().read_text(encoding="utf-8"))
    return defaultdict(lambda: _UNKNOWN_S, held.get(scale) or {})


def note(scale: str, computed: Sequence[Mapping[str, Any]]) -> None:
    """Keep the seconds of computed items (each with study, item, seconds) in pace.yaml."""
    path = _pace_file()
    held = yaml.safe_load(path.read_text(encoding="utf-8"))
    new = {f"{row['study']}/{row['item']}": row["seconds"] for row in computed}
    held[scale] = dict(sorted({**(held.get(scale) or {}), **new}.items()))
    head = "# Seconds of each item when it was last computed with COMMIT=1; written by aoabench\n"
    text = head + yaml.safe_dump(held)
    write_atomically(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))


def _pace_file() -> Path:
    return shipped("experiments") / "pace.yaml"


class Pace:
    """The items of a command in the order in which they are computed."""

    def __init__(self, pairs: Sequence[Pair], seconds: Mapping[str, float]) -> None:
        self.expected = [seconds[f"{s.name}/{item.name}"] for s, item in pairs]
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
