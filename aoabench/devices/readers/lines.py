"""Texts in pieces, matched by regular expressions a whole column at a time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from aoabench.maths.geometry import Array

if TYPE_CHECKING:
    import pandas as pd


def pieces(text: str, mark: str) -> Any:
    """The Arrow array of the texts between the marks."""
    import pyarrow as pa
    import pyarrow.compute as pc

    return pc.split_pattern(pa.array([text], pa.large_string()), mark).values


def line_ends(parts: Any) -> np.ndarray:
    """The number of line ends in each of the texts."""
    import pyarrow.compute as pc

    return np.asarray(pc.count_substring(parts, "\n"), dtype=np.int64)


def line_starts(parts: Any) -> np.ndarray:
    """The number of line ends before each of consecutive parts of a text."""
    ends = line_ends(parts)
    return np.asarray(np.cumsum(ends) - ends)


def matched(parts: Any, pattern: str) -> tuple[np.ndarray, dict[str, Any]]:
    """The indices of the parts that match, and the named groups of these, as Arrow arrays; groups
    that take no part in a match are empty.
    """
    import pyarrow.compute as pc

    found = pc.extract_regex(parts, pattern)
    valid = found.is_valid()
    names = [field.name for field in found.type]
    columns = {name: found.field(i).filter(valid) for i, name in enumerate(names)}
    return np.flatnonzero(np.asarray(valid)), columns


def numbers(column: Any) -> Array:
    """Texts (N,) as numbers, NaN where empty."""
    import pyarrow as pa
    import pyarrow.compute as pc

    filled = pc.if_else(pc.equal(column, ""), "nan", column)
    return np.asarray(pc.cast(filled, pa.float64()))


def texts(column: Any) -> pd.Series[str]:
    """Texts (N,) for a frame, one object for each distinct text."""
    import pandas as pd

    coded = column.dictionary_encode()
    distinct = np.array(coded.dictionary.to_pylist(), dtype=object)
    return pd.Series(distinct[np.asarray(coded.indices)], dtype=object)


def joined(before: Any, after: Any, mark: str) -> Any:
    """Texts (N,), one in front of the other, with a mark between; a str stands for N equal ones."""
    import pyarrow as pa
    import pyarrow.compute as pc

    kind = pa.large_string()
    each = [pa.scalar(t, kind) if isinstance(t, str) else t.cast(kind) for t in (before, after)]
    return pc.binary_join_element_wise(*each, pa.scalar(mark, kind))
