"""Walls from DXF drawings, by the library ezdxf.

Lines, polylines and curves of the model space are walls, in blocks too; curves become lines that
deviate by at most 1 cm. Layers that are switched off or frozen, texts, dimensions and hatches are
not read. Where no unit is declared, the drawing's unit is that of $INSUNITS.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection
from dataclasses import replace
from io import BytesIO
from typing import Any

import numpy as np

from aoabench.devices.drawing import DOORS, UNITS, Door, Drawing
from aoabench.errors import listed, shorten
from aoabench.maths.geometry import Array

CURVES = ("LINE", "LWPOLYLINE", "POLYLINE", "ARC", "CIRCLE", "ELLIPSE", "SPLINE")
_UNITS = {1: "in", 2: "ft", 4: "mm", 5: "cm", 6: "m"}  # of $INSUNITS
_SAG_M = 0.01


def read_drawing(content: bytes, file: str, layers: Collection[str] | None = None) -> Drawing:
    """The content of a DXF file, which remarks call `file`; `layers` are those of the walls, upper
    and lower case alike, None: all that are visible. Lines of layers called door, opening and so on
    are doors.

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
    found, used = _content(document, wanted)
    line = f"{file}: walls of the layers {listed(sorted(used))}"
    return replace(found, notes=(line,)) if wanted is None and used else found


def _content(document: Any, wanted: set[str] | None) -> tuple[Drawing, Counter[str]]:
    """The drawing in an ezdxf document, and the number of lines in each layer that is read."""
    from ezdxf.disassemble import recursive_decompose

    hidden = {one.dxf.name.lower() for one in document.layers if one.is_off() or one.is_frozen()}
    unit = _UNITS.get(document.header.get("$INSUNITS", 0))
    sag = _SAG_M / UNITS[unit or "m"]
    lines: list[Array] = []
    doors: list[Door] = []
    used: Counter[str] = Counter()
    ignored: Counter[str] = Counter()
    for entity in recursive_decompose(document.modelspace()):
        layer = str(entity.dxf.get("layer", "0"))
        name = layer.lower()
        is_door = bool(DOORS & set(name.replace("-", " ").replace("_", " ").split()))
        if entity.dxftype() not in CURVES:
            ignored[entity.dxftype()] += 1
        elif name in hidden or not (wanted is None or name in wanted or is_door):
            ignored[f"lines of the layer {layer}"] += 1
        else:
            found = _flat(entity, sag)
            doors += [Door(line) for line in found if is_door and len(line) == 2]
            lines += [] if is_door else found
            used[layer] += len(found)
    missing = sorted((wanted or set()) - {one.lower() for one in used})
    if missing:
        present = listed(sorted({one.dxf.name for one in document.layers}))
        raise ValueError(f"a drawing with lines in the layers {listed(missing)}; it has {present}")
    return Drawing(lines, doors, default_unit=unit, ignored=ignored), used


def _flat(entity: Any, sag: float) -> list[Array]:
    """The entity's lines (K, 2), seen from above; `sag` is the largest deviation of a curve."""
    from ezdxf.path import make_path

    found = []
    for path in make_path(entity).sub_paths():
        points = np.array([(p.x, p.y) for p in path.flattening(sag)], dtype=float).reshape(-1, 2)
        if len(points) > 1 and np.isfinite(points).all():
            found.append(points)
    return found
