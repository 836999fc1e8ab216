"""Anchors from a positioning_config.json of Silicon Labs' locators.

    locators: [{id, coordinate: {x, y, z} m, orientation: {x, y, z} deg}, ...]

A direction u in a locator's frame is Rz(z) Ry(y) Rx(x) u in the global axes. The array lies in the
frame's xy-plane and looks along its +z.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from aoabench import loaded
from aoabench.errors import BadValue, shorten
from aoabench.maths.geometry import Array, euler
from aoabench.types import Anchors

FORM = (
    "a .csv or .parquet file, or a positioning_config.json: a list locators of id, coordinate and "
    "orientation, each x, y, z"
)
MOST_DEG = 360.0
_LEVEL = 0.1  # horizontal part of a look direction below which a locator faces up or down


def is_config(path: str) -> bool:
    """Whether a .json file has locators, and not a table of anchors."""
    file = Path(path)
    if file.suffix.lower() != ".json" or not file.is_file():
        return False
    return b'"locators"' in loaded.read(file)[0]


def read_locators(key: str, path: str) -> tuple[list[str], Anchors, Array | None, tuple[str, ...]]:
    """The locators' ids, the anchors (1, 1, B, ...), the directions (B,) rad that they face, seen
    from above, None if one faces up or down, and remarks to print.

    Raises BadValue for a file of another form, for numbers that are not finite, for angles beyond
    +-360 deg, and for an id that occurs twice.
    """
    try:
        content = json.loads(loaded.read(Path(path))[0].decode("utf-8-sig"))
    except (OSError, ValueError, RecursionError):
        raise BadValue(key, path, f"{FORM}; this one is not JSON") from None
    locators = content.get("locators") if isinstance(content, dict) else None
    if not isinstance(locators, list) or not locators:
        raise BadValue(key, path, FORM)
    ids, places, turns, masked = [], [], [], []
    for number, node in enumerate(locators):
        one = node if isinstance(node, dict) else {}
        name = one.get("id")
        if not isinstance(name, str | int) or not str(name).strip() or str(name).strip() in ids:
            shown = shorten(repr(name), 60)
            raise BadValue(key, path, f"{FORM}, each id once; locator {number} has the id {shown}")
        ids.append(str(name).strip())
        where = f"locator {ids[-1]}"
        places.append(_triple(key, path, where, one, "coordinate", math.inf))
        turns.append(_triple(key, path, where, one, "orientation", MOST_DEG))
        config = one.get("config")
        masks = config if isinstance(config, dict) else {}
        masked += [ids[-1]] * any(masks.get(angle) for angle in ("azimuthMask", "elevationMask"))
    axes = np.array([euler(np.deg2rad(turn)) for turn in turns])  # columns: local x, y, z
    look = axes[:, :2, 2]
    level = np.hypot(*look.T) > _LEVEL
    facing = np.arctan2(look[:, 1], look[:, 0]) if level.all() else None
    line = f"{path}: the angles that {len(masked)} locators exclude (azimuthMask, elevationMask)"
    notes = (f"{line} are used where they are measured",) if masked else ()
    return ids, Anchors(np.array(places), axes.swapaxes(1, 2)), facing, notes


def _triple(
    key: str, path: str, where: str, node: dict[str, Any], name: str, most: float
) -> list[float]:
    """The numbers x, y and z of a member of a locator."""
    inner = node.get(name)
    values = [inner.get(axis) for axis in "xyz"] if isinstance(inner, dict) else []
    try:
        found = [float(v) for v in values if isinstance(v, int | float) and abs(v) <= most]
    except OverflowError:
        found = []
    if len(found) != 3 or not np.isfinite(found).all():
        limit = f" within +-{most:g}" if math.isfinite(most) else ""
        allowed = f"{FORM}, finite numbers{limit}; {where} has {name}={shorten(repr(inner), 80)}"
        raise BadValue(key, path, allowed)
    return found
