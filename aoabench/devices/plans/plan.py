"""Walls of floor plans from GeoJSON, CSV or DXF, as local coordinates in m.

A file is looked for in the working folder first, then among the shipped plans. Coordinates are
local, in m or in a declared unit, or geodetic, where they are declared to be or an origin is known
near them. Every mistake in a file raises BadValue with the key, the file and the allowed content.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from aoabench import loaded
from aoabench.devices.geodesy import Origin, check_degrees, from_projected, names_wgs84
from aoabench.devices.plans import dxf, geojson
from aoabench.devices.plans.doors import WIDTH_M, cut
from aoabench.devices.plans.drawing import UNITS, Drawing
from aoabench.devices.readers.columns import header, shown_columns
from aoabench.devices.readers.sources import text_of
from aoabench.devices.readers.table import Table
from aoabench.errors import BadValue, shorten
from aoabench.maths.geometry import Array
from aoabench.resources import shipped

WALL_COLUMNS = ("x0_m", "y0_m", "x1_m", "y1_m")
LEAST_M = 1.0  # extent below which a plan within the range of degrees is not taken for one in m
SAME_M = 1e-4  # corners of two walls nearer than this are one
TABLES = (".csv", ".tsv", ".txt", ".xlsx", ".parquet", ".pq")
FORMS = "a file .geojson (or .json), .csv (or another table) or .dxf (save .dwg as .dxf)"


class Plan(NamedTuple):
    """Walls (W, 2, 2) m, each from one point to another; the visited area in m^2 or None; remarks
    to print; the unit of the coordinates, None if none was declared and m was taken; whether they
    were geodetic.
    """

    walls: Array
    area_m2: float | None = None
    notes: tuple[str, ...] = ()
    unit: str | None = None
    geodetic: bool = False


class Frame(NamedTuple):
    """How the coordinates of a plan are declared: the unit, None for m or as the file states; the
    reference system (local, wgs84, or a name such as EPSG:25832), None for local or as the file
    states; the origin of local coordinates, None where it is unknown; the layers (or kinds of
    features) that are walls, None for all.
    """

    unit: str | None = None
    crs: str | None = None
    origin: Origin | None = None
    layers: Sequence[str] | None = None


def find(key: str, name: object) -> Path:
    """Path of the file `name`: in the working folder, or else among the shipped plans.

    Raises BadValue if there is none.
    """
    plans = shipped("configs") / "plans"
    if isinstance(name, str) and name.strip() and "\0" not in name:
        for path in (Path(name), plans / name):
            if path.is_file():
                return path.resolve()
    known = ", ".join(sorted(file.name for file in plans.glob("*.*")))
    raise BadValue(key, name, f"an existing file; shipped: {known}")


def read_plan(key: str, path: Path, frame: Frame | None = None) -> Plan:
    """The walls of a file whose coordinates `frame` declares.

    CSV has the columns x0_m, y0_m, x1_m, y1_m. `devices.plans.geojson` and `devices.plans.dxf`
    describe the other forms. Doors are cut out of the walls.

    Raises BadValue for coordinates that are, or look like, degrees and are not declared, for
    degrees without an origin, and for a file that states another unit. Coordinates that look like
    degrees near a known origin are degrees.
    """
    frame = frame or Frame()
    drawing = _drawing(key, path, frame)
    if not len(drawing.segments):
        doors = f"{len(drawing.doors)} doors" if drawing.doors else ""
        content = ", ".join(filter(None, (doors, drawing.others)))
        content = f"; it has {content}" if content else ""
        raise BadValue(key, str(path), f"a file with at least one wall, or null for none{content}")
    geodetic = _is_geodetic(key, path, drawing, frame)
    unit = frame.unit
    if unit is None and not geodetic and drawing.default_unit not in (None, "m"):
        unit = drawing.default_unit
    local = (_projected if geodetic else _scaled)(key, path, drawing, frame._replace(unit=unit))
    walls, unused = cut(_once(local.segments), local.doors)
    area = sum(geojson.enclosed(rings) for rings in local.visited) if local.visited else None
    lines = _notes(local, unused)
    if unit != frame.unit:
        lines.append(f"read in {unit}, as the drawing states")
    elif drawing.default_unit not in (None, unit or "m"):
        lines.append(
            f"read in {unit or 'm'}, as declared; the drawing states {drawing.default_unit}"
        )
    notes = (*local.notes, *(f"{path.name}: {line}" for line in lines))
    return Plan(walls, area, notes, unit, geodetic)


def _once(walls: Array) -> Array:
    """The walls (W, 2, 2) m without those that equal an earlier one, such as that of the next room,
    within SAME_M.
    """
    ends = np.rint(walls / SAME_M).astype(np.int64)
    flip = (ends[:, 0, 0] > ends[:, 1, 0]) | (
        (ends[:, 0, 0] == ends[:, 1, 0]) & (ends[:, 0, 1] > ends[:, 1, 1])
    )
    ends[flip] = ends[flip][:, ::-1]
    flat = ends.reshape(-1, 4)
    order = np.lexsort((np.arange(len(flat)), *flat.T))  # equal ones in the order of the file
    new = np.ones(len(flat), dtype=bool)
    new[1:] = (flat[order[1:]] != flat[order[:-1]]).any(axis=1)
    return np.asarray(walls[np.sort(order[new])])


def _notes(drawing: Drawing, unused: int) -> list[str]:
    """Remarks on a drawing in m, of whose doors `unused` open no wall."""
    found, doors = [], drawing.doors
    if doors:
        wide = sum(len(door.points) == 1 and door.width_m is None for door in doors)
        assumed = f"; {wide} of no stated width are {WIDTH_M:g} m wide" * bool(wide)
        found.append(
            f"{len(doors)} doors, {len(doors) - unused} of them cut out of the walls{assumed}"
        )
    if drawing.ignored:
        found.append(f"no walls, left out: {drawing.others}")
    return found


def _drawing(key: str, path: Path, frame: Frame) -> Drawing:
    """The content of a file, in its own coordinates."""
    kind = path.suffix.lower()
    if kind in TABLES:
        table = Table.read(key, str(path), {name: name for name in _columns(key, path)})
        ends = np.stack([table.numbers(name, empty=False) for name in WALL_COLUMNS], axis=-1)
        return Drawing(list(ends.reshape(-1, 2, 2)), notes=table.notes)
    try:
        if kind in (".geojson", ".json"):
            return geojson.read_drawing(_text(key, path), path.name, frame.layers)
        if kind == ".dxf":
            return dxf.read_drawing(loaded.read(path)[0], path.name, frame.layers, frame.unit)
    except ValueError as error:
        raise BadValue(key, str(path), str(error)) from None
    raise BadValue(key, str(path), FORMS)


# --- coordinates ----------------------------------------------------------------------------------


def _is_geodetic(key: str, path: Path, drawing: Drawing, frame: Frame) -> bool:
    """Whether the coordinates are to be converted with the origin; raises BadValue for those that
    state, or seem to have, another system than declared.
    """
    if frame.crs is not None:
        return frame.crs != "local"
    points = drawing.segments.reshape(-1, 2)
    stated = drawing.crs
    if stated is not None:
        if names_wgs84(stated) and bool(np.all(np.abs(points) <= [180, 90])):
            return True
        words = f"local coordinates; its crs is {shorten(repr(stated), 60)}"
        allowed = (
            f"{words}: scenario.walls_crs=local if x and y are lengths in a plane all the same, "
            "or walls_crs=wgs84, or the system's name, such as EPSG:25832"
        )
        raise BadValue(key, str(path), allowed)
    extent = float(np.ptp(points, axis=0).max())
    if extent < LEAST_M and np.all(np.abs(points) <= [180, 90]):
        x, y = points[0]
        if frame.origin is not None and frame.origin.is_near(y, x):
            return True
        allowed = (
            f"walls in m; these span {extent:.3g} near ({x:.6g}, {y:.6g}), which looks like "
            "degrees of longitude and latitude: scenario.walls_crs=wgs84 if they are, or "
            "scenario.walls_crs=local if the plan is that small"
        )
        raise BadValue(key, str(path), allowed)
    return False


def _scaled(key: str, path: Path, drawing: Drawing, frame: Frame) -> Drawing:
    """The drawing in m; raises BadValue if the file states another unit than declared."""
    unit, stated = frame.unit, drawing.unit
    if stated is not None and stated != (unit or "m"):
        known = stated in UNITS
        wanted = f"scenario.walls_unit={stated}?" if known else "convert them to m"
        given = f"its units is {shorten(repr(stated), 60)}"
        allowed = f"local coordinates in {unit or 'm'}; {given}: {wanted}"
        raise BadValue(key, str(path), allowed)
    scale = UNITS[unit or "m"]
    return drawing if scale == 1 else drawing.mapped(lambda points: points * scale)


def _projected(key: str, path: Path, drawing: Drawing, frame: Frame) -> Drawing:
    """The drawing in local m, from degrees or from a declared projected system."""
    projected = frame.crs not in (None, "wgs84")
    if frame.unit not in ((None, "m") if projected else (None,)):
        allowed = f"null with coordinates in {frame.crs or 'degrees'}"
        raise BadValue("walls_unit", frame.unit, allowed)

    def degrees(points: Array) -> tuple[Array, Array]:
        if projected:
            return from_projected("walls_crs", str(frame.crs), points)
        return points[:, 1], points[:, 0]

    lat, lon = degrees(drawing.segments.reshape(-1, 2))
    check_degrees(key, str(path), lat, lon, frame.origin)
    origin = frame.origin
    if origin is None:
        system = "its crs" if frame.crs is None else "scenario.walls_crs"
        allowed = (
            "latitude and longitude of the local (0, 0), because the anchors are in m, and "
            f"{path.name} is not ({system} is {(frame.crs or drawing.crs)!r}); its centre: "
            f"{Origin.amid(lat, lon)}"
        )
        raise BadValue("origin_deg", None, allowed)
    return drawing.mapped(lambda points: origin.local(*degrees(points))[:, :2])


# --- files ----------------------------------------------------------------------------------------


def _text(key: str, path: Path) -> str:
    try:
        return text_of(path).decode()
    except (OSError, ValueError):
        raise BadValue(key, str(path), "a readable file in UTF-8 or UTF-16") from None


def _columns(key: str, path: Path) -> Sequence[str]:
    """The columns of walls; raises BadValue unless a table has each of them once."""
    allowed = f"a table with the columns {', '.join(WALL_COLUMNS)}, each once"
    if not path.stat().st_size:
        raise BadValue(key, str(path), f"{allowed}; it is empty")
    present = header(key, str(path))
    if any(present.count(name) != 1 for name in WALL_COLUMNS):
        raise BadValue(key, str(path), f"{allowed}; it has {shown_columns(present)}")
    return WALL_COLUMNS
