"""When the fixes of a stream are complete.

A fix by a window of time is due once a packet of any tag is later than its window; a fix by a
number (of the log, or a sequence number) once its tag has a later number. It closes when it is due
and none of its packets is younger than HOLD_S, because packets may come out of order; or when
nothing has come for it for as long as its window and HOLD_S, or IDLE_S without a window.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, field

import numpy as np

from aoabench.devices.tracks.grouping import ROUNDING_S, Groups
from aoabench.devices.tracks.packets import Packets
from aoabench.maths.geometry import Array

HOLD_S = 0.01
IDLE_S = 0.1
LATE_S = 2.0  # a packet that comes within this time after its fix was closed is late
RESTART_S = 5.0  # a clock that goes back by more has started again
MOST_TAGS = 10_000  # of which the last fix is remembered


@dataclass(frozen=True)
class Rule:
    """How packets belong together: the parameters of the same names of a recorded scenario, and
    whether fixes have numbers.
    """

    window_s: float
    windows: str
    numbered: bool

    @property
    def patience_s(self) -> float:
        """The time in s after the last packet of a fix at which it closes in any case."""
        return IDLE_S if self.numbered else self.window_s + HOLD_S

    def closed(self, groups: Groups, arrival: Array, newest: float, now: float) -> np.ndarray:
        """Whether fixes (F,) are closed at the time `now` (time.monotonic) s.

        arrival (N,): when packets arrived, by the same clock; newest: the latest time in s of any
        packet so far, by the log's clock.
        """
        last = np.full(groups.count, -np.inf)
        np.maximum.at(last, groups.code, arrival)
        due = np.append(groups.tag[1:] == groups.tag[:-1], False)
        if not self.numbered:
            due = newest > self._ends(groups)
        return (due & (now - last >= HOLD_S)) | (now - last >= self.patience_s)

    def _ends(self, groups: Groups) -> Array:
        """The end (F,) s of each fix's window, by the log's clock."""
        first, last = np.full(groups.count, np.inf), np.full(groups.count, -np.inf)
        np.minimum.at(first, groups.code, groups.time)
        np.maximum.at(last, groups.code, groups.time)
        slack = min(ROUNDING_S, self.window_s / 1000)
        if self.window_s == 0 or self.windows == "chained":
            return last + self.window_s + slack
        if self.windows == "grid":
            return (np.floor((first + slack) / self.window_s) + 1) * self.window_s
        return first + self.window_s + slack


@dataclass
class Late:
    """Packets that come after their fix was closed; they are counted and not used."""

    rule: Rule
    count: int = 0
    ends: OrderedDict[str, float] = field(default_factory=OrderedDict)  # by tag, the log's clock
    numbers: dict[tuple[str, str], float] = field(default_factory=dict)  # when closed, monotonic

    def of(self, packets: Packets, now: float) -> np.ndarray:
        """Whether packets (N,) are late."""
        names = np.array(packets.tags, dtype=object)[packets.tag]
        if self.rule.numbered:
            self.numbers = {k: at for k, at in self.numbers.items() if now - at < LATE_S}
            keys = zip(names, numbers_of(packets))
            late = np.array([key in self.numbers for key in keys], dtype=bool)
        else:
            assert packets.time is not None
            ends = np.array([self.ends.get(tag, -np.inf) for tag in packets.tags])[packets.tag]
            late = (packets.time <= ends) & (packets.time > ends - RESTART_S)
        self.count += int(late.sum())
        return late

    def note(self, packets: Packets, groups: Groups, now: float) -> None:
        """Remember the fixes of closed packets."""
        if self.rule.numbered:
            names = np.array(packets.tags, dtype=object)[packets.tag]
            self.numbers |= dict.fromkeys(zip(names, numbers_of(packets)), now)
            return
        last = np.full(len(packets.tags), -np.inf)
        np.maximum.at(last, packets.tag, groups.time)
        for tag, end in zip(packets.tags, last.tolist()):
            self.ends[tag] = end
            self.ends.move_to_end(tag)
        while len(self.ends) > MOST_TAGS:
            self.ends.popitem(last=False)


def numbers_of(packets: Packets) -> list[str]:
    """The name or number of each packet's fix (N,)."""
    if packets.fix is not None:
        return [packets.fixes[i] for i in packets.fix]
    assert packets.sequence is not None
    return [str(number) for number in packets.sequence]


def some_of(groups: Groups, keep: np.ndarray) -> Groups:
    """The fixes where `keep` (F,) is True, with their packets."""
    own = keep[groups.code]
    code = (np.cumsum(keep) - 1)[groups.code[own]]
    return Groups(code, groups.tag[keep], groups.name[keep], groups.time[own])
