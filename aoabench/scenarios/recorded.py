"""A user's own recording: tracks of tags from a log and, if recorded, their true positions.

`devices.tracks` converts a log's columns to aoabench's conventions (`log`) and makes fixes of its
packets (`grouping`, `combining`).
"""

from __future__ import annotations

from contextlib import suppress
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from aoabench import loaded
from aoabench.devices.anchors import AnchorsFile
from aoabench.devices.plans.extent import Thing, check_anchors
from aoabench.devices.readers.formats import opened
from aoabench.devices.readers.plain import plain_rows
from aoabench.devices.readers.reading import Content
from aoabench.devices.readers.table import Table
from aoabench.devices.tracks import identity
from aoabench.devices.tracks.combining import Combined, combined
from aoabench.devices.tracks.grouping import grouped, tracks
from aoabench.devices.tracks.naming import unread
from aoabench.devices.tracks.packets import Given, Packets, read_packets
from aoabench.devices.tracks.poses import placed
from aoabench.devices.tracks.truth import read_truth
from aoabench.errors import BadValue, check_array
from aoabench.loaded import DataFile
from aoabench.maths.geometry import Array
from aoabench.models.motion import motion_of
from aoabench.roles import Motion
from aoabench.scenarios.log_anchors import anchors_of, columns_of, conventions_of
from aoabench.scenarios.log_columns import Columns
from aoabench.scenarios.log_parameters import LogParameters
from aoabench.types import Anchors, Measurements, Tracks

__all__ = ["Columns", "Recorded"]


