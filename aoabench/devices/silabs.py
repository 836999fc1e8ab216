"""Silicon Labs' locators: angles from MQTT, as `mosquitto_sub -v` prints them, and their places.

    silabs/aoa/angle/<locator>/<tag> {"azimuth": deg, "azimuth_stdev": deg, "elevation": deg,
        "elevation_stdev": deg, "distance": m, "distance_stdev": m, "sequence": n}

Angles are in the locator's frame, the azimuth counter-clockwise seen from its +z. A negative
deviation means that there was no line of sight. Other topics are not read. A time of the host may
stand in front of the topic. positioning_config.json has the locators' coordinates in m, and their
orientations as Rz(z) Ry(y) Rx(x) in deg.
"""

from __future__ import annotations

import json
import re
from typing import Any

import numpy as np

from aoabench.devices.reading import Part, Rows
from aoabench.devices.stamps import seconds

STATED = {
    "azimuth_unit": "deg",
    "azimuth_sense": "counterclockwise",
    "elevation_unit": "deg",
    "elevation_kind": "elevation",
    "negative_sigma": "absent",
    "time_unit": "s",
}
COLUMNS = {
    "azimuth": "azimuth_deg",
    "azimuth_stdev": "azimuth_sigma_deg",
    "elevation": "elevation_deg",
    "elevation_stdev": "elevation_sigma_deg",
    "distance": "range_m",
    "distance_stdev": "range_sigma_m",
    "sequence": "sequence",
}
_TOPIC = re.compile(r"^([^\n{}]*?)\bsilabs/aoa/(\w+)/([^\s/{]+)(?:/([^\s/{]+))?\s*", re.M)
_PAYLOAD = re.compile(r"\{[^{}]*\}")


def is_silabs(head: str) -> bool:
    return "silabs/aoa/" in head


def is_angles_alone(head: str) -> bool:
    """Whether the text has the payloads of angles without their topics."""
    return '"azimuth_stdev"' in head and '"sequence"' in head and not is_silabs(head)


def silabs(text: str, path: str, first: int = 1) -> Rows:
    """The angles of a text whose first line has the number `first`, with notes on what is left."""
    import pandas as pd

    kept, bad, others = [], 0, 0
    for topic in _TOPIC.finditer(text):
        if topic[2] != "angle" or topic[4] is None:
            others += 1
            continue
        payload = _PAYLOAD.match(text, topic.end())
        values = _values(payload[0]) if payload else None
        if values is None:
            bad += 1
            continue
        kept.append((topic, values))
    frame = pd.DataFrame([values for _, values in kept], columns=list(COLUMNS.values()))
    frame.insert(0, "anchor", [topic[3] for topic, _ in kept])
    frame.insert(0, "tag", [topic[4] for topic, _ in kept])
    times = seconds([topic[1] for topic, _ in kept])
    if times is not None:
        frame["time_s"] = times
    ends = np.flatnonzero(np.frombuffer(text.encode("utf-32-le"), dtype="<u4") == ord("\n"))
    frame.index = pd.Index(np.searchsorted(ends, [topic.start(2) for topic, _ in kept]))
    notes = [f"{path}: {bad} angles without a whole payload, and not read"] if bad else []
    if others:
        notes.append(f"{path}: {others} messages of other topics than silabs/aoa/angle, not read")
    return Rows(list(frame.columns), (Part(0, "line", first),), tuple(notes), STATED, frame)


def _values(payload: str) -> tuple[float, ...] | None:
    """The numbers of a payload in the order of COLUMNS, NaN where absent; None if it is torn."""
    try:
        found = json.loads(payload)
        return tuple(float(found.get(name, "nan")) for name in COLUMNS)
    except (ValueError, TypeError):
        return None


def is_config(found: Any) -> bool:
    """Whether a JSON document is a positioning_config.json."""
    return isinstance(found, dict) and isinstance(found.get("locators"), list)


def locators(found: dict[str, Any], path: str) -> Rows:
    """The locators of a positioning_config.json as anchors; raises ValueError if one lacks its id
    or coordinates.
    """
    import pandas as pd

    rows = []
    for i, one in enumerate(found["locators"], start=1):
        try:
            place, turn = one["coordinate"], one.get("orientation") or {}
            angles = [turn.get(axis, 0.0) for axis in "zyx"]
            rows.append([str(one["id"]), *(place[axis] for axis in "xyz"), *angles])
        except (KeyError, TypeError, AttributeError):
            words = "id and coordinate: {x, y, z}"
            raise ValueError(f"a locator has {words}; locator {i} has not") from None
    names = ["id", "x_m", "y_m", "z_m", "facing_deg", "pitch_deg", "roll_deg"]
    frame = pd.DataFrame(rows, columns=names)
    masked = [one["id"] for one in found["locators"] if _has_mask(one.get("config"))]
    words = "exclude angles (azimuthMask, elevationMask), which are used where they are measured"
    notes = (f"{path}: {len(masked)} locators {words}",) if masked else ()
    return Rows(names, (Part(0, "locator", 1),), notes, {}, frame)


def _has_mask(config: Any) -> bool:
    """Whether a locator's configuration excludes angles."""
    masks = ("azimuthMask", "elevationMask")
    return isinstance(config, dict) and any(config.get(mask) for mask in masks)
