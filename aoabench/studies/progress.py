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
_TRUSTED = 0.25  # share of all expected seconds for which these count as true, see Pace.left_s


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
    """The items of a command in the order in which they are computed. An item's experiment runs
    while the items before it are reduced and drawn, so an item with an experiment counts as
    computed once that `ran`, and one without once it is `done`.
    """

    def __init__(self, pairs: Sequence[Pair], seconds: Mapping[str, float]) -> None:
        self.expected = [seconds[f"{s.name}/{item.name}"] for s, item in pairs]
        self._runs = [item.experiment is not None for _, item in pairs]
        self._ran = self._done = 0
        self._elapsed_s = 0.0

    def ran(self, elapsed_s: float) -> None:
        """Note that the experiment of the next item has run, if it has one; `elapsed_s` are the
        seconds since the command began, without those in which kernels were compiled.
        """
        self._ran += 1
        self._elapsed_s = elapsed_s

    def done(self, elapsed_s: float) -> None:
        """Note that the next item is reduced and drawn; `elapsed_s` as for `ran`."""
        self._done += 1
        self._elapsed_s = elapsed_s

    @property
    def left_s(self) -> float:
        """Expected seconds of what is not computed, times the seconds elapsed over those expected
        of what is. _TRUSTED of all expected seconds enter both, so that the first items, which
        load libraries and wait for kernels, cannot change it much.
        """
        last = max(self._ran, self._done)
        waiting = zip(self.expected[self._done : last], self._runs[self._done : last])
        computed = sum(self.expected[: self._done]) + sum(e for e, runs in waiting if runs)
        trusted = _TRUSTED * sum(self.expected)
        if not computed + trusted:
            return 0.0
        speed = (self._elapsed_s + trusted) / (computed + trusted)
        return speed * (sum(self.expected) - computed)

    def text(self) -> str:
        """Items done, and the time left, for example '3 of 42 done, about 4 min left'."""
        total = len(self.expected)
        left = f", about {duration(self.left_s)} left" if self._done < total else ""
        return f"{self._done} of {total} done{left}"


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
