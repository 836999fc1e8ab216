"""Times that a host writes in front of the lines of a device."""

from __future__ import annotations

from typing import Any

import numpy as np

from aoabench.devices.readers.lines import joined, matched, numbers
from aoabench.maths.geometry import Array

_DATE = (
    r"(?P<date>\d{4}-\d\d-\d\d)[T ](?P<time>\d\d:\d\d:\d\d)[.,]?(?P<part>\d*)"
    r"(?P<zone>Z|[+-]\d\d:?\d\d|)"
)
_CLOCK = r"(?:^|[^\d:])(?P<h>\d{1,2}):(?P<m>\d\d):(?P<s>\d\d)[.,]?(?P<part>\d*)(?:[^\d:]|$)"
_NUMBER = r"(?:^|[^\w.])(?P<n>\d{9,19}(?:\.\d+)?|\d+\.\d+)(?:[^\w.]|\.?$|\.[^\d])"
_UNITS = ((1e17, 1e-9), (1e14, 1e-6), (1e11, 1e-3))  # numbers above are since 1970 in this unit, s
DAY_S = 86400.0


def seconds(before: Any) -> Array | None:
    """Times (N,) in s from the Arrow array of texts in front of N lines, NaN where one has none;
    None if none has.

    A time is a date and time (ISO 8601; UTC where no zone is stated), a time of day, which goes on
    after midnight, or a number: since 1970 in s, ms, us or ns by its size, or smaller in s.
    """
    for pattern, value_of in ((_DATE, _dates), (_CLOCK, _clocks), (_NUMBER, _numbers)):
        rows, groups = matched(before, pattern)
        if len(rows):
            found = np.full(len(before), np.nan)
            found[rows] = value_of(groups)
            return found
    return None


def _dates(groups: dict[str, Any]) -> Array:
    import pandas as pd

    texts = joined(joined(groups["date"], groups["time"], "T"), groups["zone"], "").to_pandas()
    moments = pd.to_datetime(texts, format="ISO8601", utc=True, errors="coerce")
    since = (moments - pd.Timestamp(0, tz="UTC")) / pd.Timedelta(seconds=1)
    return np.asarray(since, dtype=float) + _fraction(groups)


def _clocks(groups: dict[str, Any]) -> Array:
    h, m, s = (numbers(groups[name]) for name in "hms")
    value = 3600 * h + 60 * m + s + _fraction(groups)
    steps = np.diff(value, prepend=value[:1])
    days = np.cumsum((steps < -DAY_S / 2).astype(int) - (steps > DAY_S / 2))
    return np.asarray(value + DAY_S * days)


def _fraction(groups: dict[str, Any]) -> Array:
    """The decimals of the seconds."""
    return numbers(joined("0", groups["part"], "."))


def _numbers(groups: dict[str, Any]) -> Array:
    value = numbers(groups["n"])
    return value * next((unit for least, unit in _UNITS if value.max() >= least), 1.0)
