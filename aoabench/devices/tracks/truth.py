"""True positions in a file of their own, brought to the packets of a log.

Each row has a position, x, y and, where known, z, in m or by the columns' names in cm or mm, and

    time              an instant: positions between two instants are interpolated linearly
    start, end        a mark: the position holds from its start to its end
    fix or sequence   the fix, or the packets' sequence number, that the position belongs to

and, where the file is of several tags, the tag. `time_s`, `start_ms` and so on state their units;
times without one are in the log's. Dates and times are in ISO 8601. The file may be GPX.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from aoabench.devices.anchors import AnchorsFile
from aoabench.devices.geodesy import degree_columns, local_positions
from aoabench.devices.readers.columns import header, shown_columns
from aoabench.devices.readers.table import Table
from aoabench.devices.tracks.moments import SECONDS, times
from aoabench.devices.tracks.packets import Packets
from aoabench.errors import BadValue, did_you_mean
from aoabench.maths.geometry import Array

SAME_M = 1e-3
METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001}
WORDS = {
    "time": ("time", "timestamp", "t", "instant"),
    "start": ("start", "begin", "from", "start_time", "time_start"),
    "end": ("end", "stop", "to", "end_time", "time_end"),
    "tag": ("tag", "tag_id"),
    "fix": ("fix",),
    "sequence": ("sequence",),
    "x": ("x", "x_true"),
    "y": ("y", "y_true"),
    "z": ("z", "z_true"),
}
SCHEMA = (
    "a file of true positions with the columns x_m, y_m and, where known, z_m (or x_cm, ...), "
    "and time_s, or start_s and end_s, or fix, or sequence (or time_ms, ...); tag where there are "
    "several"
)


@dataclass(frozen=True)
class Truth:
    """M true positions (M, 3) m from a file. tag (M,): names, or None for any tag. start, end (M,)
    s: the interval in which a position holds, equal for an instant, or None; key (M,): names of
    fixes or sequence numbers, or None. table: the rows, for messages.
    """

    position: Array
    tag: np.ndarray | None
    start: Array | None
    end: Array | None
    key: np.ndarray | None
    table: Table

    def at(self, packets: Packets, gap_s: float, offset_s: float) -> tuple[Array, list[str]]:
        """Return the true positions (N, 3) m at the packets, NaN where unknown, and remarks.

        Positions of two instants more than `gap_s` apart are not interpolated; `offset_s` is added
        to the file's times. Raises BadValue if no packet has a position.
        """
        found = np.full((packets.count, 3), np.nan)
        for number, name in enumerate(packets.tags):
            mine = np.flatnonzero(packets.tag == number)
            rows = (
                np.arange(len(self.position))
                if self.tag is None
                else np.flatnonzero(self.tag == name)
            )
            if self.key is not None:
                found[mine] = self._by_key(packets, mine, rows)
            elif packets.time is None:
                raise self.table.bad("one with the column fix or sequence, for a log without times")
            elif len(rows):
                found[mine] = self._by_time(packets.time[mine] - offset_s, rows, gap_s)
        known = int(np.isfinite(found[:, 0]).sum())
        if not known:
            raise self._nowhere(packets, offset_s)
        if known == packets.count:
            return found, []
        line = f"{self.table.path}: true positions at {known} of {packets.count} rows"
        return found, [line + " (scenario.truth_gap_s)" * (self.key is None)]

    def _by_key(self, packets: Packets, mine: np.ndarray, rows: np.ndarray) -> Array:
        """Positions (K, 3) m of packets by the names of their fixes or by sequence numbers."""
        assert self.key is not None
        place = {str(key): row for key, row in zip(self.key[rows].tolist(), rows.tolist())}
        if packets.fix is not None and "fix" in self.table.names:
            row = np.array([place.get(name, -1) for name in packets.fixes])[packets.fix[mine]]
        elif packets.sequence is not None and "sequence" in self.table.names:
            distinct, code = np.unique(packets.sequence[mine], return_inverse=True)
            row = np.array([place.get(str(one), -1) for one in distinct.tolist()])[code]
        else:
            raise self.table.bad("one with times, or with the column that numbers the log's fixes")
        return np.where(row[:, None] >= 0, self.position[row], np.nan)

    def _by_time(self, time: Array, rows: np.ndarray, gap_s: float) -> Array:
        """Positions (K, 3) m at times (K,) by the file's clock, from some of its rows."""
        assert self.start is not None
        assert self.end is not None
        rows = rows[np.argsort(self.start[rows], kind="stable")]
        start, end = self.start[rows], self.end[rows]
        last = np.searchsorted(start, time, side="right") - 1
        before = np.maximum(last, 0)
        held = (last >= 0) & (time <= end[before])
        found = np.where(held[:, None], self.position[rows][before], np.nan)
        instant = np.flatnonzero(start == end)
        if len(instant) > 1:
            between = _interpolated(time, start[instant], self.position[rows[instant]], gap_s)
            found = np.where(held[:, None], found, between)
        return found

    def _nowhere(self, packets: Packets, offset_s: float) -> BadValue:
        """The error for truth that no packet has."""
        allowed = f"a file with a true position at a packet of {packets.table.path}"
        if self.start is None or self.end is None or packets.time is None:
            return self.table.bad(f"{allowed}; no fix of the log occurs in it")
        known = packets.time[np.isfinite(packets.time)]
        spans = [
            f"{name} has times from {low:.10g} to {high:.10g} s"
            for name, low, high in (
                ("it", self.start.min() + offset_s, self.end.max() + offset_s),
                ("the log", known.min(initial=np.inf), known.max(initial=-np.inf)),
            )
        ]
        advice = "scenario.truth_offset_s shifts its clock, scenario.truth_gap_s bridges gaps"
        return self.table.bad(f"{allowed}; {', '.join(spans)}; {advice}")


