"""Users' tables and logs: columns by name, every mistake with its line.

Lines of texts are counted from 1, and so are rows of Parquet. Every mistake raises BadValue with
the key, the file and the allowed content. Heavy imports are inside the functions, because a list of
presets does not need them.
"""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from aoabench.devices.readers.foreign import reason_of
from aoabench.devices.readers.formats import opened
from aoabench.devices.readers.reading import ANCHOR, AUTO, Part, Reading
from aoabench.devices.readers.sources import KINDS
from aoabench.errors import BadValue, did_you_mean, listed, shorten
from aoabench.maths.geometry import Array

if TYPE_CHECKING:
    import pandas as pd

    from aoabench.devices.readers.reading import Content


@dataclass(frozen=True)
class Table:
    """Columns of files under aoabench's names, which `names` maps to the file's names.

    The frame's index is the row's place in the files, whose `parts` say where. stated: the
    conventions that the format states, under the names of a scenario's parameters; they stand in
    for the scenario's defaults. notes: remarks on the files, to print.
    """

    key: str
    path: Any
    names: Mapping[str, str]
    frame: pd.DataFrame
    parts: tuple[Part, ...]
    notes: tuple[str, ...] = ()
    stated: Mapping[str, str] = field(default_factory=dict)

    @staticmethod
    def read(key: str, path: Any, names: Mapping[str, str], reading: Reading = AUTO) -> Table:
        """Read the columns `names` (aoabench's name -> the file's); empty rows are left out.

        The file has to contain each column once.
        """
        return Table.of(opened(key, path, reading), key, path, names)

    @staticmethod
    def of(content: Content, key: str, path: Any, names: Mapping[str, str]) -> Table:
        """The columns `names` of an opened file; raises BadValue for one without rows."""
        table = Table.piece(content, key, path, names)
        if not len(table.frame):
            raise table.bad("a file with at least one row")
        return table

    @staticmethod
    def piece(content: Content, key: str, path: Any, names: Mapping[str, str]) -> Table:
        """The columns `names` of a piece of a log, which may have no rows."""
        try:
            frame = content.cells(names)
        except BadValue:
            raise
        except (OSError, ValueError, NotImplementedError) as error:  # pandas and Arrow
            raise BadValue(key, path, f"a readable {KINDS}; {reason_of(error)}") from None
        shown = {ours: content.shown(theirs) for ours, theirs in names.items()}
        table = Table(key, path, shown, frame, content.parts, content.notes, content.stated)
        return table.where(table.frame.notna().any(axis=1).to_numpy())

    @property
    def count(self) -> int:
        """The number of rows N."""
        return len(self.frame)

    def where(self, keep: np.ndarray) -> Table:
        """The table of the rows where `keep` (N,) is True."""
        return self if keep.all() else replace(self, frame=self.frame[keep])

    def bad(self, allowed: str) -> BadValue:
        """The exception for this file; `allowed` is the allowed content."""
        return BadValue(self.key, self.path, allowed)

    def at(self, row: int, *columns: str) -> str:
        """'line 17 has azimuth_deg=400' for a row of the frame, or 'line 17'."""
        place = int(self.frame.index[row])
        part = self.parts[bisect_right([p.start for p in self.parts], place) - 1]
        cells = [(self._name(column, row), self.frame[column].iloc[row]) for column in columns]
        shown = [
            f"{name}={shorten(repr(value) if isinstance(value, str) else str(value))}"
            for name, value in cells
        ]
        return part.at(place) + (f" has {' and '.join(shown)}" if shown else "")

    def _name(self, column: str, row: int) -> str:
        """The name in the file of a column's cell in a row."""
        name = self.names[column]
        wide = ANCHOR in name and "anchor" in self.frame.columns
        return name.replace(ANCHOR, str(self.frame["anchor"].iloc[row])) if wide else name

    def check(self, column: str, wrong: np.ndarray, allowed: str) -> None:
        """Raise BadValue for the first row where `wrong` (N,) is True."""
        if wrong.any():
            raise self.bad(f"{allowed}; {self.at(int(np.flatnonzero(wrong)[0]), column)}")

    def is_number(self, column: str) -> bool:
        """Whether the first non-empty cell of a column is a number."""
        import pandas as pd

        cells = self.frame[column].dropna()
        if pd.api.types.is_datetime64_any_dtype(cells.dtype):
            return False
        return (
            pd.api.types.is_numeric_dtype(cells.dtype) or not len(cells) or _is_float(cells.iloc[0])
        )

    def numbers(self, column: str, empty: bool = True) -> Array:
        """A column (N,) of finite numbers; NaN for an empty cell if `empty` allows such cells."""
        import pandas as pd

        cells = self.frame[column]
        kind = pd.api.types
        if kind.is_bool_dtype(cells.dtype) or kind.is_datetime64_any_dtype(cells.dtype):
            value = np.full(len(cells), np.nan)
        elif kind.is_numeric_dtype(cells.dtype):
            value = cells.to_numpy(dtype=float, na_value=np.nan)
        else:
            value = pd.to_numeric(cells.astype(str).where(cells.notna()), errors="coerce").to_numpy(
                dtype=float
            )
        absent = cells.isna().to_numpy()
        name, wrong = self.names[column], ~np.isfinite(value) & ~absent
        words = f"finite numbers in {name}" + ", or empty cells" * empty
        if wrong.any() and re.fullmatch(r"\s*[+-]?\d+,\d+\s*", str(cells[wrong].iloc[0])):
            words += " (decimal commas: scenario.decimal=',')"
        self.check(column, wrong, words)
        if not empty:
            self.check(column, absent, f"a number in {name} in every row")
        return value

    def dates(self, column: str) -> pd.Series[pd.Timestamp]:
        """A column (N,) of dates and times in ISO 8601, UTC where no zone is stated; NaT for others
        and for empty cells.
        """
        import pandas as pd

        cells = self.frame[column]
        known = cells.dropna()
        if len(known) and isinstance(first := known.iloc[0], str) and "," in first:
            cells = cells.astype(str).str.replace(",", ".")  # decimals, as ISO 8601 allows
        return pd.to_datetime(cells, format="ISO8601", utc=True, errors="coerce")

    def texts(self, column: str) -> tuple[np.ndarray, list[str]]:
        """A column as indices (N,) into its distinct texts, in order of appearance; raises BadValue
        for an empty cell.
        """
        import pandas as pd

        code, distinct = pd.factorize(self.frame[column])
        texts = [
            str(int(t) if isinstance(t, float) and t.is_integer() else t).strip()
            for t in distinct.tolist()
        ]
        empty = np.array([*(not text for text in texts), True])  # the last one for empty cells
        self.check(column, empty[code], f"a value in {self.names[column]} in every row")
        merged, ids = pd.factorize(np.array(texts, dtype=object))
        return merged[code], ids.tolist()

    def indices(self, column: str, known: Sequence[str], strict: bool) -> np.ndarray:
        """A column as indices (N,) into the `known` texts, -1 for others; raises BadValue for
        others if `strict`.
        """
        code, ids = self.texts(column)
        place = {text: i for i, text in enumerate(known)}
        index = np.array([place.get(text, -1) for text in ids])[code]
        if strict and (index < 0).any():
            unknown = ids[code[int(np.flatnonzero(index < 0)[0])]]
            wrong = self.at(int(np.flatnonzero(index < 0)[0]), column)
            raise self.bad(
                f"one of {listed(known)} in {self.names[column]}; "
                f"{wrong}{did_you_mean(unknown, known)}"
            )
        return index


def _is_float(value: Any) -> bool:
    try:
        float(value)
    except (TypeError, ValueError):
        return False
    return True
