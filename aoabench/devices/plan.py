"""Walls of floor plans from GeoJSON or CSV.

Local coordinates, in m or in a declared unit; degrees are refused. A file is looked for in the
working folder first, then among the shipped plans. Every mistake in a file raises BadValue with the
key, the file and the allowed content.
"""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from aoabench import loaded
from aoabench.errors import BadValue, shorten
from aoabench.maths.geometry import Array
from aoabench.resources import shipped

WALL_COLUMNS = ("x0_m", "y0_m", "x1_m", "y1_m")
UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001}  # in m
LEAST_M = 1.0  # extent below which a plan within the range of degrees is not taken for one in m


def find(key: str, name: object) -> Path:
    """Path of the file `name`: in the working folder, or else among the shipped plans."""
    plans = shipped("configs") / "plans"
    if isinstance(name, str) and name.strip() and "\0" not in name:
        for path in (Path(name), plans / name):
            if path.is_file():
                return path.resolve()
    known = ", ".join(sorted(file.name for file in plans.glob("*.*")))
    raise BadValue(key, name, f"an existing file; shipped: {known}")


def read_walls(
    key: str, path: Path, unit: str | None = None, local: bool = False
) -> tuple[Array, float | None]:
    """Walls (W, 2, 2) m, each from one point to another, and the visited area in m^2 or None.

    CSV has the columns x0_m, y0_m, x1_m, y1_m. GeoJSON is a FeatureCollection: walls are
    (Multi)LineStrings of kind `wall` or without a kind; a Polygon of kind `visited` is the visited
    area. `unit` is that of the coordinates, None for m; `local` whether the user declares them to
    be local.

    Raises BadValue for coordinates that are, or look like, degrees and are not declared local, and
    for a file that states another unit.
    """
    kind = path.suffix.lower()
    if kind == ".csv":
        segments, area = _table(key, path, WALL_COLUMNS).reshape(-1, 2, 2), None
    elif kind in (".geojson", ".json"):
        segments, area = _geojson(key, path, unit, local)
    else:
        raise BadValue(key, str(path), "a .csv or .geojson file")
    segments = segments[(segments[:, 0] != segments[:, 1]).any(axis=-1)]
    if not len(segments):
        raise BadValue(key, str(path), "a file with at least one wall, or null for none")
    if not local:
        _check_degrees(key, path, segments)
    scale = UNITS[unit or "m"]
    return segments * scale, None if area is None else area * scale**2


def _check_degrees(key: str, path: Path, segments: Array) -> None:
    """Raise BadValue for walls (W, 2, 2) that look like longitudes and latitudes."""
    corners = segments.reshape(-1, 2)
    extent = float((corners.max(axis=0) - corners.min(axis=0)).max())
    if extent < LEAST_M and np.all(np.abs(corners) <= [180, 90]):
        x, y = corners[0]
        allowed = (
            f"walls in m; these span {extent:.3g} near ({x:.6g}, {y:.6g}), which looks like "
            "degrees of longitude and latitude: convert them to local m, or declare "
            "scenario.walls_crs=local if the plan is that small "
            "(walls_crs=wgs84 is not supported yet)"
        )
        raise BadValue(key, str(path), allowed)


# --- files ----------------------------------------------------------------------------------------


def _text(key: str, path: Path) -> str:
    try:
        return loaded.read(path)[0].decode("utf-8-sig")
    except (OSError, UnicodeDecodeError):
        raise BadValue(key, str(path), "a readable file in UTF-8") from None


def _table(key: str, path: Path, columns: tuple[str, ...]) -> Array:
    """Numbers (N, columns) of a CSV file with a header; other columns are ignored."""
    lines = csv.reader(_text(key, path).splitlines())
    try:
        head = [name.strip() for name in next(lines, [])]
        for name in columns:
            if head.count(name) != 1:
                raise BadValue(
                    key, str(path), f"a CSV file with the columns {', '.join(columns)}, each once"
                )
        where = [head.index(name) for name in columns]
        rows = []
        for row in lines:
            if any(cell.strip() for cell in row):
                rows.append([_number(key, path, row, i, head[i], lines.line_num) for i in where])
    except csv.Error as error:
        raise BadValue(key, str(path), f"a CSV file; {error}") from None
    return np.array(rows, dtype=float).reshape(-1, len(columns))


