"""Anchors as a table: one schema for every scenario that reads a file of anchors.

    x_m, y_m                              m, required
    id                                    a text, each once; without the column 1, 2, 3, ...
    z_m                                   m; without the column 0
    facing_deg, pitch_deg, roll_deg       deg; without the column 0

Rz(facing) Ry(pitch) Rx(roll) turns the global axes into the anchor's. With facing alone, local x
points along the facing direction, y horizontally left of it, z up. Facing counts counter-clockwise
from the global +x; pitch > 0 tilts local x down.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from aoabench.devices.columns import header, shown_columns
from aoabench.devices.table import Table
from aoabench.errors import BadValue, did_you_mean
from aoabench.maths.geometry import Array, euler
from aoabench.types import Anchors

REQUIRED = ("x_m", "y_m")
ANGLES = ("facing_deg", "pitch_deg", "roll_deg")
COLUMNS = ("id", *REQUIRED, "z_m", *ANGLES)
SCHEMA = (
    "a CSV or Parquet file of anchors with the columns x_m, y_m and, where needed, "
    "id (else 1, 2, ...), z_m, facing_deg, pitch_deg, roll_deg (else 0), each once"
)
MOST_DEG = 360.0
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
    """

    ids: list[str]
    anchors: Anchors
    facing: Array | None
    notes: tuple[str, ...]
    numbered: bool = False


def read_anchors(key: str, path: str) -> AnchorsFile:
    """The anchors of a CSV or Parquet file in the columns above; other columns are not read.

    Raises BadValue for a missing or repeated column, for a column that looks like a misspelt one,
    for cells that are not numbers, and for angles beyond +-360 deg.
    """
    present = header(key, path)
    _check_columns(key, path, present)
    table = Table.read(key, path, {name: name for name in COLUMNS if name in present})
    n = len(table.frame)
    ids = _ids(table) if "id" in present else [str(i + 1) for i in range(n)]
    x, y, z, *turns = (
        table.numbers(name, empty=False) if name in present else np.zeros(n) for name in COLUMNS[1:]
    )
    for name, turn in zip(ANGLES, turns):
        if name in present:
            table.check(name, np.abs(turn) > MOST_DEG, f"{name} within +-{MOST_DEG:g} deg")
    facing, pitch, roll = np.deg2rad(turns)
    found = Anchors(np.stack([x, y, z], axis=-1), _rotations(facing, pitch, roll))
    known = facing if "facing_deg" in present else None
    notes = (*_doubts(path, turns[0]), *_high(path, x, y, z))
    return AnchorsFile(ids, found, known, notes, "id" not in present)


def _rotations(facing: Array, pitch: Array, roll: Array) -> Array:
    """Rotations (B, 3, 3), global to anchor frame, from three angles (B,) rad."""
    flat = np.zeros_like(facing)
    ahead = np.stack([np.cos(facing), np.sin(facing), flat], axis=-1)
    up = np.broadcast_to([0.0, 0.0, 1.0], ahead.shape)
    found = np.stack([ahead, np.cross(up, ahead), up], axis=-2)
    for j in np.flatnonzero((pitch != 0) | (roll != 0)):
        found[j] = euler((roll[j], pitch[j], facing[j])).T
    return found


def _check_columns(key: str, path: str, present: Sequence[str]) -> None:
    """Raise BadValue for columns that are missing, repeated or nearly called as in the schema."""
    for name in COLUMNS:
        if present.count(name) > 1 or (name in REQUIRED and name not in present):
            hint = _hint(name, [one for one in present if one not in COLUMNS])
            raise BadValue(key, path, f"{SCHEMA}; it has {shown_columns(present)}{hint}")
    for column in present:
        word = re.split(r"[ _(\[]", column.strip().lower())[0]
        for name, words in _OTHER_WORDS.items():
            if name not in present and word in words:
                allowed = (
                    f"{SCHEMA}; it has {column!r}, which is not read: "
                    f"call it {name} if it is that, or else by another word"
                )
                raise BadValue(key, path, allowed)


def _hint(name: str, others: Sequence[str]) -> str:
    """What may be wrong with a file that lacks the column `name` but has `others`."""
    if any(one.lower().startswith(("lat", "lon", "lng")) for one in others):
        return "; degrees of latitude and longitude are not supported yet: convert them to local m"
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


def _high(path: str, x: Array, y: Array, z: Array) -> list[str]:
    """A warning line if heights (B,) m are far larger than distances, else an empty list."""
    span, top = max(np.ptp(x), np.ptp(y)), np.abs(z).max()
    if span == 0 or top <= max(100.0, 20.0 * span):
        return []
    return [f"{path}: z_m reaches {top:g}, x_m and y_m span {span:.4g}; all are read in m"]
