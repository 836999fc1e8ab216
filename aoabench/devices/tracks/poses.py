"""Poses of receivers that move: where each stands and which way it faces, in each row of a log.

    anchor_x, anchor_y, anchor_z   m; or anchor_lat, anchor_lon in deg on WGS84, and then anchor_z
                                   counts from the ellipsoid
    anchor_facing                  deg counter-clockwise from the global +x; or anchor_bearing, deg
                                   clockwise from north (+y)

What a row leaves out is as in the file of anchors. Facings turn the anchor of the file about the
vertical. Without a file, z and facing are 0, and a row without a position is not used.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from aoabench.devices.anchors import MOST_DEG, AnchorsFile
from aoabench.devices.geodesy import Origin, check_degrees
from aoabench.devices.readers.table import Table
from aoabench.errors import BadValue
from aoabench.maths.geometry import Array
from aoabench.types import Anchors

POSE = ("anchor_x", "anchor_y", "anchor_z", "anchor_facing")  # in Packets.values, in m and rad
METRES, DEGREES, TURNS = POSE[:2], ("anchor_lat", "anchor_lon"), ("anchor_facing", "anchor_bearing")
DEFAULTS = {
    **{name: f"{name}_m" for name in POSE[:3]},
    **{name: f"{name}_deg" for name in (*DEGREES, *TURNS)},
}


def check_columns(chosen: Mapping[str, str], path: object) -> None:
    """Raise BadValue for a position of which a column is missing, and for two columns of one
    quantity; `chosen` maps aoabench's names of columns to those of the log.
    """
    for pair in (METRES, DEGREES):
        given = [name for name in pair if name in chosen]
        if len(given) == 1:
            (lost,) = set(pair) - set(given)
            allowed = f"a column, by default called {DEFAULTS[lost]}, because {path} has "
            raise BadValue(f"columns.{lost}", None, f"{allowed}{chosen[given[0]]}")
    for one, other in (("anchor_x", "anchor_lat"), TURNS):
        if one in chosen and other in chosen:
            both = f"{chosen[one]} and {chosen[other]}"
            raise BadValue(f"columns.{other}", chosen[other], f"one of {both}; {path} has both")


def read_poses(
    table: Table, anchor: np.ndarray, known: AnchorsFile
) -> tuple[dict[str, Array], np.ndarray]:
    """Return the pose of each row, arrays (N,) under the names POSE, {} for a log without poses;
    and whether it is known (N,).

    anchor (N,): the numbers of the rows' anchors among those `known`.
    """
    usable = np.ones(len(anchor), dtype=bool)
    if not any(name in table.names for name in DEFAULTS):
        return {}, usable
    place = known.anchors.position[0, 0][anchor]
    found = _places(table, known.origin)
    if found is not None:
        level = np.isnan(found[:, :2]).any(axis=1)
        usable &= ~(level & known.of_log)
        place[~level, :2] = found[~level, :2]
        high = ~level & np.isfinite(found[:, 2])
        place[high, 2] = found[high, 2]
    facing, turn = _facings(known)[anchor], _turns(table)
    if turn is not None:
        usable &= ~(np.isnan(turn) & known.of_log)
        facing = np.where(np.isnan(turn), facing, turn)
    return dict(zip(POSE, (*place.T, facing))), usable


def receivers(
    table: Table, anchor: np.ndarray, ids: list[str], origin: Origin | None
) -> AnchorsFile:
    """The anchors `ids` of a log that has their positions itself: each where it stands first.

    anchor (N,): the numbers of the rows' anchors. Raises BadValue if one has no position.
    """
    notes: tuple[str, ...] = ()
    assumed = "anchor_lat" in table.names and origin is None
    if assumed:
        degrees = _degrees(table)
        origin = Origin.amid(*degrees[np.isfinite(degrees).all(axis=1)].T)
        about = f"x counts east, y north of scenario.origin_deg={origin}, the receivers' centroid"
        notes = (f"{table.path}: {about}",)
    place = _places(table, origin)
    assert place is not None
    known = np.flatnonzero(np.isfinite(place[:, :2]).all(axis=1))
    present, first = np.unique(anchor[known], return_index=True)
    if len(present) < len(ids):
        lost = next(name for i, name in enumerate(ids) if i not in present)
        raise table.bad(f"the position of receiver {lost} in at least one row")
    position = place[known[first]]
    position[:, 2] = 0.0
    return AnchorsFile(
        ids,
        Anchors(position, np.zeros((len(ids), 3, 3)) + np.eye(3)),
        None,
        notes,
        origin=origin,
        assumed=assumed,
        of_log=True,
    )


def placed(
    values: Mapping[str, Array],
    columns: np.ndarray,
    tag: np.ndarray,
    known: AnchorsFile,
    upright: bool,
) -> Anchors | None:
    """The poses (1, F, C, ...) of the columns in F fixes; None for a log without poses.

    values: arrays (F, C) under the names POSE, NaN where an anchor was not heard. It is then where
    the fix's other packets, or else the fixes before, or else those after, have it. columns (C,):
    the columns' anchors; tag (F,), ascending. upright: whether the angles are in global axes.
    """
    if not values:
        return None
    base = (*known.anchors.position[0, 0].T, _facings(known))
    x, y, z, facing = (
        _held(values[name], columns, tag, own[columns]) for name, own in zip(POSE, base)
    )
    position = np.stack([x, y, z], axis=-1)[None]
    if upright:
        return Anchors(position, np.zeros((len(columns), 3, 3)) + np.eye(3))
    rotation = known.anchors.rotation[0, 0][columns]
    turn = base[3][columns] - facing
    if not turn.any():
        return Anchors(position, rotation)
    about_z = np.zeros((*turn.shape, 3, 3))
    about_z[..., 0, 0] = about_z[..., 1, 1] = np.cos(turn)
    about_z[..., 1, 0] = np.sin(turn)
    about_z[..., 0, 1] = -about_z[..., 1, 0]
    about_z[..., 2, 2] = 1.0
    return Anchors(position, (rotation @ about_z)[None])


def _facings(known: AnchorsFile) -> Array:
    """The direction (B,) rad that each anchor of the file faces."""
    return np.zeros(len(known.ids)) if known.facing is None else known.facing


def _places(table: Table, origin: Origin | None) -> Array | None:
    """Local positions (N, 3) m, NaN where a cell is empty; None for a log without positions."""
    height = np.full(table.count, np.nan)
    if "anchor_z" in table.names:
        height = table.numbers("anchor_z")
    if "anchor_x" in table.names:
        return np.stack([*(table.numbers(name) for name in METRES), height], axis=-1)
    if "anchor_lat" not in table.names:
        return None
    if origin is None:
        allowed = "latitude and longitude of the local (0, 0), because the anchors are in m"
        raise BadValue("origin_deg", None, f"{allowed} and the receivers' positions in degrees")
    degrees = _degrees(table)
    known = np.isfinite(degrees).all(axis=1)
    found = np.full((len(degrees), 3), np.nan)
    if known.any():
        lat, lon = degrees[known].T
        check_degrees(table.key, table.path, lat, lon, origin)
        up = height[known]
        found[known] = origin.local(lat, lon, np.where(np.isnan(up), 0.0, up))
        found[known, 2] = np.where(np.isnan(up), np.nan, found[known, 2])
    return found


def _degrees(table: Table) -> Array:
    """Latitude and longitude (N, 2) deg, NaN where unknown: both are 0 where satellites are not
    received.
    """
    found = np.stack([table.numbers(name) for name in DEGREES], axis=-1)
    found[(found == 0).all(axis=1)] = np.nan
    if not np.isfinite(found).all(axis=1).any():
        raise table.bad("the latitude and longitude of the receiver in at least one row")
    return found


def _turns(table: Table) -> Array | None:
    """Facings (N,) rad, NaN where a cell is empty; None for a log without facings."""
    name = next((name for name in TURNS if name in table.names), None)
    if name is None:
        return None
    turn = table.numbers(name)
    table.check(name, np.abs(turn) > MOST_DEG, f"{table.names[name]} within +-{MOST_DEG:g} deg")
    return np.deg2rad(turn if name == "anchor_facing" else 90.0 - turn)


def _held(value: Array, columns: np.ndarray, tag: np.ndarray, base: Array) -> Array:
    """Values (F, C) with those of `placed` where they are NaN; base (C,): those of an anchor that
    was never heard.
    """
    found = np.array(value)
    start, end = np.searchsorted(tag, tag), np.searchsorted(tag, tag, side="right")
    place, F = np.arange(len(tag)), len(tag)
    for b in np.unique(columns):
        own = np.flatnonzero(columns == b)
        first = found[:, own[0]]
        heard = np.isfinite(first)
        before = np.maximum.accumulate(np.where(heard, place, -1))
        after = np.minimum.accumulate(np.where(heard, place, F)[::-1])[::-1]
        at = np.where(before >= start, before, np.where(after < end, after, -1))
        first = np.where(at >= 0, first[at], base[own[0]])
        found[:, own] = np.where(np.isnan(found[:, own]), first[:, None], found[:, own])
    return found
