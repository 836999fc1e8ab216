"""Fixes from packets: those of one tag that belong together, in the order of time.

Packets belong together by the fix that the log states, else by a window of time, else by their
sequence number, else by equal times:

    first     up to `window_s` after the first packet of the fix
    grid      in one cell of a clock grid of `window_s`
    chained   each at most `window_s` after the one before

A sequence number that comes again later, after a restart or an overflow, starts another fix.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass

import numpy as np

from aoabench.devices.tracks.clocks import aligned
from aoabench.devices.tracks.packets import Packets
from aoabench.errors import BadValue
from aoabench.maths.geometry import Array

WINDOWS = ("first", "grid", "chained")
_INCOMPARABLE = (
    "a column of sequence numbers, or of fixes: the times of {} count from the start of each "
    "anchor and do not compare; or else clock_offset_s in the file of anchors, how far each clock "
    "is ahead"
)
_FEWER = "a shorter scenario.window_s makes more, and scenario.columns.fix or sequence others"
EVENT_S = 1.0  # s; packets of one number that are further apart belong to two fixes
OVERFLOW = 2**15  # a larger gap between numbers is that of a counter of 16 bits or more
ROUNDING_S = 1e-6  # s; times closer to a limit than this lie within it


@dataclass(frozen=True)
class Groups:
    """F fixes of N packets, in the order of tags and, within a tag, of time.

    code (N,): the number of each packet's fix. tag (F,): numbers in Packets.tags. name (F,): the
    fix's name in the log, or its sequence number, or its number within its tag from 0. time (N,) s,
    by one clock, NaN = unknown.
    """

    code: np.ndarray
    tag: np.ndarray
    name: np.ndarray
    time: Array
    notes: tuple[str, ...] = ()

    @property
    def count(self) -> int:
        """The number of fixes F."""
        return len(self.tag)


def grouped(packets: Packets, window_s: float, windows: str) -> Groups:
    """Return the fixes of `packets`.

    Raises BadValue for windows in a log without complete times.
    """
    key = packets.fix if packets.fix is not None else packets.sequence
    time, notes = _one_clock(packets, key)
    complete = bool(np.isfinite(time).all())
    if packets.fix is not None:
        return _ordered(packets, packets.fix, time, complete, notes)
    if window_s > 0 or packets.sequence is None:
        if not complete:
            allowed = "0, for a log without complete times; its sequence numbers make the fixes"
            raise BadValue("window_s", window_s, allowed)
        return _ordered(packets, _windowed(packets.tag, time, window_s, windows), time, True, notes)
    again = _occurrence(packets, time if complete else None)
    number = _ranks(packets.sequence)
    notes += () if complete else _far_apart(packets)
    return _ordered(packets, again * (number.max() + 1) + number, time, complete, notes)


def tracks(groups: Groups, time: Array, gap_s: float | None) -> np.ndarray:
    """The number (F,) of each fix's track; a silence longer than `gap_s` starts another one.

    time (F,) s of the fixes, NaN = unknown.
    """
    new = np.diff(groups.tag, prepend=-1) != 0
    if gap_s is not None:
        with np.errstate(invalid="ignore"):
            new[1:] |= np.diff(time) > gap_s
    return np.cumsum(new) - 1


def _one_clock(packets: Packets, key: np.ndarray | None) -> tuple[Array, tuple[str, ...]]:
    """Times (N,) s by one clock, NaN = unknown, and a remark if the anchors' clocks differed."""
    if packets.time is None:
        return np.full(packets.count, np.nan), ()
    own = packets.own_clocks and np.ptp(packets.anchor) > 0
    if key is None:
        if own:
            raise BadValue("columns.sequence", None, _INCOMPARABLE.format(packets.table.path))
        return packets.time, ()
    key = _ranks(key)
    event = packets.tag * (key.max() + 1) + key
    if packets.fix is not None:
        pairs = np.unique(event * (packets.anchor.max() + 1) + packets.anchor)
        if 2 * len(pairs) < packets.count:  # many packets of an anchor in a fix tell no offset
            return np.where(own, np.nan, packets.time), ()
    found = aligned(packets.time, packets.anchor, event)
    time = np.where(found.apart, np.nan, found.time) if own else found.time
    if not found.offset:
        return time, ()
    return time, (
        f"{packets.table.path}: the anchors' clocks differ by up to {found.offset:.4g} s; their "
        "times are made comparable by the fixes or sequence numbers that anchors share",
    )


def _far_apart(packets: Packets) -> tuple[str, ...]:
    """A remark if sequence numbers of a tag, which order its fixes, have a gap as after an
    overflow.
    """
    assert packets.sequence is not None
    for tag in range(len(packets.tags)):
        distinct = np.unique(packets.sequence[packets.tag == tag])
        gap = int(np.argmax(np.diff(distinct))) if len(distinct) > 1 else 0
        if len(distinct) > 1 and distinct[gap + 1] - distinct[gap] > OVERFLOW:
            words = (
                f"{packets.table.path}: no number is between {distinct[gap]} and "
                f"{distinct[gap + 1]}, as after an overflow, and numbers alone order the fixes; a "
                "column of times (scenario.columns.time) orders them better"
            )
            return (words,)
    return ()


