"""The tracks of a stream's tags."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from aoabench.maths.geometry import Array

MOST_TAGS = 10_000  # tags whose tracks go on; of further ones the longest silent is forgotten


@dataclass
class Numbering:
    """The number of each tag's track, the time in s of its last fix and the number of its fixes.

    gap_s: a longer silence starts another track; None: none does. ended: called with the number of
    a track that does not go on.
    """

    gap_s: float | None
    ended: Callable[[int], object]
    known: OrderedDict[str, tuple[int, float, int]] = field(default_factory=OrderedDict)
    count: int = 0

    def of(self, tags: list[str], time: Array) -> tuple[np.ndarray, np.ndarray]:
        """The numbers (F,) of the tracks of fixes by their tags, at times (F,) s, and the fixes'
        own numbers (F,) within their tags, from 0.
        """
        found = [self._of(tag, at) for tag, at in zip(tags, time.tolist())]
        track, fix = np.array(found, dtype=int).reshape(-1, 2).T
        return track, fix

    def _of(self, tag: str, at: float) -> tuple[int, int]:
        number, last, fixes = self.known.get(tag, (-1, np.nan, 0))
        if self.gap_s is not None and at - last > self.gap_s:
            self.ended(number)
            number = -1
        if number < 0:
            number, self.count = self.count, self.count + 1
        self.known[tag] = number, at, fixes + 1
        self.known.move_to_end(tag)
        if len(self.known) > MOST_TAGS:
            self.ended(self.known.popitem(last=False)[1][0])
        return number, fixes
