"""Wide tables: a row per fix and columns per anchor, such as azimuth_A1, azimuth_A2.

`azimuth_{anchor}` names such columns. A table is recognised as wide if it has no column `anchor`
and its columns are called as below, in any order; a word or unit may be absent. Where no column
orders the rows, each row is a fix.

    azimuth_deg_A1   azimuth_A1_deg   A1_azimuth_deg   (and elevation, rssi, range, ..._sigma; of
                                                       anchors that move anchor_x, anchor_lat, ...)
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from aoabench.devices.readers.reading import ANCHOR, Content

if TYPE_CHECKING:
    import pandas as pd

_DEGREES = ("anchor_lat", "anchor_lon", "anchor_facing", "anchor_bearing")
_WORDS = {
    "azimuth": ("azimuth|azim|az", ("deg", "rad")),
    "elevation": ("elevation|elev|el", ("deg", "rad")),
    "azimuth_sigma": ("(?:azimuth|azim|az)_(?:sigma|std|stdev)", ("deg", "rad")),
    "elevation_sigma": ("(?:elevation|elev|el)_(?:sigma|std|stdev)", ("deg", "rad")),
    "rssi": ("rssi", ("dbm",)),
    "range": ("range|distance|dist", ("m",)),
    "range_sigma": ("(?:range|distance|dist)_(?:sigma|std|stdev)", ("m",)),
    **{f"anchor_{axis}": (f"anchor_{axis}", ("m",)) for axis in "xyz"},
    **{one: (one, ("deg",)) for one in _DEGREES},
}
_ORDER = re.compile(r"fix|time|t$|date|stamp|seq|epoch|mark|row|frame", re.I)
_NO_IDS = re.compile(r"(?:sigma|std|stdev|true|truth|error|err|offset|deg|rad|dbm|m)(?:_.*)?", re.I)


@dataclass(frozen=True)
class Wide(Content):
    """A table that also has long columns: `anchor`, and a column for each of `patterns`, which map
    a long column's name to the pattern of the wide columns.
    """

    wide: Content = None  # type: ignore[assignment]
    patterns: Mapping[str, str] = ()  # type: ignore[assignment]
    label: str = ""  # in front of the numbers of fixes

    def cells(self, names: Mapping[str, str]) -> pd.DataFrame:
        """The chosen columns; with a row per row and anchor of the wide table if one of them is
        long, less the rows of anchors without any measurement in a row with others.
        """
        import pandas as pd

        long = {o: t for o, t in names.items() if t in self.patterns and not self._has(t)}
        own = {o: t for o, t in names.items() if self._has(t)}
        if not long:
            return self.wide.cells(names)
        ids = [i for i in _ids(self.wide.columns, self.patterns) if self._any(long, i)]
        chosen = {f"{ours}/{i}": self._column(theirs, i) for ours, theirs in long.items()
                  for i in ids if self._has(self._column(theirs, i))}  # fmt: skip
        cells = self.wide.cells(own | chosen)
        own |= self._numbered(cells, names)
        blocks = []
        for i in ids:
            block = {o: cells[f"{o}/{i}"] for o in long if f"{o}/{i}" in chosen}
            blocks.append(pd.DataFrame(block, columns=list(long), index=cells.index))
        found = pd.concat(blocks)
        order = np.argsort(np.tile(np.arange(len(cells)), len(ids)), kind="stable")
        found = found.iloc[order]
        rows = cells.iloc[np.repeat(np.arange(len(cells)), len(ids))]
        found = found.assign(**{ours: rows[ours].to_numpy() for ours in own})
        if "anchor" in names.values() and not self._has("anchor"):
            found["anchor"] = np.tile(np.array(ids, dtype=object), len(cells))
        measured = [ours for ours in long if not ours.startswith("anchor_")] or list(long)
        empty = found[measured].isna().all(axis=1).to_numpy().reshape(len(cells), len(ids))
        keep = ~empty
        keep[:, 0] |= empty.all(axis=1)  # a fix without any measurement stays a fix
        return found[list(names)][keep.ravel()]

    def shown(self, name: str) -> str:
        return name if self._has(name) else self.patterns.get(name, name)

    def _numbered(self, cells: pd.DataFrame, names: Mapping[str, str]) -> dict[str, str]:
        """Number the rows in `cells` as fixes, if the table itself does not."""
        found = {o: t for o, t in names.items() if t == "fix" and not self._has(t)}
        for ours in found:
            cells[ours] = self.label + (cells.index + 1).astype(str)
        return found

    def _has(self, name: str) -> bool:
        return name in self.wide.columns

    def _column(self, name: str, anchor: str) -> str:
        return self.patterns[name].replace(ANCHOR, anchor)

    def _any(self, long: Mapping[str, str], anchor: str) -> bool:
        return any(self._has(self._column(theirs, anchor)) for theirs in long.values())


def widened(content: Content, patterns: Sequence[str], label: str = "") -> Content:
    """The content with long columns if it is wide, by the given patterns or as recognised; `label`
    stands in front of the numbers of fixes that the table does not have itself.
    """
    columns = list(content.columns)
    found = {one: one for one in patterns if _ids(columns, {one: one})}
    if not found and "anchor" not in columns:
        found = _recognised(columns)
    if not found:
        return content
    ordered = any(_ORDER.match(name) for name in columns)
    more = [*found, "anchor", *([] if ordered else ["fix"])]
    names = [*columns, *(name for name in more if name not in columns)]
    return Wide(names, content.parts, content.notes, content.stated, content, found, label)


def _ids(columns: Sequence[str], patterns: Mapping[str, str]) -> list[str]:
    """The anchors in the names of wide columns, in order of appearance."""
    found: dict[str, None] = {}
    for pattern in patterns.values():
        before, after = map(re.escape, pattern.split(ANCHOR))
        for name in columns:
            if one := re.fullmatch(f"{before}(.+){after}", name):
                found[one[1]] = None
    return list(found)


def _recognised(columns: Sequence[str]) -> dict[str, str]:
    """Patterns of the wide columns, by the default names of long ones; empty for a long table."""
    azimuths = _patterns(columns, "azimuth", None)
    if not azimuths:
        return {}
    found = dict(azimuths)
    ids = set(_ids(columns, azimuths))
    if len(ids) < 2:
        return {}
    for role in _WORDS:
        if role != "azimuth":
            found |= _patterns(columns, role, ids)
    return found


def _patterns(columns: Sequence[str], role: str, ids: set[str] | None) -> dict[str, str]:
    """The pattern of a role's columns under the role's default names, for anchors in `ids`."""
    words, units = _WORDS[role]
    for unit in (*units, None):
        mark = f"_{unit}" if unit else ""
        for shape in (f"({words}){mark}_(?P<id>.+)", f"({words})_(?P<id>.+){mark}",
                      f"(?P<id>.+)_({words}){mark}"):  # fmt: skip
            found = [one for name in columns if (one := re.fullmatch(shape, name, re.I))]
            found = [one for one in found if not _NO_IDS.fullmatch(one["id"])
                     and (ids is None or one["id"] in ids)]  # fmt: skip
            pattern = {one[0][: one.start("id")] + ANCHOR + one[0][one.end("id") :]
                       for one in found}  # fmt: skip
            if len(pattern) == 1 and len(found) > 1:
                named = [unit] if unit else units
                return {f"{role}_{each}": next(iter(pattern)) for each in named}
    return {}