def _ranks(values: np.ndarray) -> np.ndarray:
    """Each value's rank (N,) among the distinct values, from 0."""
    ranks: np.ndarray = np.unique(values, return_inverse=True)[1].ravel()
    return ranks


def _windowed(tag: np.ndarray, time: Array, window_s: float, windows: str) -> np.ndarray:
    """The number (N,) of each packet's window, apart for each tag."""
    slack = min(ROUNDING_S, window_s / 1000)
    if windows == "grid" and window_s > 0:
        return np.floor((time + slack) / window_s).astype(np.int64)
    order = np.lexsort((time, tag))
    new = np.diff(tag[order], prepend=-1) != 0
    gap = np.diff(time[order], prepend=time[order[0]])
    new |= gap > (window_s + slack)
    if windows == "first" and window_s > 0:
        new = _greedy(time[order], new, window_s + slack)
    code = np.empty(len(tag), dtype=np.int64)
    code[order] = np.cumsum(new)
    return code


def _greedy(time: Array, new: np.ndarray, width: float) -> np.ndarray:
    """Mark the packets (N,) that start a fix, given those that start one after a silence."""
    starts = new.copy()
    bounds = np.append(np.flatnonzero(new), len(time))
    long = time[bounds[1:] - 1] - time[bounds[:-1]] > width
    ordered = time.tolist()
    for begin, end in zip(bounds[:-1][long].tolist(), bounds[1:][long].tolist()):
        while (begin := bisect_right(ordered, ordered[begin] + width, begin, end)) < end:
            starts[begin] = True
    return starts


def _occurrence(packets: Packets, time: Array | None) -> np.ndarray:
    """How often (N,) each packet's sequence number came before, from 0.

    By times if there are any, else by the order of an anchor's rows: a number that an anchor has
    already given, after another number, starts the count again.
    """
    assert packets.sequence is not None
    if time is None:
        return _restarts(packets.tag, packets.anchor, packets.sequence)
    order = np.lexsort((time, packets.sequence, packets.tag))
    tag, sequence = packets.tag[order], packets.sequence[order]
    first = (np.diff(tag, prepend=-1) != 0) | (np.diff(sequence, prepend=sequence[0] - 1) != 0)
    later = ~first & (np.diff(time[order], prepend=0.0) > EVENT_S)
    count = np.cumsum(later)
    found = np.empty(packets.count, dtype=np.int64)
    found[order] = count - np.maximum.accumulate(np.where(first, count, 0))
    return found


def _restarts(tag: np.ndarray, anchor: np.ndarray, sequence: np.ndarray) -> np.ndarray:
    """How often (N,) the count of a tag's numbers at an anchor started again before each row."""
    order = np.lexsort((anchor, tag))
    rows = np.stack([tag[order], anchor[order], sequence[order]], axis=1)
    moved = np.any(np.diff(rows, axis=0, prepend=rows[:1] - 1) != 0, axis=1)
    found = np.zeros(len(order), dtype=np.int64)
    distinct = np.unique(rows, axis=0)
    if len(distinct) < moved.sum():
        stream, times = None, 0
        seen: set[int] = set()
        for place, (t, a, number), other in zip(order.tolist(), rows.tolist(), moved.tolist()):
            if (t, a) != stream:
                stream, times, seen = (t, a), 0, set()
            elif other and number in seen:
                times, seen = times + 1, set()
            seen.add(number)
            found[place] = times
    return found


def _ordered(
    packets: Packets, key: np.ndarray, time: Array, complete: bool, notes: tuple[str, ...]
) -> Groups:
    """The fixes of packets whose numbers `key` (N,) are equal within a tag."""
    key = _ranks(key)
    both = packets.tag * (key.max() + 1) + key
    _, first, code = np.unique(both, return_index=True, return_inverse=True)
    tag = packets.tag[first]
    mean = np.bincount(code, time) / np.bincount(code)
    rank = mean if complete else _rank(packets, key[first], first)
    order = np.lexsort((first, rank, tag))
    place = np.empty(len(order), dtype=np.int64)
    place[order] = np.arange(len(order))
    if len(tag) == len(packets.tags) and packets.count > 2 * len(tag) * len(set(packets.anchor)):
        notes += (f"{packets.table.path}: all rows of a tag make one fix; {_FEWER}",)
    return Groups(place[code], tag[order], _names(packets, first[order], tag[order]), time, notes)


def _rank(packets: Packets, key: np.ndarray, first: np.ndarray) -> np.ndarray:
    """What orders fixes (F,) without times: sequence numbers or numbers of fixes, else the rows."""
    if packets.fix is None:
        return key
    if all(name.isdecimal() for name in packets.fixes):
        return np.array([int(name) for name in packets.fixes], dtype=float)[key]
    return first


def _names(packets: Packets, first: np.ndarray, tag: np.ndarray) -> np.ndarray:
    """The names (F,) of fixes in their order; `first` (F,) are their first packets."""
    if packets.fix is not None:
        return np.array(packets.fixes, dtype=object)[packets.fix[first]]
    if packets.sequence is not None:
        return packets.sequence[first].astype(str).astype(object)
    begin = np.searchsorted(tag, tag)
    return (np.arange(len(tag)) - begin).astype(str).astype(object)
