"""Fixes of a stream, as its packets come.

The packets of fixes that are not complete stay open; `windows` says when a fix closes. A fix is
located once, from what has come by then; what comes later is counted. Memory does not grow with the
stream.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from aoabench.deployment import fixes
from aoabench.deployment.clocks import Clocks
from aoabench.deployment.mixing import joined, without_unused_names
from aoabench.deployment.numbering import Numbering
from aoabench.deployment.recursion import Method
from aoabench.deployment.request import Asked
from aoabench.deployment.windows import Late, Rule, some_of
from aoabench.devices.tracks.combining import DISTINCT, combined
from aoabench.devices.tracks.grouping import Groups, grouped
from aoabench.devices.tracks.packets import Packets
from aoabench.maths.geometry import Array
from aoabench.types import Tracks

_SAID = (
    "-: packets of an anchor in a fix differ; all of them are used. scenario.combine=median, mean, "
    "first or last makes one of them; scenario.columns.tag keeps tags apart, and a shorter "
    "scenario.window_s makes more fixes"
)
Fixes = dict[str, np.ndarray]  # the columns of a table of fixes


@dataclass
class Live:
    """The state of a stream: packets of open fixes with the times (N,) s of their arrival, and the
    latest time in s of any packet.

    distinct: whether packets of an anchor in a fix that differ are all used, which is said once.
    """

    asked: Asked
    say: Callable[[str], None]
    distinct: bool = False
    max_sigma_m: float | None = None
    rule: Rule | None = None
    open: Packets | None = None
    arrival: Array = field(default_factory=lambda: np.empty(0))
    newest: float = -np.inf
    late: Late | None = None
    said: bool = False

    def __post_init__(self) -> None:
        scenario = self.asked.scenario
        self.method = Method(scenario, self.asked.method)
        self.numbering = Numbering(scenario.gap_s, self.method.forget)
        self.clocks = Clocks()

    def wait_s(self) -> float | None:
        """The time in s until an open fix closes if nothing comes; None without an open fix."""
        if self.open is None or self.rule is None:
            return None
        return max(float(self.arrival.min()) + self.rule.patience_s - time.monotonic(), 1e-3)

    def take(self, packets: Packets | None, now: float, ended: bool = False) -> Fixes | None:
        """The columns of the fixes that close when `packets` have arrived at the time `now`
        (time.monotonic) s, or when the stream has `ended`; None without any.
        """
        if packets is not None:
            packets = self._accepted(packets, now)
        if packets is not None and packets.count:
            self.open = packets if self.open is None else joined(self.open, packets)
            self.arrival = np.append(self.arrival, np.full(packets.count, now))
        if self.open is None or self.rule is None or self.late is None:
            return None
        scenario = self.asked.scenario
        groups = grouped(self.open, scenario.window_s, scenario.windows)
        done = np.full(groups.count, True)
        if not ended:
            done = self.rule.closed(groups, self.arrival, self.newest, now)
        if not done.any():
            return None
        own = done[groups.code]
        closed, chosen = self.open.where(own), some_of(groups, done)
        self.late.note(closed, chosen, now)
        self.open = None if own.all() else without_unused_names(self.open.where(~own))
        self.arrival = self.arrival[~own]
        return self._located(closed, chosen)

    def _accepted(self, packets: Packets, now: float) -> Packets:
        """The packets that are not late, by one clock."""
        scenario = self.asked.scenario
        if self.rule is None:
            numbered = packets.fix is not None
            numbered |= packets.sequence is not None and scenario.window_s == 0
            self.rule = Rule(scenario.window_s, scenario.windows, numbered)
            self.late = Late(self.rule)
        assert self.late is not None
        packets = self.clocks.one(packets)
        packets = packets.where(~self.late.of(packets, now))
        if packets.time is not None and packets.count:
            self.newest = max(self.newest, float(np.nanmax(packets.time, initial=-np.inf)))
        return packets

    def _located(self, packets: Packets, groups: Groups) -> Fixes:
        """The columns of closed fixes."""
        scenario = self.asked.scenario
        known = scenario.anchors_file.ids
        combine = DISTINCT if self.distinct else scenario.combine
        found = combined(packets, groups, len(known), combine)
        if self.distinct and len(found.columns) > len(known) and not self.said:
            self.said = True
            self.say(_SAID)
        tags = [packets.tags[i] for i in groups.tag]
        track, number = self.numbering.of(tags, found.time)
        numbered = packets.fix is not None or packets.sequence is not None
        names = groups.name if numbered else number.astype(str).astype(object)
        first = np.flatnonzero(np.diff(track, prepend=-1))
        tracks = Tracks(
            tags=tuple(tags[i] for i in first),
            counts=np.diff(first, append=len(track)),
            time=found.time,
            fix=names,
            truth=np.full((groups.count, 3), np.nan),
            measured=found.measured,
            packets=found.packets,
            columns=found.columns,
            poses=scenario.poses_of(found, groups.tag),
        )
        solved = self.method.solve(tracks, track[first])
        return fixes.columns(tracks, solved, self.max_sigma_m, numbers=track[first])