def _interpolated(time: Array, known: Array, position: Array, gap_s: float) -> Array:
    """Positions (K, 3) at times (K,) between those (M, 3) at increasing times (M,), NaN outside and
    in gaps above `gap_s`, unless both ends have one position.
    """
    after = np.clip(np.searchsorted(known, time, side="left"), 1, len(known) - 1)
    step = known[after] - known[after - 1]
    stays = np.nanmax(np.abs(position[after] - position[after - 1]), axis=1) < SAME_M
    inside = (time >= known[0]) & (time <= known[-1]) & (stays | (step <= gap_s + 1e-9))
    share = np.divide(time - known[after - 1], step, out=np.zeros_like(step), where=step > 0)
    share = np.where(inside, share, np.nan)[:, None]
    found: Array = (1 - share) * position[after - 1] + share * position[after]
    return found


def read_truth(
    key: str,
    path: str,
    time_unit: str,
    anchors: AnchorsFile,
    named: Mapping[str, str] | None = None,
    timed: bool = True,
) -> Truth:
    """Return the true positions of a file; raises BadValue for one that is not as in the schema.

    With `timed` false, a file may lack times and names: its positions are in the order of its rows.
    A column without a known name that has the log's, `named`, is read as that. Latitudes and
    longitudes are converted to local coordinates at the origin of `anchors`.
    """
    present = header(key, path)
    degrees = degree_columns(present)
    names, scale = _recognised(key, path, present, degrees, timed, named or {})
    table = Table.read(key, path, names)
    position = np.stack([
        scale[axis] * table.numbers(axis) if axis in names else np.full(len(table.frame), np.nan)
        for axis in "xyz"
    ], axis=-1)  # fmt: skip
    if degrees is None:
        anchors.check_local(f"the true positions of {path} are local")
    else:
        position = local_positions(key, path, position, anchors.origin)
    known = np.isfinite(position[:, :2]).all(axis=1)
    table, position = table.where(known), position[known]
    if not len(position):
        raise table.bad("a file with at least one true position")
    tag = (
        np.array(table.texts("tag")[1], dtype=object)[table.texts("tag")[0]]
        if "tag" in names
        else None
    )
    return _placed(table, position, tag, names, time_unit, timed)


def _placed(
    table: Table,
    position: Array,
    tag: np.ndarray | None,
    names: Mapping[str, str],
    time_unit: str,
    timed: bool,
) -> Truth:
    """The true positions with the times, or the names of fixes or packets, of the rows of a table;
    with `timed` false, with times alone, if it has them.
    """
    kinds = ("start", "time", "fix", "sequence") if timed else ("start", "time")
    which = next((one for one in kinds if one in names), "")
    if not which:
        return Truth(position, tag, None, None, None, table)
    if which in ("fix", "sequence"):
        code, texts = table.texts(which)
        return Truth(position, tag, None, None, np.array(texts, dtype=object)[code], table)
    start = _moments(table, which, names[which], time_unit)
    end = (
        _moments(table, "end", names["end"], time_unit)
        if which == "start" and "end" in names
        else start
    )
    end = np.where(np.isnan(end), start, end)
    table.check("end" if "end" in names else which, end < start, "an end after its start")
    return Truth(position, tag, start, end, None, table)


def _moments(table: Table, column: str, name: str, time_unit: str) -> Array:
    """A column of times (M,) s in the unit that its name states, else in `time_unit`."""
    unit = _split(name, tuple(SECONDS))[1] or time_unit
    return times(table, column, unit, complete=column != "end")


def _recognised(
    key: str,
    path: str,
    present: Sequence[str],
    degrees: tuple[str, str, str | None] | None,
    timed: bool,
    named: Mapping[str, str],
) -> tuple[dict[str, str], dict[str, float]]:
    """The file's names of the columns to read, and the axes' units in m."""
    names: dict[str, str] = {}
    scale: dict[str, float] = {}
    if degrees is not None:
        names = {axis: name for axis, name in zip("xyz", degrees) if name is not None}
        scale = dict.fromkeys("xyz", 1.0)
    for ours, words in WORDS.items():
        if degrees is not None and ours in "xyz":
            continue
        units = tuple(METRES) if ours in "xyz" else tuple(SECONDS)
        fits = [one for one in present if _split(one, units)[0] in words]
        fits = fits or [one for one in present if one == named.get(ours)]
        if len(fits) > 1:
            raise BadValue(key, path, f"{SCHEMA}; it has {shown_columns(fits)}: which is {ours}?")
        if fits:
            names[ours] = fits[0]
            scale[ours] = METRES.get(_split(fits[0], units)[1], 1.0)
    known = any(one in names for one in ("time", "start", "fix", "sequence"))
    if "x" not in names or "y" not in names or (timed and not known):
        lacks = "x_m" if "x" not in names else "y_m" if "y" not in names else "time_s"
        more = "; or with the log's names of these columns" if named else ""
        near = did_you_mean(lacks, present)
        raise BadValue(key, path, f"{SCHEMA}{more}; it has {shown_columns(present)}{near}")
    return names, scale


def _split(name: str, units: Sequence[str]) -> tuple[str, str]:
    """A column's name in lower case without its unit, and the unit, or ''."""
    plain = re.sub(r"[^a-z0-9]+", "_", name.strip().lower()).strip("_")
    word, _, unit = plain.rpartition("_")
    return (word, unit) if word and unit in units else (plain, "")
