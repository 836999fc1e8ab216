"""GPX as the content of a table: a row for each point, with lat_deg, lon_deg and time.

The routes of a file are read, without any its tracks, without any its waypoints. Heights (`ele`)
count from the sea, those of anchors and walls from elsewhere: they are not read.
"""

from __future__ import annotations

import re
from xml.etree import ElementTree

from aoabench.devices.readers.reading import Part, Rows
from aoabench.errors import shorten

POINTS = ("rtept", "trkpt", "wpt")
_ROOT = re.compile(r"<(?:\w+:)?gpx[\s/>]")


def is_gpx(head: str) -> bool:
    """Whether the beginning of a text is that of GPX."""
    return head.lstrip()[:1] == "<" and _ROOT.search(head) is not None


def from_gpx(text: bytes, path: str) -> Rows:
    """The points of a GPX file, numbered from 0; raises ValueError for a file without any."""
    import pandas as pd

    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise ValueError(f"its GPX is torn: {shorten(str(error), 80)}") from None
    for kind in POINTS:
        points = [one for one in root.iter() if _name(one) == kind]
        if points:
            break
    else:
        raise ValueError("its GPX has no route, track or waypoints")
    within = [{_name(child): child.text for child in point} for point in points]
    columns = {"lat_deg": [p.get("lat") for p in points], "lon_deg": [p.get("lon") for p in points]}
    if any("time" in one for one in within):
        columns["time"] = [one.get("time") for one in within]
    line = f"{path}: heights (ele) are not read, because they count from the sea"
    notes = (line,) if any("ele" in one for one in within) else ()
    frame = pd.DataFrame(columns, dtype=object)
    return Rows(list(frame.columns), (Part(0, kind, 0),), notes, {}, frame)


def _name(element: ElementTree.Element) -> str:
    """An element's name without its namespace."""
    return element.tag.rpartition("}")[2]
