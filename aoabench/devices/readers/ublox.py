"""Lines of u-blox direction finding (u-connectLocate), as recorded from UART, USB or UDP.

    +UUDF:<tag>,<rssi>,<azimuth>,<elevation>,<rssi 2>,<channel>,"<anchor>","<text>",<ms>[,<number>]

Angles in deg, the azimuth positive to the right as seen from the antenna, thus clockwise from
above; ms since the boot of that anchor. A time of the host may stand in front. +UUDFP lines and
other answers of the modem are not read.
"""

from __future__ import annotations

from aoabench.devices.readers.lines import matched, numbers, pieces, texts
from aoabench.devices.readers.reading import Device, Part, Rows
from aoabench.devices.readers.stamps import seconds

MARK = "+UUDF:"
STATED = {
    "azimuth_unit": "deg",
    "azimuth_sense": "clockwise",
    "elevation_unit": "deg",
    "elevation_kind": "elevation",
    "time_unit": "s",
}
COLUMNS = (
    "tag", "rssi_dbm", "azimuth_deg", "elevation_deg", "rssi_2_dbm", "channel", "anchor", "text",
    "anchor_time_s", "sequence",
)  # fmt: skip
TEXTS = ("tag", "anchor", "text")
_ANGLE = r"-?\d+(?:\.\d+)?|"
_FIELDS = (r"\w+", r"-?\d+|", _ANGLE, _ANGLE, r"-?\d+|", r"\d+|")
_LINE = (
    r"^(?P<before>.*?)\+UUDF:"
    + ",".join(f"(?P<{name}>{form})" for name, form in zip(COLUMNS, _FIELDS))
    + r',"(?P<anchor>[^"]*)","(?P<text>[^"]*)",(?P<anchor_time_s>\d+),?(?P<sequence>\d*)\s*$'
)


def packets(text: str, path: str, first: int = 1) -> Rows:
    """The packets of a text whose first line has the number `first`; time_s only if the host's
    times stand in front, sequence and anchor only where a line has them.
    """
    import pandas as pd

    rows, groups = matched(pieces(text, "\n"), _LINE)
    frame = pd.DataFrame(
        {name: texts(groups[name]) if name in TEXTS else numbers(groups[name]) for name in COLUMNS},
        index=pd.RangeIndex(len(rows)),
    )
    frame["anchor_time_s"] /= 1e3
    absent = {"sequence": frame["sequence"].isna().all(), "anchor": (frame["anchor"] == "").all()}
    frame = frame.drop(columns=[name for name, none in absent.items() if none])
    times = seconds(groups["before"])
    if times is not None:
        frame["time_s"] = times
    frame.index = pd.Index(rows)
    notes = _garbled(text, len(rows), path)
    return Rows(list(frame.columns), (Part(0, "line", first),), notes, STATED, frame)


def _garbled(text: str, read: int, path: str) -> tuple[str, ...]:
    """A remark on lines that are cut or garbled, as on a serial line that drops bytes."""
    lost = text.count(MARK) - read
    return (f"{path}: {lost} +UUDF lines are cut or garbled, and not read",) if lost > 0 else ()


UBLOX = Device(
    name="ublox",
    words="u-blox lines (+UUDF)",
    whole='+UUDF:tag,rssi,azimuth,elevation,rssi,channel,"anchor","text",ms[,number]',
    recognised=lambda head: MARK in head,
    read=packets,
)
