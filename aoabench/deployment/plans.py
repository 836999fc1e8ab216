"""The walls of a floor plan, for the map."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from aoabench.deployment.request import Asked
from aoabench.devices.plans.drawing import UNITS
from aoabench.devices.plans.extent import Thing, check_walls
from aoabench.devices.plans.plan import Frame, Plan, read_plan
from aoabench.errors import BadValue, UserError, did_you_mean

KEYS = {"walls_unit": "unit", "walls_crs": "crs", "walls_layers": "layers"}


def plan(path: str, asked: Asked, settings: Mapping[str, Any]) -> Plan:
    """The plan in a file, in the local coordinates of the recording.

    settings: what the user declares of its coordinates, by the KEYS. Raises UserError for a file
    that is no plan, and for coordinates or units that do not fit those of the anchors.
    """
    for key in settings:
        if key not in KEYS:
            allowed = f"; allowed: {', '.join(KEYS)}"
            raise UserError(f"scenario.{key}: unknown key{did_you_mean(key, KEYS) or allowed}")
    given = {KEYS[key]: value for key, value in settings.items()}
    if not Path(path).is_file():
        raise BadValue("--plan", path, "an existing file .geojson (or .json), .csv or .dxf")
    frame = Frame(origin=asked.scenario.anchors_file.origin, **given)
    try:
        found = read_plan("--plan", Path(path), frame)
        if not found.geodetic:
            asked.scenario.anchors_file.check_local("the plan is local")
        anchors = Thing("anchors", "anchors", None, asked.scenario.true_anchors.position)
        walls = Thing("walls", "--plan", path, found.walls)
        check_walls(walls, anchors, anchors, UNITS, found.unit, sights=True)
    except BadValue as error:
        own = error.key in (*KEYS, "origin_deg")
        key = f"scenario.{error.key}" if own else error.key
        raise BadValue(key, error.value, error.allowed) from None
    return found
