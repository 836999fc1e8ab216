"""The measurements of fixes from those of their packets, where an anchor has several in a fix.

error              refuse packets that differ
each               keep all, each packet in a column of its own
first, last        keep one, by time, else by the order of rows
median, mean       circular for angles; deviations are averaged and not divided by the root of
                   the number of packets, because most of an angle's error stays at a place
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aoabench.devices.tracks.grouping import Groups
from aoabench.devices.tracks.packets import Packets
from aoabench.devices.tracks.poses import POSE
from aoabench.errors import BadValue
from aoabench.maths.geometry import Array, wrap
from aoabench.types import Measurements

COMBINE = ("error", "each", "first", "last", "median", "mean")
DISTINCT = "distinct"  # each, but equal ones once: of a stream, which an error would end
_ADVICE = (
    "one row per anchor in each fix, or scenario.combine=median, mean or each, which use all rows; "
    "scenario.columns.tag keeps tags apart, and a shorter scenario.window_s makes more fixes"
)
SAME_M = 0.5  # m; true positions of a fix that differ by more are reported
MOST_CELLS = 2**27
POSE_CELLS = 16  # the numbers of a packet with its pose
ROWS = ("error", "first", "last")
ANGLES = ("azimuth", "elevation")


@dataclass(frozen=True)
class Combined:
    """The measurements (F, C) of fixes, and the anchor (C,) of each column; per fix the mean time
    (F,) s of its packets and the mean true position (F, 3) m of those used, NaN = unknown, and the
    number (F,) of its packets, used or not; remarks to print. poses: arrays (F, C) under the names
    POSE, NaN where nothing was measured; {} for anchors that stand still.
    """

    measured: Measurements
    columns: np.ndarray
    time: Array
    truth: Array
    packets: np.ndarray
    notes: tuple[str, ...]
    poses: dict[str, Array]


def combined(packets: Packets, groups: Groups, anchors: int, combine: str) -> Combined:
    """Return the fixes' measurements by `anchors` anchors.

    Raises BadValue for packets of one anchor in a fix that differ, if `combine` is `error`, and for
    a table that would not fit into memory.
    """
    pair = groups.code * anchors + packets.anchor
    order = _order(packets, groups.time, pair, combine)
    pair = pair[order]
    new = np.diff(pair, prepend=-1) != 0
    if combine == "error":
        _check_equal(packets, order, new)
    keep = {"error": new, "first": new, "last": np.append(new[1:], True)}.get(combine)
    if combine == DISTINCT:
        keep = _distinct(packets, pair, order)
        new = np.diff(pair[keep], prepend=-1) != 0
    used = order if keep is None else order[keep]
    columns, column = np.arange(anchors), packets.anchor[used]
    values, moved = _measured({name: value[used] for name, value in packets.values.items()}), 0.0
    if combine in ("each", DISTINCT):
        columns, column = _each(packets, groups, used, new, anchors)
    elif keep is None:
        values, moved = _averaged(values, np.cumsum(new) - 1, combine)
        column = column[new]
    rows = groups.code[used] if keep is not None or combine == "each" else groups.code[used][new]
    arrays = {name: np.full((groups.count, len(columns)), np.nan) for name in values}
    for name, value in values.items():
        arrays[name][rows, column] = value
    code = groups.code[used]
    truth, spread = _centres(packets.truth[used], code, groups.count)
    poses = {name: arrays.pop(name) for name in POSE if name in arrays}
    return Combined(
        Measurements(**arrays),
        columns,
        _means(groups.time[order], groups.code[order], groups.count),
        truth,
        np.bincount(groups.code, minlength=groups.count),
        _notes(packets, len(used), spread, moved),
        poses,
    )


def _order(packets: Packets, time: Array, pair: np.ndarray, combine: str) -> np.ndarray:
    """The packets (N,) sorted by fix and anchor, by time, and then by their values, so that the
    order of rows does not matter; it decides only which one is first or last in a log without
    times.
    """
    alike = () if combine in ROWS and np.isnan(time).any() else tuple(packets.values.values())
    return np.lexsort((*alike, time, pair))


def _distinct(packets: Packets, pair: np.ndarray, order: np.ndarray) -> np.ndarray:
    """Whether packets (N,), in the `order` of their pairs (N,) of fix and anchor, are the first of
    their pair with their values.
    """
    values = [value[order] for value in packets.values.values()]
    alike = np.lexsort((*values, pair))  # stable: the first of equal ones stays the first
    repeated = np.diff(pair[alike], prepend=-1) == 0
    for value in (value[alike] for value in values):
        same = (value[1:] == value[:-1]) | (np.isnan(value[1:]) & np.isnan(value[:-1]))
        repeated[1:] &= same
    found = np.empty(len(pair), dtype=bool)
    found[alike] = ~repeated
    return found


def _check_equal(packets: Packets, order: np.ndarray, new: np.ndarray) -> None:
    """Raise BadValue for packets of one anchor in a fix that differ."""
    if new.all():
        return
    first = order[np.maximum.accumulate(np.where(new, np.arange(len(new)), 0))]
    for value in packets.values.values():
        one, other = value[first], value[order]
        differs = np.flatnonzero((one != other) & ~(np.isnan(one) & np.isnan(other)))
        if len(differs):
            rows = sorted((int(first[differs[0]]), int(order[differs[0]])))
            cells = [name for name in ("anchor", "azimuth") if name in packets.table.names]
            shown = ", ".join(packets.table.at(row, *cells) for row in rows)
            raise packets.table.bad(f"{_ADVICE}; {shown}")


def _each(
    packets: Packets, groups: Groups, used: np.ndarray, new: np.ndarray, anchors: int
) -> tuple[np.ndarray, np.ndarray]:
    """The anchor (C,) of each column, and the column (N,) of each packet: as many columns for an
    anchor as it has packets in one fix at most.
    """
    anchor, place = packets.anchor[used], np.arange(len(used))
    nth = place - np.maximum.accumulate(np.where(new, place, 0))
    most = np.zeros(anchors, dtype=np.int64)
    np.maximum.at(most, anchor, nth + 1)
    most = np.maximum(most, 1)
    weight = POSE_CELLS if POSE[0] in packets.values else 1
    if groups.count * int(most.sum()) * weight > MOST_CELLS:
        allowed = (
            f"mean or median for this log: one fix has {most.max()} packets of an anchor, and "
            f"{groups.count} fixes with a column for each are too many cells"
        )
        raise BadValue("combine", "each", allowed)
    start = np.cumsum(most) - most
    return np.repeat(np.arange(anchors), most), start[anchor] + nth


def _measured(values: dict[str, Array]) -> dict[str, Array]:
    """The values (N,) with a NaN as the pose of a packet that measured nothing."""
    if POSE[0] not in values:
        return values
    seen = [np.isfinite(values[name]) for name in (*ANGLES, "delay") if name in values]
    heard = np.any(seen, axis=0)
    return values | {name: np.where(heard, values[name], np.nan) for name in POSE}


def _averaged(
    values: dict[str, Array], group: np.ndarray, combine: str
) -> tuple[dict[str, Array], float]:
    """The mean or median of each group of rows (N,), which are sorted by group, by name; of poses
    the mean. And the largest extent in m of a group's poses in x or y.
    """
    count = int(group[-1]) + 1
    middle = _medians if combine == "median" else _means
    found, moved = {}, 0.0
    for name, value in values.items():
        if name in ANGLES:
            found[name] = _circular(value, group, count, combine == "median")
        elif name not in POSE:
            found[name] = middle(value, group, count)
    if POSE[0] in values:
        place, moved = _centres(np.stack([values[n] for n in POSE[:3]], axis=-1), group, count)
        facing = _circular(values[POSE[3]], group, count, False)
        found |= dict(zip(POSE, (*place.T, facing)))
    return found, moved


def _circular(value: Array, group: np.ndarray, count: int, median: bool) -> Array:
    """The circular means or medians (count,) rad of groups of angles (N,) rad, NaN for a group
    without any; exact where a group has one angle.
    """
    sine, cosine = (_means(f(value), group, count) for f in (np.sin, np.cos))
    centre = np.arctan2(sine, cosine)
    if median:
        centre = wrap(centre + _medians(wrap(value - centre[group]), group, count))
    low, high = _extent(value, group, count)
    return np.where(low == high, low, centre)


def _means(value: Array, group: np.ndarray, count: int) -> Array:
    """The means (count,) of groups of numbers (N,), NaN for a group without any."""
    known = np.isfinite(value)
    number = np.bincount(group[known], minlength=count)
    total = np.bincount(group[known], value[known], minlength=count)
    return np.where(number > 0, total / np.maximum(number, 1), np.nan)


def _medians(value: Array, group: np.ndarray, count: int) -> Array:
    """The medians (count,) of groups of numbers (N,), NaN for a group without any."""
    known = np.isfinite(value)
    value, group = value[known], group[known]
    value = value[np.lexsort((value, group))]
    number = np.bincount(group, minlength=count)
    start = np.cumsum(number) - number
    found = np.full(count, np.nan)
    some = number > 0
    low, high = ((start + (number - k) // 2)[some] for k in (1, 0))
    found[some] = (value[low] + value[np.minimum(high, len(value) - 1)]) / 2
    return found


def _extent(value: Array, group: np.ndarray, count: int) -> tuple[Array, Array]:
    """The least and the largest number (count,) of groups of numbers (N,), NaN counting as none;
    inf and -inf for a group without any.
    """
    known = np.isfinite(value)
    low, high = np.full(count, np.inf), np.full(count, -np.inf)
    np.minimum.at(low, group[known], value[known])
    np.maximum.at(high, group[known], value[known])
    return low, high


def _centres(truth: Array, code: np.ndarray, count: int) -> tuple[Array, float]:
    """The mean positions (count, 3) m of groups, and the largest extent of a group's in x or y;
    exact where a group's packets have one position.
    """
    found, spread = np.empty((count, 3)), 0.0
    for axis in range(3):
        low, high = _extent(truth[:, axis], code, count)
        mean = _means(truth[:, axis], code, count)
        found[:, axis] = np.where(low == high, low, mean)
        spread = max(spread, float(np.max(high - low, initial=0.0)) if axis < 2 else 0.0)
    return found, spread


def _notes(packets: Packets, used: int, spread: float, moved: float) -> tuple[str, ...]:
    """Remarks on packets that are not used, and on true positions and receivers that move within a
    fix.
    """
    notes, path = [], packets.table.path
    if lost := packets.count - used:
        notes.append(
            f"{path}: {lost} of {packets.count} rows not used: further rows of an anchor in a fix "
            "(scenario.combine)"
        )
    if spread > SAME_M:
        notes.append(
            f"{path}: true positions within a fix differ by up to {spread:.3g} m; the mean counts"
        )
    if moved > SAME_M:
        notes.append(
            f"{path}: receivers move by up to {moved:.3g} m within a fix, and the mean pose "
            "counts; scenario.combine=each takes each packet where it was measured"
        )
    return tuple(notes)
