"""Walls from DXF drawings, by the library ezdxf.

Lines, polylines and curves of the model space are walls, in blocks too; curves become lines that
deviate by at most 1 cm. Layers that are switched off or frozen, texts, dimensions and hatches are
not read. Where no unit is declared, the drawing's unit is that of $INSUNITS.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Collection, Iterable, Iterator
from dataclasses import replace
from io import BytesIO
from typing import Any

import numpy as np

from aoabench.devices.plans.drawing import DOORS, UNITS, Door, Drawing
from aoabench.errors import listed, shorten
from aoabench.maths.geometry import Array

CURVES = ("LINE", "LWPOLYLINE", "POLYLINE", "ARC", "CIRCLE", "ELLIPSE", "SPLINE")
_UNITS = {1: "in", 2: "ft", 4: "mm", 5: "cm", 6: "m"}  # of $INSUNITS
_SAG_M = 0.01
DEPTH = 20
logging.getLogger("ezdxf").addHandler(logging.NullHandler())  # it prints parts of broken files


def read_drawing(
    content: bytes, file: str, layers: Collection[str] | None = None, unit: str | None = None
) -> Drawing:
    """The content of a DXF file, which remarks call `file`; `layers` are those of the walls, upper
    and lower case alike, None: all that are visible; `unit` is the declared unit, or None. Lines of
    layers called door, opening and so on are doors.

    Raises ValueError for content that is not DXF or lacks one of the layers, and without the
    library ezdxf; its message says what is allowed.
    """
    try:
        import ezdxf
        from ezdxf import recover
    except ImportError:
        needed = "a .geojson or .csv file; .dxf needs the library ezdxf: pip install aoabench[dxf]"
        raise ValueError(needed) from None
    try:
        document, _ = recover.read(BytesIO(content))
    except (OSError, ezdxf.DXFError, ValueError, IndexError, KeyError) as error:
        raise ValueError(f"a readable DXF file; {shorten(str(error), 80)}") from None
    wanted = None if layers is None else {one.strip().lower() for one in layers}
    stated = _UNITS.get(document.header.get("$INSUNITS", 0))
    found, used = _content(document, wanted, _SAG_M / UNITS[unit or stated or "m"])
    found = replace(found, default_unit=stated)
    line = f"{file}: walls of the layers {listed(sorted(used))}"
    return replace(found, notes=(line,)) if wanted is None and used else found


def _content(document: Any, wanted: set[str] | None, sag: float) -> tuple[Drawing, Counter[str]]:
    """The drawing in an ezdxf document, and the number of lines in each layer that is read; `sag`
    is the largest deviation of a curve.
    """
    hidden = {one.dxf.name.lower() for one in document.layers if one.is_off() or one.is_frozen()}
    lines: list[Array] = []
    doors: list[Door] = []
    used: Counter[str] = Counter()
    ignored: Counter[str] = Counter()
    for entity, layer in _entities(document.modelspace()):
        name = layer.lower()
        is_door = bool(DOORS & set(name.replace("-", " ").replace("_", " ").split()))
        if entity.dxftype() not in CURVES:
            ignored[entity.dxftype()] += 1
        elif name in hidden or not (wanted is None or name in wanted or is_door):
            ignored[f"lines of the layer {layer}"] += 1
        elif (found := _flat(entity, sag)) is None:
            ignored[entity.dxftype()] += 1
        else:
            doors += [Door(line) for line in found if is_door and len(line) == 2]
            lines += [] if is_door else found
            used[layer] += len(found)
    missing = sorted((wanted or set()) - {one.lower() for one in used})
    if missing:
        present = listed(sorted({one.dxf.name for one in document.layers}))
        raise ValueError(f"a drawing with lines in the layers {listed(missing)}; it has {present}")
    return Drawing(lines, doors, ignored=ignored), used


def _entities(
    content: Iterable[Any], around: str = "0", depth: int = 0
) -> Iterator[tuple[Any, str]]:
    """Entities and their layers, those of blocks too; layer 0 in a block is that of the block,
    `around`. Raises ValueError for blocks nested deeper than DEPTH.
    """
    if depth > DEPTH:
        raise ValueError(f"a drawing whose blocks are nested at most {DEPTH} deep")
    for entity in content:
        own = str(entity.dxf.get("layer", "0"))
        layer = around if own == "0" else own
        if entity.dxftype() != "INSERT":
            yield entity, layer
            continue
        for one in entity.multi_insert() if entity.mcount > 1 else [entity]:
            yield from _entities(one.virtual_entities(), layer, depth + 1)


def _flat(entity: Any, sag: float) -> list[Array] | None:
    """The entity's lines (K, 2), seen from above; `sag` is the largest deviation of a curve. None
    for an entity without lines, such as a mesh.
    """
    from ezdxf.path import make_path

    try:
        paths = list(make_path(entity).sub_paths())
    except (TypeError, ValueError):
        return None
    found = []
    for path in paths:
        points = np.array([(p.x, p.y) for p in path.flattening(sag)], dtype=float).reshape(-1, 2)
        if len(points) > 1 and np.isfinite(points).all():
            found.append(points)
    return found
