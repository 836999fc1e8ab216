"""Walls and doors from GeoJSON: a FeatureCollection, a Feature or a geometry.

Lines and the outlines of polygons are walls. What a feature is stands in its properties:

    kind        wall, room, visited (the visited area, a polygon), door; other kinds are ignored
    otherwise   feature_type, category, type, indoor, class, layer: door, or else it is a wall
    door        of a point (OpenStreetMap): yes or a type of door; width or door:width in m
    level       features of several levels are read as one floor, which is noted

Points that are no doors are ignored and counted.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from aoabench.devices.plans.drawing import DOORS, Door, Drawing
from aoabench.errors import listed, shorten
from aoabench.maths.geometry import Array

WALLS = frozenset(("wall", "walls", "room", "rooms", "outline", "unit", "building"))
_DEPTH = {"Point": 0, "MultiPoint": 1, "LineString": 1, "MultiLineString": 2, "Polygon": 2,
          "MultiPolygon": 3}  # fmt: skip
_NOWHERE = "without a geometry"
_WORDS = ("feature_type", "category", "type", "indoor", "class", "layer", "Layer")
_LEVELS = ("level", "level_id", "floor")
_WIDTHS = ("width_m", "width", "door:width")


class _Part(NamedTuple):
    """One geometry of a feature: the feature's number and properties, its form and coordinates."""

    number: int
    properties: dict[str, Any]
    form: str
    coordinates: Any

    @property
    def word(self) -> str:
        """What the feature is: wall, visited, door, or another word."""
        kind = self.properties.get("kind")
        if kind is not None:
            word = str(kind).strip().lower()
            return "wall" if word in WALLS else "door" if word in DOORS else word
        opens = self.properties.get("door") not in (None, False, "", "no")
        return "door" if opens or DOORS & self.layers else "wall"

    @property
    def layers(self) -> set[str]:
        """The words that say what the feature is, in lower case."""
        words = (self.properties.get(name) for name in ("kind", *_WORDS))
        return {word.strip().lower() for word in words if isinstance(word, str)}

    @property
    def level(self) -> str:
        """The floor that the feature belongs to, or an empty text."""
        stated = (self.properties.get(name) for name in _LEVELS)
        return next((str(level) for level in stated if level is not None), "")

    @property
    def width_m(self) -> float | None:
        """The stated width of a door, or None."""
        for name in _WIDTHS:
            try:
                width = float(self.properties[name])
            except (KeyError, TypeError, ValueError):
                continue
            if 0 < width < 100:
                return width
        return None


def read_drawing(text: str, file: str, layers: Collection[str] | None = None) -> Drawing:
    """The content of a GeoJSON text, which remarks call `file`; `layers` are the words of the
    features to read, None: all.

    Raises ValueError for content that is not GeoJSON or has broken coordinates; its message says
    what is allowed.
    """
    try:
        content = json.loads(text)
    except (ValueError, RecursionError):
        raise ValueError("a GeoJSON file; this one is not JSON") from None
    lines: list[Array] = []
    doors: list[Door] = []
    visited: list[list[Array]] = []
    ignored: Counter[str] = Counter()
    levels: dict[str, None] = {}
    wanted = None if layers is None else {word.strip().lower() for word in layers}
    for part in _parts(content):
        word = part.word
        point = part.form in ("Point", "MultiPoint")
        if part.form == _NOWHERE:
            ignored[_NOWHERE] += 1
        elif wanted is not None and word not in ("door", "visited") and not part.layers & wanted:
            ignored[" or ".join(sorted(part.layers)) or "without a kind"] += 1
        elif word not in ("wall", "visited", "door") or (point and word != "door"):
            ignored[part.form if word in ("wall", "visited") else shorten(word, 30)] += 1
        elif word == "door":
            area = "Polygon" in part.form
            doors += [Door(one, area, part.width_m) for one in _lines(part)]
        elif word == "visited":
            visited += _areas(part)
        else:
            lines += _lines(part)
            levels[part.level] = None
    names = [level for level in levels if level]
    notes = (f"{file}: the levels {listed(names)} are read as one floor",) if len(names) > 1 else ()
    node = _mapping(content)
    unit = node.get("units")
    stated = unit if unit is None or isinstance(unit, str) else repr(unit)
    crs = _crs(node.get("crs"))
    return Drawing(lines, doors, visited, stated, crs, ignored=ignored, notes=notes)


