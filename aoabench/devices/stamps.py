"""Times that a host writes in front of the lines of a device."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from aoabench.maths.geometry import Array

_DATE = re.compile(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d:\d\d(?:[.,]\d+)?(?:Z|[+-]\d\d:?\d\d)?")
_CLOCK = re.compile(r"(?<![\d:])(\d{1,2}):(\d\d):(\d\d(?:[.,]\d+)?)")
_NUMBER = re.compile(r"(?<![\w.])(?:\d{9,19}(?:\.\d+)?|\d+\.\d+)(?![\w.]*\.\d|\w)")
_UNITS = ((1e17, 1e-9), (1e14, 1e-6), (1e11, 1e-3))  # numbers above are since 1970 in this unit, s
_DAY_S = 86400.0


def seconds(before: Sequence[str]) -> Array | None:
    """Times (N,) in s from the texts in front of N lines, NaN where one has none; None if the first
    text has no time.

    A time is a date and time (ISO 8601; UTC where no zone is stated), a time of day, which goes on
    after midnight, or a number: since 1970 in s, ms, us or ns by its size, or smaller in s.
    """
    if not before:
        return None
    if _DATE.search(before[0]):
        return _dates(before)
    if _CLOCK.search(before[0]):
        return _clocks(before)
    if _NUMBER.search(before[0]):
        return _numbers(before)
    return None


def _dates(before: Sequence[str]) -> Array:
    import pandas as pd

    found = [_DATE.search(text) for text in before]
    texts = [one[0].replace(",", ".") if one else None for one in found]
    moments = pd.to_datetime(
        pd.Series(texts, dtype=object), format="ISO8601", utc=True, errors="coerce"
    )
    since = moments - pd.Timestamp(0, tz="UTC")
    return np.asarray(since / pd.Timedelta(seconds=1), dtype=float)


def _clocks(before: Sequence[str]) -> Array:
    found = [_CLOCK.search(text) for text in before]
    each = [(one[1], one[2], one[3].replace(",", ".")) if one else ("nan",) * 3 for one in found]
    value = np.array(each, dtype=float) @ [3600.0, 60.0, 1.0]
    known = np.flatnonzero(np.isfinite(value))
    steps = np.diff(value[known], prepend=value[known[:1]])
    days = np.cumsum((steps < -_DAY_S / 2).astype(int) - (steps > _DAY_S / 2))
    value[known] += _DAY_S * days
    return value


def _numbers(before: Sequence[str]) -> Array:
    found = [_NUMBER.search(text) for text in before]
    value = np.array([one[0] if one else "nan" for one in found], dtype=float)
    size = np.nanmax(value)
    return value * next((unit for least, unit in _UNITS if size >= least), 1.0)
