"""The clocks of a stream's packets, made one clock as they come.

Where each anchor counts from its own start, its clock is set by the numbers (of fixes, or sequence
numbers) that it shares with the anchor heard most, or else by the time of arrival. Packets without
any time have that of their arrival, in s since 1970.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace

import numpy as np

from aoabench.devices.tracks.packets import Packets
from aoabench.maths.geometry import Array

SAME_S = 1.0  # s; clocks that differ by less are taken as one


@dataclass
class Clocks:
    """How far the clocks of anchors are behind the common one: `offset` in s, by the number of the
    anchor; `newest`: the latest common time in s.
    """

    offset: dict[int, float] = field(default_factory=dict)
    newest: float = -np.inf

    def one(self, packets: Packets) -> Packets:
        """The packets with times by one clock."""
        if packets.time is None or np.isnan(packets.time).all():
            return replace(packets, time=np.full(packets.count, time.time()), own_clocks=False)
        if not packets.own_clocks:
            return packets
        found, own = np.array(packets.time), packets.anchor
        event = _events(packets)
        anchors, counts = np.unique(own, return_counts=True)
        done = np.zeros(packets.count, dtype=bool)
        for b in anchors[np.argsort(-counts, kind="stable")].tolist():
            mine = own == b
            found[mine] += self._offset(b, found[mine], event[mine], found[done], event[done])
            done |= mine
        self.newest = max(self.newest, float(np.nanmax(found)))
        return replace(packets, time=found, own_clocks=False)

    def _offset(
        self, b: int, time: Array, event: np.ndarray, common: Array, shared: np.ndarray
    ) -> float:
        """What to add to the times (N,) s of anchor `b` with numbers `event` (N,), from the common
        times (M,) s of the numbers `shared` (M,).
        """
        _, i, j = np.intersect1d(event, shared, return_indices=True)
        ahead = common[j] - time[i]
        if not len(ahead):
            newest = self.newest if np.isfinite(self.newest) else float(np.nanmax(time))
            ahead = newest - time[-1:]
        off = float(np.nanmedian(ahead)) - self.offset.get(b, 0.0)
        if abs(off) > SAME_S or b not in self.offset:
            self.offset[b] = self.offset.get(b, 0.0) + (off if abs(off) > SAME_S else 0.0)
        return self.offset[b]


def _events(packets: Packets) -> np.ndarray:
    """A number (N,) for each packet that is equal for equal numbers of one tag."""
    key = packets.fix if packets.fix is not None else packets.sequence
    assert key is not None
    number = np.unique(key, return_inverse=True)[1].ravel()
    events: np.ndarray = packets.tag * (number.max(initial=0) + 1) + number
    return events
