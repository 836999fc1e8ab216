"""A user's own recording: measurements, and ground truth if there is any, from a long table.

A row is what one anchor measured, or what the mobile measured of one anchor. Conventions are
declared, never guessed; they are turned into ours (counter-clockwise azimuth from the anchor's +x,
elevation up from its xy-plane):

    azimuth = zero +- value                      elevation = value, -value or 90 deg - value
    by the mobile: heading + azimuth + 180 deg   -elevation          both in global axes
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from aoabench.devices.longtable import read_anchors
from aoabench.devices.table import Table, header
from aoabench.errors import BadValue, check_array, check_choice, check_number, did_you_mean
from aoabench.maths.geometry import Array, wrap
from aoabench.roles import Scenario
from aoabench.scenarios.layout import AnchorLayout
from aoabench.types import Anchors, Measurements

TURN = {"deg": 360.0, "rad": 2 * np.pi}
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
SAME_M = 1e-6  # rows of one fix whose true positions differ by less agree


@dataclass(frozen=True)
class Columns:
    """What the file calls our columns; None: the default name (see Recorded.names), if the file has
    it.
    """

    azimuth: str | None = None
    elevation: str | None = None
    anchor: str | None = None
    fix: str | None = None
    time: str | None = None
    rssi: str | None = None
    azimuth_sigma: str | None = None
    elevation_sigma: str | None = None
    heading: str | None = None
    x: str | None = None
    y: str | None = None
    z: str | None = None

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            if value is not None and not (isinstance(value, str) and value.strip()):
                raise BadValue(f.name, value, "the name of a column, or null")


class Log(NamedTuple):
    """A file's content: true positions (T, 3) m, measurements (T, B) and lines about what was
    found.
    """

    truth: Array
    measured: Measurements
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Recorded(Scenario):
    """One recording, whose parameters configs/scenario/recorded.yaml explains: T fixes in order of
    their times, or of their first appearance where the file numbers them. Nothing is drawn: there
    is one replication, no motion, no prior.
    """

    name: str
    path: str
    anchors: AnchorLayout | str
    columns: Columns = Columns()
    anchor_ids: Sequence[Any] | None = None
    unknown_anchors: str = "error"
    window_s: float = 0.0
    time_unit: str = "s"
    duplicates: str = "error"
    azimuth_unit: str = "deg"
    azimuth_sense: str = "counterclockwise"
    azimuth_zero_deg: float = 0.0
    elevation_unit: str = "deg"
    elevation_kind: str = "elevation"
    elevation_limit_deg: float = 90.0
    negative_sigma: str = "error"
    frame: str = "own"
    measured_by: str = "anchor"
    heading_deg: float | None = None
    height_m: float | None = None
    bounds_m: Sequence[Sequence[float]] | None = None
    dt = 1.0
    motion = None
    shares_positions = True
    replications = 1

    def __post_init__(self) -> None:
        choices = {
            "azimuth_unit": TURN,
            "azimuth_sense": ("counterclockwise", "clockwise"),
            "elevation_unit": TURN,
        }
        choices |= {
            "elevation_kind": ("elevation", "depression", "zenith", "none"),
            "time_unit": SECONDS,
        }
        choices |= {
            "duplicates": ("error", "first", "last"),
            "unknown_anchors": ("error", "ignore"),
        }
        choices |= {"negative_sigma": ("error", "absent", "absolute"), "frame": ("own", "global")}
        for key, allowed in (choices | {"measured_by": ("anchor", "mobile")}).items():
            check_choice(key, getattr(self, key), tuple(allowed))
        check_number("azimuth_zero_deg", self.azimuth_zero_deg, least=-360, most=360)
        check_number("elevation_limit_deg", self.elevation_limit_deg, above=0, most=180)
        check_number("window_s", self.window_s, least=0)
        check_number("heading_deg", self.heading_deg, least=-360, most=360, optional=True)
        check_number("height_m", self.height_m, optional=True)
        if self.heading_deg is not None and (self.measured_by, self.frame) != ("mobile", "own"):
            raise BadValue(
                "heading_deg", self.heading_deg, "null, unless measured_by=mobile and frame=own"
            )
        if not isinstance(self.columns, Columns):
            raise BadValue("columns", self.columns, "the names of columns, see Columns")
        if self.bounds_m is not None:
            low, high = check_array("bounds_m", self.bounds_m, (2, 2))
            if not np.all(low < high):
                raise BadValue(
                    "bounds_m", self.bounds_m, "the lower corner, then the upper one, or null"
                )
        z = self._log.truth[:, 2]  # reads the files: what is wrong with them is said now
        z = z[np.isfinite(z)]
        if self.height_m is None and len(z) and np.ptp(z) < 1e-3:
            object.__setattr__(self, "height_m", float(np.median(z)))

    @property
    def files(self) -> tuple[Path, ...]:
        """The files that the scenario was read from."""
        return tuple(Path(f).resolve() for f in (self.path, self.anchors) if isinstance(f, str))

    @property
    def names(self) -> dict[str, str]:
        """The columns' default names; angles and times carry the declared unit."""
        a, e = self.azimuth_unit, self.elevation_unit
        found = {
            "azimuth": f"azimuth_{a}",
            "elevation": f"elevation_{e}",
            "anchor": "anchor",
            "fix": "fix",
        }
        found |= {"azimuth_sigma": f"azimuth_sigma_{a}", "elevation_sigma": f"elevation_sigma_{e}"}
        found |= {"time": f"time_{self.time_unit}", "rssi": "rssi_dbm", "heading": "heading_deg"}
        return found | {axis: f"{axis}_m" for axis in "xyz"}

    @property
    def recorded(self) -> Measurements:
        """What was measured (T, B), in our conventions."""
        return self._log.measured

    @property
    def notes(self) -> tuple[str, ...]:
        """Lines about what was found in the files."""
        return self._log.notes

    @property
    def known_height_m(self) -> float | None:
        """`height_m`, or the one height that all true positions have."""
        return self.height_m

    @cached_property
    def true_anchors(self) -> Anchors:
        """The anchors (1, B, ...); their axes are the global ones where the angles are."""
        anchors = self._anchors[1]
        own = self.frame == "own" and self.measured_by == "anchor"
        return (
            anchors
            if own
            else Anchors(anchors.position, np.zeros_like(anchors.rotation) + np.eye(3))
        )

    def truth(self, rng: np.random.Generator) -> Array:
        """Positions (T, 3) m, NaN where they are not known."""
        return self._log.truth

    @cached_property
    def _anchors(self) -> tuple[list[str], Anchors]:
        """The anchors' ids, as texts, and where they are."""
        if isinstance(self.anchors, AnchorLayout):
            B = len(self.anchors.position_m)
            ids = list(map(str, range(1, B + 1) if self.anchor_ids is None else self.anchor_ids))
            if len(ids) != B or len(set(ids)) < B:
                raise BadValue(
                    "anchor_ids",
                    self.anchor_ids,
                    f"{B} different ids, one for each anchor, or null",
                )
            return ids, self.anchors.known
        if self.anchor_ids is not None:
            raise BadValue(
                "anchor_ids",
                self.anchor_ids,
                "null, unless anchors is a layout: a file has the column id",
            )
        return read_anchors("anchors", self.anchors)

    @cached_property
    def _log(self) -> Log:
        chosen = self._chosen(header("path", self.path))
        ids, _ = self._anchors
        table = Table.read("path", self.path, chosen)
        notes = []
        anchor = table.indices("anchor", ids, strict=self.unknown_anchors == "error")
        if strangers := int((anchor < 0).sum()):
            notes.append(f"{self.path}: {strangers} rows of unknown anchors left out")
            if strangers == len(anchor):
                raise table.bad(f"at least one row of a known anchor: {', '.join(ids[:20])}")
            table, anchor = table.where(anchor >= 0), anchor[anchor >= 0]
        fix, T = self._fixes(table)
        values = self._angles(table)
        if "rssi" in table.names:
            values["rssi"] = table.numbers("rssi")
        truth = _truth(table, fix, T)
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
        notes.append(
            f"{self.path}: {T} fixes, {known} with ground truth; "
            f"{len(keep)} rows of {heard} anchors"
        )
        if len(keep) < len(fix):
            notes.append(
                f"{self.path}: {len(fix) - len(keep)} rows left out: an anchor's second in one fix"
            )
        return Log(truth, Measurements(**arrays), (*notes, *self._doubts(table)))

    def _chosen(self, there: Sequence[str]) -> dict[str, str]:
        """Our names -> the file's, of the columns to read from a file with columns `there`."""
        unused = {"heading"} - self._needs_heading
        unused |= {"elevation", "elevation_sigma"} if self.elevation_kind == "none" else set()
        chosen = {
            f.name: getattr(self.columns, f.name) for f in fields(Columns) if f.name not in unused
        }
        for ours, default in self.names.items():
            if ours in chosen and chosen[ours] is None and default in there:
                chosen[ours] = default
        if chosen["fix"] is not None:
            chosen["time"] = None  # clocks need not compare then, nor be complete
        needed = (
            {"azimuth", "anchor"}
            | self._needs_heading
            | ({"time"} if chosen["fix"] is None else set())
        )
        needed |= {"x", "y"} if any(chosen[axis] for axis in "xyz") else set()
        for ours, name in chosen.items():
            if (name is None and ours in needed) or (name is not None and there.count(name) != 1):
                kind = "a column" + (
                    f", by default called {self.names[ours]}," if name is None else ""
                )
                count = f"; {name} is there {there.count(name)} times" if name in there else ""
                allowed = f"{kind} of {self.path}, which has {', '.join(there)}{count}"
                allowed += did_you_mean(name or self.names[ours], there) if not count else ""
                allowed += (
                    "; or fix, a column that numbers what belongs together"
                    if ours == "time"
                    else ""
                )
                raise BadValue(f"columns.{ours}", name, allowed)
        return {ours: name for ours, name in chosen.items() if name is not None}

    @property
    def _needs_heading(self) -> set[str]:
        own = self.measured_by == "mobile" and self.frame == "own"
        return {"heading"} if own and self.heading_deg is None else set()

    def _fixes(self, table: Table) -> tuple[np.ndarray, int]:
        """Which fix (N,) each row belongs to, and how many there are."""
        if "fix" in table.names:
            code, ids = table.texts("fix")
            return code, len(ids)
        time = table.times("time") * (SECONDS[self.time_unit] if table.is_number("time") else 1.0)
        moments, code = np.unique(time, return_inverse=True)
        if self.window_s == 0:
            return code, len(moments)
        ordered, starts = moments.tolist(), np.zeros(len(moments), dtype=int)
        begin = 0
        while (begin := bisect_right(ordered, ordered[begin] + self.window_s, begin)) < len(
            ordered
        ):
            starts[begin] = 1
        return np.cumsum(starts)[code], int(starts.sum()) + 1

    def _angles(self, table: Table) -> dict[str, Array]:
        """Azimuth, elevation and their deviations (N,), rad, as far as they are there, in our
        conventions.
        """
        turn = TURN[self.azimuth_unit]
        raw = table.numbers("azimuth")
        allowed = f"azimuths within +-{turn:.6g}, as azimuth_unit={self.azimuth_unit} declares"
        table.check("azimuth", np.abs(raw) > turn * (1 + 1e-6), allowed)
        sign = 1.0 if self.azimuth_sense == "counterclockwise" else -1.0
        found = {"azimuth": np.deg2rad(self.azimuth_zero_deg) + sign * raw * (2 * np.pi / turn)}
        if "elevation" in table.names:
            turn, kind = TURN[self.elevation_unit], self.elevation_kind
            raw, limit = table.numbers("elevation"), turn * self.elevation_limit_deg / 360
            middle, sign = {"elevation": (0, 1), "depression": (0, -1), "zenith": (turn / 4, -1)}[
                kind
            ]
            allowed = (
                f"{middle - limit:.6g} to {middle + limit:.6g}, "
                f"as elevation_kind={kind} and elevation_unit="
            )
            wrong = np.abs(raw - middle) > limit * (1 + 1e-6)
            table.check(
                "elevation", wrong, f"{kind} angles from {allowed}{self.elevation_unit} declare"
            )
            found["elevation"] = sign * (raw - middle) * (2 * np.pi / turn)
        else:
            found["elevation"] = np.full(len(raw), np.nan)
        if self.measured_by == "mobile":
            heading = (
                table.numbers("heading", empty=False)
                if self._needs_heading
                else self.heading_deg or 0.0
            )
            found = {
                "azimuth": found["azimuth"] + np.deg2rad(heading) + np.pi,
                "elevation": -found["elevation"],
            }
        found["azimuth"] = wrap(found["azimuth"])
        for angle, unit in (("azimuth", self.azimuth_unit), ("elevation", self.elevation_unit)):
            if (column := f"{angle}_sigma") in table.names:
                sigma = table.numbers(column) * (2 * np.pi / TURN[unit])
                if self.negative_sigma == "absent":
                    found[angle] = np.where(sigma < 0, np.nan, found[angle])
                sigma = (
                    np.abs(sigma)
                    if self.negative_sigma == "absolute"
                    else np.where(sigma < 0, np.nan, sigma)
                )
                allowed = (
                    f"a number > 0 in {table.names[column]} "
                    f"for every {angle} that was measured; see negative_sigma"
                )
                table.check(column, np.isfinite(found[angle]) & ~(sigma > 0), allowed)
                found[column] = sigma
        return found

    def _doubts(self, table: Table) -> list[str]:
        """A line if azimuths declared as deg look like rad."""
        raw = table.numbers("azimuth")
        raw = raw[np.isfinite(raw)]
        if (
            self.azimuth_unit == "rad"
            or len(raw) <= 20
            or np.abs(raw).max() > 2 * np.pi
            or np.all(raw == np.rint(raw))
        ):
            return []
        return [
            f"{self.path}: all of {table.names['azimuth']} is within +-2 pi deg: "
            "if it is rad, azimuth_unit=rad"
        ]


def _truth(table: Table, fix: np.ndarray, T: int) -> Array:
    """True positions (T, 3) m, NaN where a fix has none; all rows of a fix that say something
    agree.
    """
    nothing = np.full(T, np.nan)
    truth = np.stack(
        [table.shared(a, fix, T, SAME_M) if a in table.names else nothing for a in "xyz"], axis=-1
    )
    truth[np.isnan(truth[:, :2]).any(axis=1)] = np.nan
    return truth
