"""Columns of a log that are not read although they look like the identity of what is located."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from aoabench.devices.readers.reading import UNREAD
from aoabench.devices.tracks.grouping import Groups
from aoabench.devices.tracks.packets import Packets
from aoabench.errors import BadValue, shorten

_THINGS = (
    "tag|device|dev|mac|macaddress|address|beacon|badge|asset|mobile|target|transmitter|instance|"
    "edinstance|user|person|robot|uuid|uid|epc|object|wearable|phone"
)
_SURE = re.compile(rf"(?:{_THINGS})(?:id|name|mac|number|nr|no)?")
_MAYBE = re.compile(r"(?:.*id|name|serial|serialnumber|node|client|source|src)")


def suspects(present: Sequence[str], read: Sequence[str]) -> dict[str, str]:
    """The columns of a file that look like an identity and are not `read`, under names for a table
    of their own.
    """
    others = [name for name in present if name not in read and present.count(name) == 1]
    return {UNREAD + name: name for name in others if _looks(name)}


def _looks(name: str) -> bool:
    """Whether a column's name may be that of an identity."""
    plain = re.sub(r"[\W_]+", "", name.lower())
    return bool(_SURE.fullmatch(plain) or _MAYBE.fullmatch(plain))


def check_identity(packets: Packets, groups: Groups) -> list[str]:
    """Return remarks on columns that look like an identity and are not used.

    Raises BadValue if a column that is called as tags are varies within a fix. A column with a
    value of its own for each anchor names anchors.
    """
    notes, table = [], packets.table
    for column in (name for name in table.frame.columns if str(name).startswith(UNREAD)):
        name = table.names[column]
        value = np.unique(table.frame[column].astype(str).to_numpy(), return_inverse=True)[1]
        if value.max(initial=0) == 0 or _paired(value, packets.anchor):
            continue
        mixed = _mixed(value, groups.code)
        if mixed is not None and _SURE.fullmatch(re.sub(r"[\W_]+", "", name.lower())):
            rows = " and ".join(table.at(row, column) for row in mixed)
            allowed = f"a column of tags: {name} of {table.path} looks like one and differs within "
            allowed += (
                f"a fix: {rows}; set scenario.columns.tag={_word(name)}, which makes a track "
            )
            raise BadValue(
                "columns.tag", None, allowed + "of each tag, or call the column otherwise"
            )
        where = "differs within a fix" if mixed is not None else f"has {value.max() + 1} values"
        if mixed is not None or _SURE.fullmatch(re.sub(r"[\W_]+", "", name.lower())):
            notes.append(
                f"{table.path}: {name} {where} and is not used; if it names tags, set "
                f"scenario.columns.tag={_word(name)}"
            )
    return notes


def _paired(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether each value (N,) goes with one value (N,) of the other, and the reverse."""
    return _mixed(one, other) is None and _mixed(other, one) is None


def _mixed(value: np.ndarray, group: np.ndarray) -> tuple[int, int] | None:
    """Two rows of one group whose values (N,) differ, or None."""
    _, first, code = np.unique(group, return_index=True, return_inverse=True)
    off = np.flatnonzero(value != value[first][code])
    return (int(first[code[off[0]]]), int(off[0])) if len(off) else None


def _word(name: str) -> str:
    """A column's name as a word of the command line."""
    return name if re.fullmatch(r"\w+", name) else f"'{shorten(name, 60)}'"
