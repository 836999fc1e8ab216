"""Packets: what a log holds, a row for each measurement of one tag by one anchor."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from aoabench.devices.anchors import AnchorsFile
from aoabench.devices.geodesy import Origin, local_positions
from aoabench.devices.readers.sources import natural
from aoabench.devices.readers.table import Table
from aoabench.devices.tracks import log
from aoabench.devices.tracks.moments import slow_times, times
from aoabench.devices.tracks.poses import read_poses
from aoabench.errors import BadValue, did_you_mean, listed
from aoabench.maths.geometry import Array

TRUE_METRES, TRUE_DEGREES = ("x", "y", "z"), ("truth_lat", "truth_lon", "truth_height")


@dataclass(frozen=True)
class Packets:
    """N packets in the order of the log's rows, in aoabench's conventions.

    anchor (N,): the anchor's number in the file of anchors, from 0. values: arrays (N,) under the
    names of Measurements, in rad, s and dBm, NaN = not measured, and in a log of receivers that
    move under the names `poses.POSE`. tag (N,): numbers in `tags`, the
    tags' names in natural order (T2 before T10); one tag, "", in a log without tags. fix (N,):
    numbers in `fixes`, the names of fixes that the log states, or None. time (N,) s, or None in a
    log without times. sequence (N,): the device's sequence numbers, or None. truth (N, 3) m, NaN =
    unknown. table: the rows, for messages. own_clocks: whether the times of each anchor are by a
    clock of its own.
    """

    anchor: np.ndarray
    values: Mapping[str, Array]
    tag: np.ndarray
    tags: tuple[str, ...]
    fix: np.ndarray | None
    fixes: tuple[str, ...]
    time: Array | None
    sequence: np.ndarray | None
    truth: Array
    table: Table
    own_clocks: bool = False

    @property
    def count(self) -> int:
        """The number of packets N."""
        return len(self.anchor)

    def where(self, keep: np.ndarray) -> Packets:
        """The packets where `keep` (N,) is True."""
        if keep.all():
            return self
        return replace(
            self,
            anchor=self.anchor[keep],
            values={name: value[keep] for name, value in self.values.items()},
            tag=self.tag[keep],
            fix=None if self.fix is None else self.fix[keep],
            time=None if self.time is None else self.time[keep],
            sequence=None if self.sequence is None else self.sequence[keep],
            truth=self.truth[keep],
            table=self.table.where(keep),
        )

    def of_tags(self, tags: Sequence[str]) -> Packets:
        """The packets of `tags`; raises BadValue for a tag that the log lacks."""
        if self.tags == ("",):
            allowed = "null: this log has no tags; scenario.columns.tag names their column"
            raise BadValue("tags", list(tags), allowed)
        for tag in tags:
            if tag not in self.tags:
                allowed = f"a list of tags of {self.table.path}: {listed(self.tags)}"
                raise BadValue("tags", list(tags), allowed + did_you_mean(tag, self.tags))
        wanted = np.array([tag in tags for tag in self.tags])
        found = self.where(wanted[self.tag])
        number = np.cumsum(wanted) - 1
        names = tuple(tag for tag in self.tags if tag in tags)
        return replace(found, tag=number[found.tag], tags=names)


@dataclass(frozen=True)
class Given:
    """How rows become packets: parameters of the same names of a recorded scenario."""

    conventions: log.Conventions
    time_unit: str
    rssi_absent: Sequence[float]
    range_sigma_m: float | None
    unknown_anchors: str


def read_packets(table: Table, known: AnchorsFile, given: Given) -> tuple[Packets, list[str]]:
    """Return the packets of a log's rows by the `known` anchors, and remarks to print.

    Raises BadValue for a row that breaks the declared conventions.
    """
    strict = given.unknown_anchors == "error"
    table, anchor, notes = log.known_anchors(table, known.ids, strict)
    table, anchor, poses, lost = _placed(table, anchor, known)
    numbered = "fix" in table.names
    time = _times(table, given, anchor, known.clock_offset_s)
    values = log.angles(table, given.conventions)
    rssi, about_rssi = log.strengths(table, given.rssi_absent)
    delays, about_ranges = log.ranges(table, given.range_sigma_m)
    values |= ({} if rssi is None else {"rssi": rssi}) | delays | poses
    tag, tags = (
        names_of(table, "tag") if "tag" in table.names else (np.zeros(len(anchor), int), [""])
    )
    fix, fixes = table.texts("fix") if numbered else (None, [])
    notes += [*lost, *about_rssi, *about_ranges, *log.doubts(table, given.conventions.azimuth_unit)]
    notes += slow_times(table, time, given.time_unit)
    own = "time" not in table.names and known.clock_offset_s is None
    packets = Packets(
        anchor=anchor,
        values=values,
        tag=tag,
        tags=tuple(tags),
        fix=fix,
        fixes=tuple(fixes),
        time=time,
        sequence=_sequence(table),
        truth=_truth(table, known.origin),
        table=table,
        own_clocks=own,
    )
    return packets, notes


def _placed(
    table: Table, anchor: np.ndarray, known: AnchorsFile
) -> tuple[Table, np.ndarray, dict[str, Array], list[str]]:
    """The rows whose anchor's pose is known, the number (N,) and the pose of each row's anchor, and
    a remark on the rows left out.
    """
    poses, usable = read_poses(table, anchor, known)
    if usable.all():
        return table, anchor, poses, []
    if not usable.any():
        raise table.bad("at least one row with the pose of its receiver")
    notes = [f"{table.path}: {(~usable).sum()} rows without the pose of their receiver left out"]
    kept = {name: value[usable] for name, value in poses.items()}
    return table.where(usable), anchor[usable], kept, notes


def _times(table: Table, given: Given, anchor: np.ndarray, offset: Array | None) -> Array | None:
    """Times (N,) s less the offsets (B,) s of the anchors' clocks, or None without a column of
    times.

    Where offsets are known, the anchors' own clocks are preferred to the host's.
    """
    partly = any(name in table.names for name in ("fix", "sequence"))
    columns = ("time", "anchor_time") if offset is None else ("anchor_time", "time")
    column = next((name for name in columns if name in table.names), None)
    if column is None:
        return None
    time = times(table, column, given.time_unit, complete=not partly)
    return time if offset is None else time - offset[anchor]


def names_of(table: Table, column: str) -> tuple[np.ndarray, list[str]]:
    """A column as numbers (N,) of its distinct texts, and the texts in natural order."""
    code, names = table.texts(column)
    order = sorted(range(len(names)), key=lambda i: natural(names[i]))
    rank = np.empty(len(names), dtype=int)
    rank[order] = np.arange(len(names))
    return rank[code], [names[i] for i in order]


def _sequence(table: Table) -> np.ndarray | None:
    """The sequence numbers (N,), or None without such a column."""
    if "sequence" not in table.names:
        return None
    value = table.numbers("sequence", empty=False)
    wrong = (value != np.rint(value)) | (np.abs(value) > 2.0**53)
    table.check("sequence", wrong, f"whole numbers in {table.names['sequence']}")
    return value.astype(np.int64)


def _truth(table: Table, origin: Origin | None) -> Array:
    """True positions (N, 3) m, NaN where a row has none."""
    nothing, geodetic = np.full(table.count, np.nan), TRUE_DEGREES[0] in table.names
    axes = TRUE_DEGREES if geodetic else TRUE_METRES
    found = np.stack([table.numbers(a) if a in table.names else nothing for a in axes], axis=-1)
    if geodetic:
        found = local_positions(table.key, str(table.path), found, origin)
    found[np.isnan(found[:, :2]).any(axis=1)] = np.nan
    return found


def check_truth(chosen: Mapping[str, str], path: object) -> list[str]:
    """The columns of true positions among those `chosen`, which maps aoabench's names to the log's;
    BadValue for a latitude or longitude alone, and for positions both in degrees and in m.
    """
    degrees, metres = ([a for a in axes if a in chosen] for axes in (TRUE_DEGREES, TRUE_METRES))
    for name in TRUE_DEGREES[:2] if degrees else ():
        if name not in chosen:
            allowed = f"a column, by default called {name}_deg, because {path} has "
            raise BadValue(f"columns.{name}", None, f"{allowed}{chosen[degrees[0]]}")
    if degrees and metres:
        both = f"{chosen[metres[0]]} and {chosen[degrees[0]]}"
        raise BadValue(
            f"columns.{degrees[0]}", chosen[degrees[0]], f"one of {both}; {path} has both"
        )
    return [chosen[name] for name in (*metres, *degrees)]
