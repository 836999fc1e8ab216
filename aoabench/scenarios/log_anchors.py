"""The anchors of a recording, and the columns that are read from its log."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from aoabench.devices.anchors import AnchorsFile, read_anchors
from aoabench.devices.geodesy import Origin
from aoabench.devices.readers.columns import found_column
from aoabench.devices.readers.formats import opened
from aoabench.devices.readers.reading import Content
from aoabench.devices.readers.table import Table
from aoabench.devices.tracks import identity, log
from aoabench.devices.tracks.naming import chosen_columns, default_names
from aoabench.devices.tracks.packets import check_truth, names_of
from aoabench.devices.tracks.poses import DEFAULTS, DEGREES, METRES, TURNS, check_columns, receivers
from aoabench.errors import BadValue, listed
from aoabench.scenarios.layout import AnchorLayout
from aoabench.scenarios.log_parameters import LogParameters

NEEDED = (
    "an existing file of the anchors' positions and facings (columns id, x_m, y_m, z_m, facing_deg)"
    ", or a log with the positions of receivers that move (columns anchor_x_m and anchor_y_m, or "
    "anchor_lat_deg and anchor_lon_deg; scenario.columns.anchor_x ... declare other names)"
)


def anchors_of(place: LogParameters) -> AnchorsFile:
    """The anchors (1, 1, B, ...) of a layout or a file, or those that the log itself places."""
    if isinstance(place.anchors, AnchorLayout):
        B = len(place.anchors.position_m)
        ids = list(map(str, range(1, B + 1) if place.anchor_ids is None else place.anchor_ids))
        if len(ids) != B or len(set(ids)) < B:
            allowed = f"{B} different ids, one for each anchor, or null"
            raise BadValue("anchor_ids", place.anchor_ids, allowed)
        return AnchorsFile(ids, place.anchors.known, None, ())
    if place.anchor_ids is not None:
        allowed = "null, unless scenario.anchors is a layout: a file may have the column id"
        raise BadValue("anchor_ids", place.anchor_ids, allowed)
    origin = Origin.given(place.origin_deg)
    if place.anchors is None:
        return _of_log(place, origin)
    return read_anchors("anchors", place.anchors, origin)


def _of_log(place: LogParameters, origin: Origin | None) -> AnchorsFile:
    """The receivers of a log with their positions; raises BadValue for one without."""
    content = opened("path", place.path, place.reading)
    chosen = columns_of(place, content)
    own = {ours: name for ours, name in chosen.items() if ours in ("anchor", *DEFAULTS)}
    table = Table.of(content, "path", place.path, own)
    if "anchor" in own:
        number, ids = names_of(table, "anchor")
    else:
        number, ids = np.zeros(table.count, dtype=int), ["1"]
    return receivers(table, number, ids, origin)


def conventions_of(place: LogParameters, content: Content) -> tuple[log.Conventions, str]:
    """The conventions of a log's angles, and the unit of its times."""
    declared = place.declared(dict(content.stated))
    found = log.Conventions(**{name: declared[name] for name in log.Conventions._fields})
    return found, declared["time_unit"]


def columns_of(place: LogParameters, content: Content) -> dict[str, str]:
    """Map from aoabench's column names to the log's, for the columns to read."""
    conventions, time_unit = conventions_of(place, content)
    heading = {"heading"} if conventions.needs_heading else set()
    unused = {"heading"} - heading
    unused |= {"elevation", "elevation_sigma"} if place.elevation_kind == "none" else set()
    unused |= set() if place.turns else set(TURNS)
    named = {name: one for name, one in asdict(place.columns).items() if name not in unused}
    present, names = list(content.columns), default_names(conventions, time_unit)
    moving = _moving(place, named, present)
    required = {"azimuth"} | heading | (set() if moving else {"anchor"})
    chosen = chosen_columns(place.path, present, named, names, required)
    check_columns(chosen, place.path)
    own = check_truth(chosen, place.path)
    if place.truth_file is not None and own:
        allowed = f"null, for a log with true positions of its own; it has {listed(own)}"
        raise BadValue("truth", place.truth_file, allowed)
    if "tag" in chosen:
        return chosen
    return chosen | identity.suspects(present, list(chosen.values()))


def _moving(place: LogParameters, named: dict[str, Any], present: list[str]) -> bool:
    """Whether there is no file of anchors; BadValue if the log has no positions either."""
    if place.anchors is not None:
        return False
    places = (*METRES, *DEGREES)
    if not any(named[one] or found_column([DEFAULTS[one]], present) for one in places):
        raise BadValue("anchors", None, NEEDED)
    return True
