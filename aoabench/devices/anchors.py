"""Anchors as a table: one schema for every scenario that reads a file of anchors.

    x_m, y_m                              m; or lat_deg, lon_deg, in deg on WGS84
    id                                    a text, each once; without the column 1, 2, 3, ...
    z_m                                   m; without the column 0; with degrees also height_m
    facing_deg, pitch_deg, roll_deg       deg; without the column 0
    bearing_deg                           deg clockwise from north (+y), in place of facing_deg
    clock_offset_s                        s that the anchor's clock is ahead; without the column 0

Rz(facing) Ry(pitch) Rx(roll) turns the global axes into the anchor's. With facing alone, local x
points along the facing direction, y horizontally left of it, z up. Facing counts counter-clockwise
from the global +x; pitch > 0 tilts local x down. With degrees, +x is east, +y north, and heights
count from the ellipsoid at the origin (`devices.geodesy`).

A positioning_config.json of Silicon Labs is read too (`devices.locators`).
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from aoabench.devices.geodesy import Origin, check_degrees, degree_columns
from aoabench.devices.locators import is_config, read_locators
from aoabench.devices.readers.columns import found_column, header, shown_columns
from aoabench.devices.readers.table import Table
from aoabench.errors import BadValue, did_you_mean
from aoabench.maths.geometry import Array, euler
from aoabench.types import Anchors

REQUIRED = ("x_m", "y_m")
ANGLES = ("facing_deg", "pitch_deg", "roll_deg")
DEGREES = ("lat_deg", "lon_deg", "height_m")
LOCAL = (*REQUIRED, "z_m")
COMPASS = "bearing_deg"
COLUMNS = ("id", *LOCAL, *ANGLES, "clock_offset_s", COMPASS)
SCHEMA = (
    "a CSV or Parquet file of anchors with the columns x_m, y_m and, where needed, "
    "id (else 1, 2, ...), z_m, facing_deg, pitch_deg, roll_deg, clock_offset_s (else 0), each "
    "once; or lat_deg, lon_deg in place of x_m, y_m, and bearing_deg (clockwise from north) in "
    "place of facing_deg"
)
MOST_DEG = 360.0
FAR_M = 2000.0  # anchors are rarely farther apart
# what people call an optional column; such a column is never left out in silence
_OTHER_WORDS = {
    "z_m": ("z", "height", "altitude"),
    "facing_deg": ("facing", "yaw", "heading", "bearing", "orientation", "direction", "azimuth"),
    "pitch_deg": ("pitch", "tilt", "downtilt"),
    "roll_deg": ("roll",),
}


class AnchorsFile(NamedTuple):
    """A file's content: ids, anchors (1, 1, B, ...), the direction (B,) rad that each faces, seen
    from above, None if the file states none, remarks to print, and whether the ids are the numbers
    of the rows, because the file states none.

    clock_offset_s (B,): how far each anchor's clock is ahead, in s, or None. origin: that of the
    local coordinates, None where it is unknown; assumed: whether it is the anchors' centroid,
    because none is declared. of_log: whether there is no file, and the log has their positions.
    """

    ids: list[str]
    anchors: Anchors
    facing: Array | None
    notes: tuple[str, ...]
    numbered: bool = False
    clock_offset_s: Array | None = None
    origin: Origin | None = None
    assumed: bool = False
    of_log: bool = False

    def check_local(self, why: str) -> None:
        """Raise BadValue if there are local coordinates, which `why` names, and the anchors are in
        degrees without a declared origin.
        """
        if self.assumed:
            allowed = (
                f"latitude and longitude of the local (0, 0), because {why} and the anchors are "
                f"in degrees; the anchors' centroid: {self.origin}"
            )
            raise BadValue("origin_deg", None, allowed)


def read_anchors(key: str, path: str, origin: Origin | None = None) -> AnchorsFile:
    """The anchors of a table in the columns above, or of a positioning_config.json; other columns
    are not read. Names may have another case and other marks: `X (m)` is x_m.

    Degrees are converted to local coordinates at `origin`, or at the anchors' centroid. Raises
    BadValue for a missing or repeated column, for a column that looks like a misspelt one, for
    cells that are not numbers, and for angles beyond +-360 deg.
    """
    if is_config(path):
        return AnchorsFile(*read_locators(key, path), origin=origin)
    named = _columns(key, path, header(key, path))
    table = Table.read(key, path, named)
    n = len(table.frame)
    ids = _ids(table) if "id" in named else [str(i + 1) for i in range(n)]
    facing, pitch, roll = (_numbers(table, name, MOST_DEG) for name in ANGLES)
    if COMPASS in named:
        facing = 90.0 - _numbers(table, COMPASS, MOST_DEG)
    places = [_numbers(table, name) for name in (DEGREES if "lat_deg" in named else LOCAL)]
    assumed = "lat_deg" in named and origin is None
    notes: list[str] = []
    if assumed:
        origin = Origin.amid(*places[:2])
        line = f"x counts east, y north of scenario.origin_deg={origin}, the anchors' centroid"
        notes = [f"{path}: {line}"]
    if "lat_deg" in named and origin is not None:
        check_degrees(key, path, places[0], places[1], origin)
        places = list(origin.local(*places).T)
    turns = np.deg2rad(facing), np.deg2rad(pitch), np.deg2rad(roll)
    return AnchorsFile(
        ids,
        Anchors(np.stack(places, axis=-1), _rotations(*turns)),
        turns[0] if {"facing_deg", COMPASS} & set(named) else None,
        (*table.notes, *notes, *_doubts(path, facing), *_far(path, *places), *_high(path, *places)),
        "id" not in named,
        _numbers(table, "clock_offset_s") if "clock_offset_s" in named else None,
        origin,
        assumed,
    )


def _numbers(table: Table, name: str, most: float = math.inf) -> Array:
    """A column (B,) of numbers within +-most, 0 where the table lacks it."""
    if name not in table.names:
        return np.zeros(len(table.frame))
    found = table.numbers(name, empty=False)
    table.check(name, np.abs(found) > most, f"{name} within +-{most:g} deg")
    return found


def _rotations(facing: Array, pitch: Array, roll: Array) -> Array:
    """Rotations (B, 3, 3), global to anchor frame, from three angles (B,) rad."""
    flat = np.zeros_like(facing)
    ahead = np.stack([np.cos(facing), np.sin(facing), flat], axis=-1)
    up = np.broadcast_to([0.0, 0.0, 1.0], ahead.shape)
    found = np.stack([ahead, np.cross(up, ahead), up], axis=-2)
    for j in np.flatnonzero((pitch != 0) | (roll != 0)):
        found[j] = euler((roll[j], pitch[j], facing[j])).T
    return found


def _columns(key: str, path: str, present: Sequence[str]) -> dict[str, str]:
    """The columns to read, ours mapped to the file's; raises BadValue for columns that are missing,
    repeated or nearly called as in the schema.
    """
    named = {name: one for name in COLUMNS if (one := found_column([name], present)) is not None}
    degrees = None if "x_m" in named or "y_m" in named else degree_columns(present)
    required = REQUIRED if degrees is None else ()
    for name in COLUMNS:
        if present.count(name) > 1 or (name in required and name not in named):
            hint = _hint(name, [one for one in present if one not in named.values()])
            raise BadValue(key, path, f"{SCHEMA}; it has {shown_columns(present)}{hint}")
    if COMPASS in named and "facing_deg" in named:
        raise BadValue(key, path, f"either facing_deg or {COMPASS}; it has both")
    if degrees is not None:
        if "z_m" in named and degrees[2] != named["z_m"]:
            both = f"{degrees[2]} and {named['z_m']}"
            raise BadValue(key, path, f"one column of heights; it has {both}")
        known = {ours: theirs for ours, theirs in zip(DEGREES, degrees) if theirs is not None}
        named = {name: one for name, one in named.items() if name != "z_m"} | known
    _check_similar(key, path, present, named)
    return named


def _check_similar(key: str, path: str, present: Sequence[str], named: Mapping[str, str]) -> None:
    """Raise BadValue for a column that is not read and nearly called as in the schema."""
    for column in present:
        word = re.split(r"[ _(\[]", column.strip().lower())[0]
        for name, words in _OTHER_WORDS.items():
            if name not in named and column not in named.values() and word in words:
                other = " (bearing_deg if clockwise from north)" if name == "facing_deg" else ""
                allowed = (
                    f"{SCHEMA}; it has {column!r}, which is not read: "
                    f"call it {name} if it is that{other}, or else by another word"
                )
                raise BadValue(key, path, allowed)


def _hint(name: str, others: Sequence[str]) -> str:
    """What may be wrong with a file that lacks the column `name` but has `others`."""
    if any(one.lower().startswith(("lat", "lon", "lng")) for one in others):
        return "; degrees have the columns lat_deg and lon_deg, both of them"
    if any(mark in one for one in others for mark in ";\t"):
        return "; cells are separated by commas"
    return did_you_mean(name, others)


def _ids(table: Table) -> list[str]:
    """The ids (B,); raises BadValue if one occurs twice."""
    code, ids = table.texts("id")
    again = np.ones(len(code), dtype=bool)
    again[np.unique(code, return_index=True)[1]] = False
    table.check("id", again, "each id once")
    return ids


def _doubts(path: str, facing_deg: Array) -> list[str]:
    """A warning line if the facings look like multiples of pi / 4 rad, else an empty list."""
    turned = facing_deg[facing_deg != 0]
    steps = turned / (np.pi / 4)
    odd = np.abs(steps - np.rint(steps)) < 2e-3
    if not len(turned) or not odd.all() or np.abs(turned).max() > 2 * np.pi + 1e-2:
        return []
    return [f"{path}: facing_deg has multiples of pi/4; facings are read in deg, not in rad"]


def _far(path: str, x: Array, y: Array, z: Array) -> list[str]:
    """A warning line if anchors (B,) m are farther apart than one site is, else an empty list."""
    span = max(np.ptp(x), np.ptp(y))
    if span <= FAR_M:
        return []
    return [f"{path}: x_m and y_m span {span:.6g} and are read in m; are they in mm or cm?"]


def _high(path: str, x: Array, y: Array, z: Array) -> list[str]:
    """A warning line if heights (B,) m are far larger than distances, else an empty list."""
    span, top = max(np.ptp(x), np.ptp(y)), np.abs(z).max()
    if span == 0 or top <= max(100.0, 20.0 * span):
        return []
    return [f"{path}: z_m reaches {top:g}, x_m and y_m span {span:.4g}; all are read in m"]