class Read(NamedTuple):
    """A log's tracks, and remarks to print."""

    tracks: Tracks
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Recorded(LogParameters):
    """A recording: each track of a tag is a replication, and nothing is drawn.

    The fixes of a track are in the order of their times; without times in that of their sequence
    numbers, or of the fixes' numbers, or of their first appearance. Tags are in natural order. The
    file of anchors has the columns x_m, y_m and, where needed, id (else 1, 2, ...), z_m,
    facing_deg, pitch_deg, roll_deg (else 0), clock_offset_s. The angles turn the anchor's axes by
    Rz(facing) Ry(pitch) Rx(roll): facing counter-clockwise from the global +x, pitch > 0 down.
    """

    dt = 1.0
    start_s = None
    shares_positions = True
    replications = 1

    _files = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "motion", motion_of(self.motion))
        if self.heading_deg is not None and (self.measured_by, self.frame) != ("mobile", "own"):
            raise BadValue(
                "heading_deg",
                self.heading_deg,
                "null, unless scenario.measured_by=mobile and scenario.frame=own",
            )
        if self.bounds_m is not None:
            low, high = check_array("bounds_m", self.bounds_m, (2, 2))
            if not np.all(low < high):
                raise BadValue(
                    "bounds_m", self.bounds_m, "the lower corner, then the upper corner, or null"
                )
        with loaded.reading() as files:  # now, so that mistakes are reported at construction
            found = self._read.tracks
        object.__setattr__(self, "_files", files())
        object.__setattr__(self, "dt", 1.0 if self.step_s is None else float(self.step_s))
        object.__setattr__(self, "replications", len(found.counts))
        object.__setattr__(self, "shares_positions", len(found.counts) == 1)
        truth = found.truth
        known = truth[np.isfinite(truth[:, 0])]
        if len(known):
            source = ("path", self.path) if self.truth_file is None else ("truth", self.truth_file)
            target = Thing("true positions", *source, known)
            words, key = "anchors", "anchors"
            if found.poses is not None:
                words, key = "receivers", "path"
            check_anchors(Thing(words, key, getattr(self, key), self.true_anchors.position), target)

    @property
    def files(self) -> tuple[DataFile, ...]:
        """The files that the scenario was read from, as they were then."""
        return self._files

    @property
    def recorded(self) -> Measurements:
        """The measurements (F, C) of all tracks, in aoabench's conventions."""
        return self.tracks.measured

    @property
    def tracks(self) -> Tracks:
        """The recorded tracks, one after the other."""
        return self._read.tracks

    @property
    def notes(self) -> tuple[str, ...]:
        """Lines about the files, to print."""
        return self._read.notes

    @property
    def marks(self) -> np.ndarray:
        """The number (F,) of each fix's true position among the different ones, to 1 mm, from 0;
        -1 where it is unknown.
        """
        truth = np.round(self.tracks.truth[:, :2], 3)
        known = np.isfinite(truth[:, 0])
        found = np.full(len(truth), -1)
        found[known] = np.unique(truth[known], axis=0, return_inverse=True)[1].ravel()
        return found

    @property
    def known_height_m(self) -> float | None:
        """`height_m`; the truth is never a source, so that it moves no position."""
        return self.height_m

    @cached_property
    def true_anchors(self) -> Anchors:
        """The anchors (1, 1, B, ...); with the global axes if the angles are global. If they move,
        (1, F, B, ...), each where its first packet of a fix was measured.
        """
        if (poses := self.tracks.poses) is not None:
            return poses.those(np.unique(self.tracks.columns, return_index=True)[1])
        anchors = self._anchors.anchors
        upright = np.zeros_like(anchors.rotation) + np.eye(3)
        return anchors if self.turns else Anchors(anchors.position, upright)

    def poses_of(self, found: Combined, tag: np.ndarray) -> Anchors | None:
        """The poses (1, F, C, ...) of receivers that move, in fixes of the tags `tag` (F,)."""
        return placed(found.poses, found.columns, tag, self._anchors, not self.turns)

    @property
    def anchors_file(self) -> AnchorsFile:
        """The content of the file of anchors."""
        return self._anchors

    def with_tracks(
        self, tracks: Tracks, start_s: float | None = None, motion: Motion | None = None
    ) -> Recorded:
        """The scenario with other tracks, whose filters start at the time `start_s`, and with
        another motion model.
        """
        found = copy(self)
        vars(found).update(_read=Read(tracks, ()), start_s=start_s, motion=motion)
        if tracks.poses is not None:
            vars(found).pop("true_anchors", None)
        return found

    def offers(self) -> frozenset[str]:
        """The offers of all scenarios, less several anchors if no fix has measurements by two, and
        less motion if the times between fixes are unknown.
        """
        found = self.tracks
        first = np.unique(found.columns, return_index=True)[1]
        heard = np.logical_or.reduceat(np.isfinite(found.measured.azimuth), first, axis=1)
        lone = heard.sum(axis=1).max(initial=0) < 2
        several = {"several_anchors"} if lone and _from_places(found) else set()
        lone &= not several
        unknown = np.isnan(found.time)
        timeless = unknown.any() and (self.step_s is None or not unknown.all())
        less = ({"several_anchors"} if lone else set()) | ({"motion"} if timeless else set())
        return super().offers() - less | several

    def unheard(self) -> BadValue:
        """The error for a log without any measurement."""
        empty = "; every angle is empty, or was taken as not measured (scenario.negative_sigma)"
        return BadValue("path", self.path, f"a file with at least one azimuth or elevation{empty}")

    def truth(self, rng: np.random.Generator) -> Array:
        """Positions (F, 3) m at the fixes of all tracks, NaN where unknown."""
        return self.tracks.truth

    @cached_property
    def _anchors(self) -> AnchorsFile:
        """The anchors (1, 1, B, ...) and their ids as strings."""
        return anchors_of(self)

    @cached_property
    def _read(self) -> Read:
        with_log = self._anchors
        packets, notes = self._packets(with_log)
        groups = grouped(packets, self.window_s, self.windows)
        if "tag" not in packets.table.names:
            notes += identity.check_identity(packets, groups)
        found = combined(packets, groups, len(with_log.ids), self.combine)
        if self.gap_s is not None and np.isnan(found.time).any():
            raise BadValue("gap_s", self.gap_s, "null, for a log without the time of every fix")
        track = tracks(groups, found.time, self.gap_s)
        _, first, counts = np.unique(track, return_index=True, return_counts=True)
        made = Tracks(
            tags=tuple(packets.tags[i] for i in groups.tag[first]),
            counts=counts,
            time=found.time,
            fix=groups.name,
            truth=self._at_height(found.truth),
            measured=found.measured,
            packets=found.packets,
            columns=found.columns,
            poses=self.poses_of(found, groups.tag),
        )
        about = [self._counted(packets, made), *groups.notes, *found.notes]
        return Read(made, (*about, *notes, *with_log.notes))

    def _packets(self, anchors: AnchorsFile) -> tuple[Packets, list[str]]:
        """The packets of the chosen tags with their true positions, and remarks to print."""
        content = opened("path", self.path, self.reading)
        packets, notes = self.packets_of(content, self.path)
        notes += unread(content, packets.table.names, self.path)
        if not packets.count:
            raise packets.table.bad("a file with at least one row")
        if self.tags is not None:
            packets = packets.of_tags([str(tag) for tag in self.tags])
        if self.truth_file is not None:
            unit = self.declared(dict(packets.table.stated))["time_unit"]
            source = read_truth("truth", self.truth_file, unit, anchors, packets.table.names)
            found, lines = source.at(packets, self.truth_gap_s, self.truth_offset_s)
            packets = replace(packets, truth=found)
            notes = [*notes, *source.table.notes, *lines]
        elif "x" in packets.table.names and np.isfinite(packets.truth).any():
            anchors.check_local("the log's true positions are local")
        return packets, notes

    def packets_of(
        self, content: Content, path: Any, quick: bool = False
    ) -> tuple[Packets, list[str]]:
        """The packets of all tags in the content of a log, and remarks to print; `path` is the
        log's name in messages. quick: for a small piece of a log, plain rows are parsed as such.
        """
        anchors = self._anchors
        conventions, time_unit = conventions_of(self, content)
        given = Given(
            conventions=conventions,
            time_unit=time_unit,
            rssi_absent=self.rssi_absent,
            range_sigma_m=self.range_sigma_m,
            unknown_anchors=self.unknown_anchors,
        )
        names = columns_of(self, content)
        if quick and (rows := plain_rows(content, "path", path, names)) is not None:
            with suppress(BadValue):  # told with its line below
                return read_packets(rows, anchors, given)
        table = Table.of(content, "path", path, names)
        try:
            packets, notes = read_packets(table, anchors, given)
        except BadValue as error:
            why = f"; {self.anchors} has no column id, so that its anchors are called 1, 2, ..."
            raise BadValue(error.key, error.value, error.allowed + why * anchors.numbered) from None
        return packets, [*table.notes, *notes]

    def _at_height(self, truth: Array) -> Array:
        """True positions (F, 3) m with the known height where z is unknown."""
        if self.height_m is not None:
            flat = np.isnan(truth[:, 2]) & ~np.isnan(truth[:, 0])
            truth[:, 2] = np.where(flat, self.height_m, truth[:, 2])
        return truth

    def _counted(self, packets: Packets, made: Tracks) -> str:
        """A line with the numbers of fixes, tracks, rows and anchors."""
        known, heard = int(np.isfinite(made.truth[:, 0]).sum()), len(np.unique(packets.anchor))
        tags = "" if packets.tags == ("",) else f" of {_number(len(packets.tags), 'tag')}"
        tracks = f" in {_number(len(made.counts), 'track')}{tags}"
        several = tracks if tags or len(made.counts) > 1 else ""
        found = f"{packets.table.path}: {len(made.fix)} fixes{several}, {known} with ground truth"
        return f"{found}; {packets.count} rows of {heard} anchors"


def _number(n: int, word: str) -> str:
    """'1 tag' or '2 tags'."""
    return f"{n} {word}" + "s" * (n != 1)


def _from_places(tracks: Tracks) -> bool:
    """Whether a fix has azimuths measured in two places."""
    if tracks.poses is None:
        return False
    heard = np.isfinite(tracks.measured.azimuth)[..., None]
    place = tracks.poses.position[0, :, :, :2]
    low, high = (
        f(np.where(heard, place, fill), axis=1) for f, fill in ((np.min, np.inf), (np.max, -np.inf))
    )
    return bool((high > low).any())