def _parts(content: Any) -> Iterator[_Part]:
    """The geometries of a GeoJSON object; raises ValueError for another object."""
    node = _mapping(content)
    kind, features = node.get("type"), node.get("features")
    if kind == "FeatureCollection" and isinstance(features, list):
        found = features
    elif kind == "Feature" and isinstance(node.get("geometry"), dict):
        found = [node]
    elif isinstance(kind, str) and kind in (*_DEPTH, "GeometryCollection"):
        found = [{"geometry": node}]
    else:
        raise ValueError("a GeoJSON FeatureCollection, a Feature or a geometry")
    for number, feature in enumerate(found):
        whole = _mapping(feature)
        properties = dict(_mapping(whole.get("properties")))
        if isinstance(whole.get("feature_type"), str):
            properties.setdefault("feature_type", whole["feature_type"])
        if whole and whole.get("geometry") is None:
            yield _Part(number, properties, _NOWHERE, None)
            continue
        for geometry in _flat(whole.get("geometry")):
            form = geometry.get("type")
            if not isinstance(form, str) or form not in _DEPTH:
                known = ", ".join(_DEPTH)
                shown = shorten(repr(form), 60)
                raise ValueError(f"geometries {known}; feature {number} has the geometry {shown}")
            yield _Part(number, properties, form, geometry.get("coordinates"))


def _flat(geometry: Any) -> Iterator[dict[str, Any]]:
    """A geometry, or the geometries of a GeometryCollection."""
    todo = [_mapping(geometry)]
    while todo:
        one = todo.pop(0)
        inner = one.get("geometries")
        if one.get("type") == "GeometryCollection" and isinstance(inner, list):
            todo = [*map(_mapping, inner), *todo]
        else:
            yield one


def _areas(part: _Part) -> list[list[Array]]:
    """The rings of each polygon; raises ValueError for another geometry."""
    if part.form == "Polygon":
        return [_lines(part)]
    if part.form == "MultiPolygon" and isinstance(part.coordinates, list):
        one = "Polygon"
        return [_lines(part._replace(form=one, coordinates=rings)) for rings in part.coordinates]
    raise ValueError(
        "the visited area (kind visited) as Polygon; "
        f"feature {part.number} has the kind 'visited' and the geometry {part.form!r}"
    )


def _lines(part: _Part) -> list[Array]:
    """The lines (K, 2) of a geometry, those of a polygon closed; a point is a line of one point.

    Raises ValueError for broken coordinates.
    """
    nested = [part.coordinates]
    for _ in range(_DEPTH[part.form] - (part.form not in ("Point", "MultiPoint"))):
        nested = [one for some in nested for one in (some if isinstance(some, list) else [None])]
    least = 1 if part.form in ("Point", "MultiPoint") else 2
    found = [_line([one] if least == 1 else one, least) for one in nested]
    good = [line for line in found if line is not None]
    if not good or len(good) < len(found):
        raise ValueError(
            "lines of at least two points [x, y] of finite numbers; "
            f"feature {part.number} has others"
        )
    return [_closed(line) for line in good] if "Polygon" in part.form else good


def _line(node: Any, least: int) -> Array | None:
    """Points (K, 2) without heights, K >= least; None if `node` has others."""
    try:
        line = np.array([point[:2] for point in node], dtype=float)
    except (TypeError, ValueError):
        return None
    fits = line.ndim == 2 and len(line) >= least and line.shape[1] == 2
    return line if fits and np.all(np.isfinite(line)) else None


def _closed(ring: Array) -> Array:
    """A ring (K, 2) whose last point is its first one."""
    return ring if np.array_equal(ring[0], ring[-1]) else np.concatenate([ring, ring[:1]])


def enclosed(rings: Sequence[Array]) -> float:
    """The area within the first of closed rings of points (K, 2), less the areas of the others."""
    outside, *holes = (
        abs(np.sum(x[:-1] * y[1:] - x[1:] * y[:-1])) / 2
        for x, y in ((ring - ring[0]).T for ring in rings)
    )
    return float(outside - sum(holes))


def _crs(node: Any) -> str | None:
    """The name in a GeoJSON member `crs`, or the member itself; None without it."""
    if node is None:
        return None
    name = _mapping(_mapping(node).get("properties")).get("name", node)
    return name if isinstance(name, str) else shorten(repr(name), 60)


def _mapping(node: Any) -> dict[str, Any]:
    return node if isinstance(node, dict) else {}
