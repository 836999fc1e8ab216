"""Angles of Silicon Labs' locators from MQTT, as `mosquitto_sub -v`, `-F %j` or `-F %J` print them.

    silabs/aoa/angle/<locator>/<tag> {"azimuth": deg, "azimuth_stdev": deg, "elevation": deg,
        "elevation_stdev": deg, "distance": m, "distance_stdev": m, "sequence": n}

Angles are in the locator's frame, the azimuth counter-clockwise seen from its +z. A negative
deviation means that there was no line of sight. Other topics are not read. A time of the host may
stand in front of the topic, as `-F %j` writes it: {"tst": time, "topic": ..., "payload": ...}.
"""

from __future__ import annotations

import re
from collections import Counter

import numpy as np

from aoabench.devices.readers.lines import line_ends, line_starts, matched, numbers, pieces, texts
from aoabench.devices.readers.reading import Device, Part, Rows
from aoabench.devices.readers.stamps import seconds

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
_MESSAGE = (
    r"(?s)^(?P<torn>.*\n)?(?P<before>[^\n]*?)silabs/aoa/angle/"
    r'(?P<anchor>[^\s/{"]+)/(?P<tag>[^\s/{"]+)(?:"[^{\n]*)?\s*\{(?P<payload>[^{]*)$'
)
_NUMBER = r"-?\d+(?:\.\d+)?(?:[eE][+-]?\d+)?"
_TEXT = re.compile(r':\s*"')
_TOPIC = re.compile(r"silabs/aoa/(\w+)/")


def is_silabs(head: str) -> bool:
    return "silabs/aoa/" in head


def is_angles_alone(head: str) -> bool:
    """Whether the text has the payloads of angles without their topics, and no texts that may name
    locators and tags in their place.
    """
    payload = '"azimuth_stdev"' in head and '"sequence"' in head
    return payload and not is_silabs(head) and not _TEXT.search(head)


def angles(text: str, path: str, first: int = 1) -> Rows:
    """The angles of a text whose first line has the number `first`, with notes on what is left."""
    import pandas as pd

    if '\\"' in text:  # a payload within a text of JSON
        text = text.replace('\\"', '"').replace("\\n", " ").replace("\\t", " ")
    parts = pieces(text, "}")
    rows, groups = matched(parts, _MESSAGE)
    frame = pd.DataFrame({name: texts(groups[name]) for name in ("tag", "anchor")})
    for theirs, ours in COLUMNS.items():
        frame[ours] = np.full(len(rows), np.nan)
        some, value = matched(groups["payload"], rf'"{theirs}"\s*:\s*(?P<value>{_NUMBER})\s*[,\n]*')
        frame.loc[some, ours] = numbers(value["value"])
    times = seconds(groups["before"])
    if times is not None:
        frame["time_s"] = times
    frame.index = pd.Index(line_starts(parts)[rows] + line_ends(groups["torn"]))
    whole = frame[["azimuth_deg", "elevation_deg"]].notna().any(axis=1) & frame["sequence"].notna()
    frame = frame[whole]
    topics = Counter(_TOPIC.findall(text))
    notes = _left(path, topics["angle"] - len(frame), topics.total() - topics["angle"])
    return Rows(list(frame.columns), (Part(0, "line", first),), notes, STATED, frame)


def _left(path: str, torn: int, others: int) -> tuple[str, ...]:
    """Remarks on what is not read."""
    found = [f"{path}: {torn} angles without a whole payload, and not read"] if torn else []
    if others:
        found.append(f"{path}: {others} messages of other topics than silabs/aoa/angle, not read")
    return tuple(found)


SILABS = Device(
    name="silabs",
    words="Silicon Labs angles",
    whole='silabs/aoa/angle/locator/tag {"azimuth": ...}, as `mosquitto_sub -v` prints it',
    recognised=is_silabs,
    read=angles,
    end=re.compile(rb"\}[ \t\r]*\n"),
)
