"""Floor plans as files: anchors from CSV, walls from GeoJSON or CSV, and lines of sight.

Local coordinates in m. A file is looked for in the working folder first, then among the shipped
plans. Every mistake in a file raises BadValue with the key, the file and the allowed content.
"""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from aoabench.errors import BadValue
from aoabench.maths.geometry import Array
from aoabench.resources import shipped
from aoabench.types import Anchors

ANCHOR_COLUMNS = ("x_m", "y_m", "z_m", "facing_deg")
WALL_COLUMNS = ("x0_m", "y0_m", "x1_m", "y1_m")
_AT_ONCE = 1 << 16  # number of sight lines in memory at a time


def find(key: str, name: object) -> Path:
    """Path of the file `name`: in the working folder, or else among the shipped plans."""
    plans = shipped("configs") / "plans"
    if isinstance(name, str) and name.strip() and "\0" not in name:
        for path in (Path(name), plans / name):
            if path.is_file():
                return path.resolve()
    known = ", ".join(sorted(file.name for file in plans.glob("*.*")))
    raise BadValue(key, name, f"an existing file; shipped: {known}")


def read_anchors(key: str, path: Path) -> Anchors:
    """Anchors (1, 1, B, ...) from the columns x_m, y_m, z_m, facing_deg.

    The last is the horizontal direction of the array's broadside, counter-clockwise from +x. Local
    axes: x along the broadside, y horizontally left of it, z up.
    """
    table = _table(key, path, ANCHOR_COLUMNS)
    if not len(table):
        raise BadValue(key, str(path), "a file with at least one anchor")
    turn, up = np.deg2rad(table[:, 3]), np.broadcast_to([0.0, 0.0, 1.0], (len(table), 3))
    ahead = np.stack([np.cos(turn), np.sin(turn), np.zeros_like(turn)], axis=-1)
    return Anchors(table[:, :3], np.stack([ahead, np.cross(up, ahead), up], axis=-2))


def read_walls(key: str, path: Path) -> tuple[Array, float | None]:
    """Walls (W, 2, 2) m, each from one point to another, and the visited area in m^2 or None.

    CSV has the columns x0_m, y0_m, x1_m, y1_m. GeoJSON is a FeatureCollection: walls are
    (Multi)LineStrings of kind `wall` or without a kind; a Polygon of kind `visited` is the visited
    area.
    """
    kind = path.suffix.lower()
    if kind == ".csv":
        segments, area = _table(key, path, WALL_COLUMNS).reshape(-1, 2, 2), None
    elif kind in (".geojson", ".json"):
        segments, area = _geojson(key, path)
    else:
        raise BadValue(key, str(path), "a .csv or .geojson file")
    segments = segments[(segments[:, 0] != segments[:, 1]).any(axis=-1)]
    if not len(segments):
        raise BadValue(key, str(path), "a file with at least one wall, or null for none")
    return segments, area


def in_sight(points: Array, anchors: Array, segments: Array | None) -> np.ndarray:
    """Mask (N, B) of the anchors (B, 2+) m in line of sight of each point (N, 2+) m.

    Seen from above, no wall (W, 2, 2) m meets the line from point to anchor. A line that touches a
    wall is blocked, so an anchor on a wall has to be a little in front of the wall.
    """
    clear = np.ones((len(points), len(anchors)), dtype=bool)
    if segments is None or not clear.size:
        return clear
    import shapely

    order = np.argsort(-np.hypot(*(segments[:, 1] - segments[:, 0]).T), kind="stable")
    groups = np.split(
        order, [len(order) // 8]
    )  # the longest walls first: they block most lines, which halves the work
    trees = [shapely.STRtree(shapely.linestrings(segments[group])) for group in groups]
    step = max(_AT_ONCE // len(anchors), 1)
    for first in range(0, len(points), step):
        part = points[first : first + step, None, :2]
        ways = np.stack(np.broadcast_arrays(part, anchors[None, :, :2]), axis=2).reshape(-1, 2, 2)
        lines, left = shapely.linestrings(ways), np.arange(len(ways))
        for tree in trees:
            hidden = np.zeros(len(left), dtype=bool)
            hidden[tree.query(lines[left], predicate="intersects")[0]] = True
            left = left[~hidden]
        clear[first : first + step] = np.isin(np.arange(len(ways)), left).reshape(-1, len(anchors))
    return clear


# --- files ----------------------------------------------------------------------------------------


def _text(key: str, path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8-sig")
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
            key, str(path), f"a finite number in every row; line {line} has {name}={cell!r}"
        )
    return value


def _geojson(key: str, path: Path) -> tuple[Array, float | None]:
    def bad(allowed: str) -> BadValue:
        return BadValue(key, str(path), allowed)

    try:
        content = json.loads(_text(key, path))
    except (ValueError, RecursionError):
        raise bad("a GeoJSON file; this one is not JSON") from None
    features = content.get("features") if isinstance(content, dict) else None
    if not isinstance(features, list) or content.get("type") != "FeatureCollection":
        raise bad("a GeoJSON FeatureCollection")
    if content.get("units", "m") != "m":
        raise bad(f"local coordinates in m; units is {content['units']!r}")
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
            f"feature {number} has the kind {kind!r} and the geometry {form!r}"
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
