"""Times in a column of a log: numbers in a declared unit, or dates and times in ISO 8601."""

from __future__ import annotations

import numpy as np

from aoabench.devices.readers.table import Table
from aoabench.maths.geometry import Array

SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
SLOW_S = 5.0  # s; packets further apart are doubted
FAR_S = 1e11  # s; a later time, after the year 5000, is in another unit


def times(table: Table, column: str, unit: str, complete: bool) -> Array:
    """Return the times (N,) s in a column, of dates since 1970 UTC.

    An empty cell is NaN unless the times have to be `complete`. Raises BadValue for numbers that
    are no times in the declared unit.
    """
    import pandas as pd

    name = table.names[column]
    if table.is_number(column):
        raw = table.numbers(column, empty=not complete)
        far = np.abs(raw) * SECONDS[unit] > FAR_S
        table.check(column, far, f"times in {unit} in {name}{_other_unit(raw[far])}")
        return raw * SECONDS[unit]
    moments = table.dates(column)
    wrong = moments.isna().to_numpy() & (complete | table.frame[column].notna().to_numpy())
    table.check(column, wrong, f"a time in {name} in every row, each in ISO 8601")
    since = (moments - pd.Timestamp(0, tz="UTC")) / pd.Timedelta(seconds=1)
    return np.asarray(since, dtype=float)


def _other_unit(raw: Array) -> str:
    """The unit in which numbers since 1970 are of this century, as the end of a message."""
    words = {"ms": "milliseconds", "us": "microseconds", "ns": "nanoseconds"}
    for unit, word in words.items():
        if len(raw) and 1e8 < np.median(np.abs(raw)) * SECONDS[unit] < 1e10:
            return f"; these look like {word} since 1970: scenario.time_unit={unit}"
    return ""


def slow_times(table: Table, time: Array | None, unit: str) -> list[str]:
    """A warning line if times (N,) s look like a smaller unit than the one declared: whole numbers
    that are typically 5 s or more apart.
    """
    if time is None or unit != "s" or "time" not in table.names or not table.is_number("time"):
        return []
    moments = np.unique(time[np.isfinite(time)])
    if len(moments) <= 20 or np.any(moments != np.rint(moments)):
        return []
    step = float(np.median(np.diff(moments)))
    if step < SLOW_S:
        return []
    return [
        f"{table.path}: {table.names['time']} spans {np.ptp(moments):.3g} s, packets are typically "
        f"{step:.3g} s apart; if these are milliseconds, set scenario.time_unit=ms"
    ]