def _number(key: str, path: Path, row: list[str], column: int, name: str, line: int) -> float:
    cell = row[column].strip() if column < len(row) else ""
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise BadValue(
            key,
            str(path),
            f"a finite number in every row; line {line} has {name}={shorten(repr(cell))}",
        )
    return value


def _geojson(key: str, path: Path, unit: str | None, local: bool) -> tuple[Array, float | None]:
    def bad(allowed: str) -> BadValue:
        return BadValue(key, str(path), allowed)

    try:
        content = json.loads(_text(key, path))
    except (ValueError, RecursionError):
        raise bad("a GeoJSON file; this one is not JSON") from None
    features = content.get("features") if isinstance(content, dict) else None
    if not isinstance(features, list) or content.get("type") != "FeatureCollection":
        raise bad("a GeoJSON FeatureCollection")
    stated = content.get("units", unit or "m")
    if stated != (unit or "m"):
        wanted = (
            f"set scenario.walls_unit={stated} if that is right"
            if isinstance(stated, str) and stated in UNITS
            else "convert them to m"
        )
        raise bad(
            f"local coordinates in {unit or 'm'}; its units is {shorten(repr(stated), 60)}: "
            f"{wanted}"
        )
    if content.get("crs") is not None and not local:
        raise bad(
            f"local coordinates; its crs is {_crs(content['crs'])}: scenario.walls_crs=local if x "
            "and y are lengths in a plane all the same, else convert them "
            "(walls_crs=wgs84 is not supported yet)"
        )
    walls, area = [np.empty((0, 2, 2))], None
    for number, feature in enumerate(features):
        try:
            kind, lines = _feature(number, feature)
        except ValueError as error:
            raise bad(str(error)) from None
        if kind == "visited":
            outside, *holes = (_enclosed(line) for line in lines)
            area = (area or 0.0) + outside - sum(holes)
        else:
            walls += [np.stack([line[:-1], line[1:]], axis=1) for line in lines]
    return np.concatenate(walls), area


def _crs(node: Any) -> str:
    """The name in a GeoJSON member `crs`, or the member itself."""
    return shorten(repr(_mapping(_mapping(node).get("properties")).get("name", node)), 60)


def _feature(number: int, feature: Any) -> tuple[str, list[Array]]:
    """Return the kind of a GeoJSON feature and its lines, each (K, 2) m; raises ValueError for
    content that is not allowed.
    """
    node = _mapping(feature)
    geometry = _mapping(node.get("geometry"))
    kind = _mapping(node.get("properties")).get("kind", "wall")
    form, nested = geometry.get("type"), geometry.get("coordinates")
    known = [("wall", "LineString"), ("wall", "MultiLineString"), ("visited", "Polygon")]
    if (kind, form) not in known:
        raise ValueError(
            "walls (kind wall) as LineString or MultiLineString, "
            "the visited area (kind visited) as Polygon; "
            f"feature {number} has the kind {shorten(repr(kind), 60)} "
            f"and the geometry {shorten(repr(form), 60)}"
        )
    parts = [nested] if form == "LineString" else nested
    lines = [_line(part) for part in parts] if isinstance(parts, list) else []
    good = [line for line in lines if line is not None]
    if not good or len(good) < len(lines):
        raise ValueError(
            "lines of at least two points [x, y] of finite numbers in m; "
            f"feature {number} has others"
        )
    return kind, good


def _mapping(node: Any) -> dict[str, Any]:
    return node if isinstance(node, dict) else {}


def _line(node: Any) -> Array | None:
    """Points (K, 2) m of a GeoJSON line without heights; None if `node` is not a line."""
    try:
        line = np.array([point[:2] for point in node], dtype=float)
    except (TypeError, ValueError):
        return None
    fits = line.ndim == 2 and len(line) > 1 and line.shape[1] == 2
    return line if fits and np.all(np.isfinite(line)) else None


def _enclosed(ring: Array) -> float:
    """Area in m^2 within a closed ring of points (K, 2) m."""
    x, y = (ring - ring[0]).T
    return float(abs(np.sum(x[:-1] * y[1:] - x[1:] * y[:-1])) / 2)
