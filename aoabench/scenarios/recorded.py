"""A user's own recording: measurements and, if recorded, ground truth from a long table.

`devices.log` converts its columns to aoabench's conventions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np

from aoabench import loaded
from aoabench.devices import log
from aoabench.devices.anchors import AnchorsFile, read_anchors
from aoabench.devices.columns import EXISTING
from aoabench.devices.extent import Thing, check_anchors
from aoabench.devices.table import Table
from aoabench.errors import BadValue, check_array
from aoabench.loaded import DataFile
from aoabench.maths.geometry import Array
from aoabench.params import param
from aoabench.roles import Scenario
from aoabench.scenarios.layout import AnchorLayout
from aoabench.scenarios.log_columns import Columns
from aoabench.scenarios.parameters import least_heard_param, name_param
from aoabench.types import Anchors, Measurements, Tracks


@dataclass(frozen=True)
class Recorded(Scenario):
    """One recording of T fixes: one replication, nothing is drawn, no motion and no prior.

    Fixes are in order of their times, or of their first appearance if the file numbers them. CSV
    has a header, commas and decimal points. The file of anchors has the columns x_m, y_m and, where
    needed, id (else 1, 2, ...), z_m, facing_deg, pitch_deg, roll_deg (else 0). The last three turn
    the anchor's axes by Rz(facing) Ry(pitch) Rx(roll): facing counter-clockwise from the global +x,
    pitch > 0 down.
    """

    name: str = name_param()
    path: str = param(
        help="CSV or Parquet file, a row per anchor and measurement", allowed=f"an {EXISTING}"
    )
    anchors: AnchorLayout | str = param(
        help="CSV or Parquet file of the anchors, or a layout",
        kind=AnchorLayout,
        allowed=f"an {EXISTING}, or an AnchorLayout",
    )
    columns: Columns = param(
        Columns(),
        "names of the file's columns",
        kind=Columns,
        allowed="the names of columns, see Columns",
    )
    anchor_ids: Sequence[Any] | None = param(
        None, "ids in the recording of a layout's anchors; null: numbers from 1"
    )
    unknown_anchors: str = param(
        "error",
        "treatment of rows of anchors that are not listed: an error, or left out (ignore)",
        choices=("error", "ignore"),
    )
    window_s: float = param(
        0.0,
        "rows up to this long after the first row of a fix belong to it; 0: rows of equal time",
        unit="s",
        least=0,
    )
    time_unit: str = param("s", "unit of times that are numbers", choices=tuple(log.SECONDS))
    duplicates: str = param(
        "error",
        "treatment of differing rows of an anchor in a fix: an error, or the first or last is used",
        choices=("error", "first", "last"),
    )
    azimuth_unit: str = param("deg", "unit of azimuths", choices=tuple(log.TURN))
    azimuth_sense: str = param(
        "counterclockwise",
        "sense of azimuths, seen from above (from the +z of the frame)",
        choices=("counterclockwise", "clockwise"),
    )
    azimuth_zero_deg: float = param(
        0.0,
        "direction of azimuth 0, counter-clockwise from the +x of the frame",
        unit="deg",
        least=-360,
        most=360,
    )
    elevation_unit: str = param("deg", "unit of elevations", choices=tuple(log.TURN))
    elevation_kind: str = param(
        "elevation",
        "elevation: up from the horizontal; depression: down from it; zenith: from straight up; "
        "none: not used",
        choices=("elevation", "depression", "zenith", "none"),
    )
    elevation_limit_deg: float = param(
        90.0,
        "largest valid elevation; simulated elevations not folded at the poles need 180",
        unit="deg",
        above=0,
        most=180,
    )
    negative_sigma: str = param(
        "error",
        "treatment of a negative deviation: an error; absent, the angle was not measured (no line "
        "of sight); absolute, its absolute value is used",
        choices=log.SIGMAS,
    )
    rssi_absent: Sequence[float] = param(
        (127, -128),
        "signal strengths that mean not available, as devices write them; some write 0",
        unit="dBm",
    )
    frame: str = param(
        "own",
        "axes of the angles: own, those of the device that measured (mobile: x ahead); or global",
        choices=("own", "global"),
    )
    measured_by: str = param(
        "anchor",
        "device that measured: anchor, the mobile's direction; or mobile, the anchors' directions",
        choices=("anchor", "mobile"),
    )
    heading_deg: float | None = param(
        None,
        "direction of the mobile's +x, counter-clockwise from the global +x, if the mobile "
        "measured in its own frame; null: from the column of headings",
        unit="deg",
        least=-360,
        most=360,
    )
    height_m: float | None = param(
        None,
        "known height of the target, for methods in the plane; null: the true z if constant",
        unit="m",
    )
    bounds_m: Sequence[Sequence[float]] | None = param(
        None,
        "lower and upper corner [x, y] of the target's area; null: no bounds",
        unit="m",
        shape=(2, 2),
    )
    least_heard: float = least_heard_param()
    dt = 1.0
    motion = None
    shares_positions = True
    replications = 1

    _files = ()

    def __post_init__(self) -> None:
        super().__post_init__()
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
            truth = self._log.truth
        object.__setattr__(self, "_files", files())
        z = truth[np.isfinite(truth[:, 2]), 2]
        if self.height_m is None and len(z) and np.ptp(z) < 1e-3:
            object.__setattr__(self, "height_m", float(np.median(z)))
        known = truth[np.isfinite(truth[:, 0])]
        if len(known):
            target = Thing("true positions", "path", self.path, known)
            position = self._anchors.anchors.position[0, 0]
            check_anchors(Thing("anchors", "anchors", self.anchors, position), target)

    @property
    def files(self) -> tuple[DataFile, ...]:
        """The files that the scenario was read from, as they were then."""
        return self._files

    @property
    def names(self) -> dict[str, str]:
        """The columns' default names; angles and times carry the declared unit."""
        a, e = self.azimuth_unit, self.elevation_unit
        found = {name: f"{name}_m" for name in "xyz"} | {"anchor": "anchor", "fix": "fix"}
        found |= {"azimuth": f"azimuth_{a}", "azimuth_sigma": f"azimuth_sigma_{a}"}
        found |= {"elevation": f"elevation_{e}", "elevation_sigma": f"elevation_sigma_{e}"}
        return found | {
            "time": f"time_{self.time_unit}",
            "rssi": "rssi_dbm",
            "heading": "heading_deg",
        }

    @property
    def recorded(self) -> Measurements:
        """The recorded measurements (T, B), in aoabench's conventions."""
        return self._log.measured

    @property
    def tracks(self) -> Tracks:
        """The recorded tracks."""
        return Tracks.single(self._log.truth, self._log.measured)

    @property
    def notes(self) -> tuple[str, ...]:
        """Lines about the files, to print."""
        return self._log.notes

    @property
    def known_height_m(self) -> float | None:
        """`height_m`, or the height in m if all true positions have the same one, else None."""
        return self.height_m

    @cached_property
    def true_anchors(self) -> Anchors:
        """The anchors (1, 1, B, ...); with the global axes if the angles are global."""
        anchors = self._anchors.anchors
        own = self.frame == "own" and self.measured_by == "anchor"
        upright = np.zeros_like(anchors.rotation) + np.eye(3)
        return anchors if own else Anchors(anchors.position, upright)

    def offers(self) -> frozenset[str]:
        """The offers of all scenarios, less several anchors if no fix has measurements by two."""
        heard = np.isfinite(self.recorded.azimuth).sum(axis=1)
        lone = heard.max(initial=0) < 2
        return super().offers() - (frozenset({"several_anchors"} if lone else ()))

    def unheard(self) -> BadValue:
        """The error for a log without any measurement."""
        empty = "; every angle is empty, or was taken as not measured (scenario.negative_sigma)"
        return BadValue("path", self.path, f"a file with at least one azimuth or elevation{empty}")

    def truth(self, rng: np.random.Generator) -> Array:
        """Positions (T, 3) m, NaN where unknown."""
        return self._log.truth

    @cached_property
    def _anchors(self) -> AnchorsFile:
        """The anchors (1, 1, B, ...) and their ids as strings."""
        if isinstance(self.anchors, AnchorLayout):
            B = len(self.anchors.position_m)
            ids = list(map(str, range(1, B + 1) if self.anchor_ids is None else self.anchor_ids))
            if len(ids) != B or len(set(ids)) < B:
                allowed = f"{B} different ids, one for each anchor, or null"
                raise BadValue("anchor_ids", self.anchor_ids, allowed)
            return AnchorsFile(ids, self.anchors.known, None, ())
        if self.anchor_ids is not None:
            allowed = "null, unless scenario.anchors is a layout: a file may have the column id"
            raise BadValue("anchor_ids", self.anchor_ids, allowed)
        return read_anchors("anchors", self.anchors)

    @cached_property
    def _log(self) -> log.Log:
        ids = self._anchors.ids
        table = Table.read("path", self.path, self._chosen())
        strict = self.unknown_anchors == "error"
        try:
            table, anchor, notes = log.known_anchors(table, ids, strict)
        except BadValue as error:
            why = f"; {self.anchors} has no column id, so that its anchors are called 1, 2, ..."
            more = why * self._anchors.numbered
            raise BadValue(error.key, error.value, error.allowed + more) from None
        fix, T = log.fixes(table, self.time_unit, self.window_s)
        values = log.angles(table, self._conventions)
        rssi, lines = log.strengths(table, self.rssi_absent)
        values |= {} if rssi is None else {"rssi": rssi}
        truth = log.truth(table, fix, T)
        if self.height_m is not None:
            truth[:, 2] = np.where(
                np.isnan(truth[:, 2]) & ~np.isnan(truth[:, 0]), self.height_m, truth[:, 2]
            )
        keep = table.distinct(
            fix * len(ids) + anchor, values, self.duplicates, "scenario.duplicates=first or last"
        )
        arrays = {name: np.full((T, len(ids)), np.nan) for name in values}
        for name, value in values.items():
            arrays[name][fix[keep], anchor[keep]] = value[keep]
        heard, known = len(np.unique(anchor)), int(np.isfinite(truth[:, 0]).sum())
        found = f"{T} fixes, {known} with ground truth; {len(keep)} rows of {heard} anchors"
        notes.append(f"{self.path}: {found}")
        if lost := len(fix) - len(keep):
            notes.append(f"{self.path}: {lost} rows left out: further rows of an anchor in a fix")
        notes += [*lines, *self._anchors.notes, *log.doubts(table, self.azimuth_unit)]
        return log.Log(truth, Measurements(**arrays), tuple(notes))

    def _chosen(self) -> dict[str, str]:
        """Map from aoabench's column names to the file's, for the columns to read."""
        heading = {"heading"} if self._conventions.needs_heading else set()
        unused = {"heading"} - heading
        unused |= {"elevation", "elevation_sigma"} if self.elevation_kind == "none" else set()
        named = {name: one for name, one in asdict(self.columns).items() if name not in unused}
        return log.chosen_columns(self.path, named, self.names, {"azimuth", "anchor"} | heading)

    @property
    def _conventions(self) -> log.Conventions:
        return log.Conventions(**{name: getattr(self, name) for name in log.Conventions._fields})
