"""Routes from CSV or GPX: a row, or a point, for each waypoint.

A table has the columns x_m, y_m and, where known, z_m, or lat_deg, lon_deg and height_m. The times
of a GPX file play no part.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from aoabench.devices.anchors import AnchorsFile
from aoabench.devices.geodesy import Origin, check_degrees, degree_columns
from aoabench.devices.plans import plan
from aoabench.devices.readers.columns import header, shown_columns
from aoabench.devices.readers.table import Table
from aoabench.errors import BadValue, check_array
from aoabench.maths.geometry import Array

SAME_M = 0.01  # waypoints nearer to the one before are left out


class Route(NamedTuple):
    """Waypoints (K, 2) m, whether the file has them in degrees, remarks to print, and heights (K,)
    m, or None.
    """

    points: Array
    geodetic: bool
    notes: tuple[str, ...] = ()
    heights: Array | None = None


def waypoints(key: str, route: Sequence[Sequence[float]] | str, anchors: AnchorsFile) -> Route:
    """The route of waypoints [x, y] in m or in a file, in the local coordinates of the anchors.

    Raises BadValue as `read_route` does, and for a route in m beside anchors in degrees without a
    declared origin.
    """
    if isinstance(route, str):
        file = plan.find(key, route)
        found, name = read_route(key, file, anchors.origin), file.name
    else:
        found, name = Route(check_array(key, route, (None, 2)), geodetic=False), f"scenario.{key}"
    if not found.geodetic:
        anchors.check_local(f"{name} is in m")
    return found


def read_route(key: str, path: Path, origin: Origin | None) -> Route:
    """The route in a file; `origin` is that of local coordinates, None where it is unknown.

    Raises BadValue for a file of another form, for degrees without an origin, and for fewer than
    two waypoints.
    """
    kind = path.suffix.lower()
    if kind not in (*plan.TABLES, ".gpx"):
        raise BadValue(key, str(path), "waypoints [x, y] in m, or a file .csv or .gpx")
    raw = _table(key, path)
    points, heights = raw.points, raw.heights
    if raw.geodetic:
        lat, lon = points.T
        check_degrees(key, str(path), lat, lon, origin)
        if origin is None:
            allowed = (
                f"latitude and longitude of the local (0, 0), because {path.name} is in degrees "
                f"and the anchors are in m; the centre of {path.name}: {Origin.amid(lat, lon)}"
            )
            raise BadValue("origin_deg", None, allowed)
        local = origin.local(lat, lon, 0.0 if heights is None else heights)
        points, heights = local[:, :2], None if heights is None else local[:, 2]
    keep = _distinct(points)
    if keep.sum() < 2:
        raise BadValue(key, str(path), "two or more different waypoints")
    left = int((~keep).sum())
    line = f"{path.name}: {left} waypoints less than {SAME_M:g} m from the one before are left out"
    notes = (*raw.notes, line) if left else raw.notes
    return Route(points[keep], raw.geodetic, notes, None if heights is None else heights[keep])


def _distinct(points: Array) -> np.ndarray:
    """Mask (K,) of the waypoints (K, 2) m that are apart from the one before that is kept."""
    keep = np.ones(len(points), dtype=bool)
    last = points[0]
    for k, point in enumerate(points[1:], 1):
        keep[k] = np.hypot(*(point - last)) >= SAME_M
        last = point if keep[k] else last
    return keep


def _table(key: str, path: Path) -> Route:
    """The route in a table, in m or in latitudes and longitudes."""
    present = header(key, str(path))
    local = all(present.count(name) == 1 for name in ("x_m", "y_m"))
    degrees = degree_columns(present)
    if not local and degrees is None:
        allowed = "a GPX file, or a table with the columns x_m, y_m, or lat_deg, lon_deg"
        raise BadValue(key, str(path), f"{allowed}; it has {shown_columns(present)}")
    names = ["x_m", "y_m"] if local or degrees is None else list(degrees[:2])
    height = "z_m" if "z_m" in present else None if local or degrees is None else degrees[2]
    columns = names if height is None else [*names, height]
    table = Table.read(key, str(path), {name: name for name in columns})
    points = np.stack([table.numbers(name, empty=False) for name in names], axis=-1)
    heights = None if height is None else table.numbers(height, empty=False)
    return Route(points, not local, table.notes, heights)
