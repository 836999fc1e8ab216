"""Numbers as text."""

from __future__ import annotations

import re
from math import floor, log10

import numpy as np


def printed_text(value: float | None, rounding: float) -> str:
    """A printed number with the paper's digits, `rounding` being half a unit of the last one."""
    if value is None:
        return "-"
    return (
        f"{value:.{max(0, -floor(log10(2 * rounding) + 1e-9))}f}" if rounding > 0 else f"{value:g}"
    )


def significant(value: float, digits: int) -> str:
    """A finite number to some significant digits, without an exponent."""
    return np.format_float_positional(value, digits, fractional=False, trim="-")


NON_CAUSAL = "fixes use later measurements too, as live positioning cannot"


def shown_name(estimator: str, causal: bool) -> str:
    """An estimator's name in tables and figures; a smoother is marked as non-causal."""
    return estimator if causal else f"{estimator} (non-causal)"


def number_text(value: float, se: float, digits: int = 2) -> str:
    """A number with its standard error, so that the error has `digits` significant digits."""
    if value != value:
        return "-"
    if se != se or se <= 1e-12 * abs(value):  # no standard error, or 0 up to rounding
        return f"{value:.{digits + 2}g}"
    if abs(value) >= 1e6:
        return f"{value:.{digits + 1}g} ± {se:.{digits - 1 or 1}g}"
    n = max(0, digits - 1 - floor(log10(abs(se))))
    return f"{value:.{n}f} ± {se:.{n}f}"


def interval_parts(value: float, low: float, high: float, digits: int = 2) -> tuple[str, str]:
    """A number and its interval as two texts, rounded so that the interval's half-width has
    `digits` significant digits; "" in place of a number that is NaN, and of an interval that has no
    width.
    """
    if value != value:
        return "", ""
    half = (high - low) / 2
    if half != half or half <= 1e-12 * abs(value):
        whole = float(value).is_integer() and abs(value) < 1e6  # a count, say
        return f"{value:.0f}" if whole else f"{value:.{digits + 2}g}", ""
    if half >= 1e6:
        four = digits + 2
        return f"{value:.{four}g}", f"[{low:.{four}g}, {high:.{four}g}]"
    n = max(0, digits - 1 - floor(log10(half)))
    return f"{value:.{n}f}", f"[{low:.{n}f}, {high:.{n}f}]"


def interval_text(value: float, low: float, high: float) -> str:
    """A number with its interval, to two digits of the interval's half-width; a number without
    error alone.
    """
    number, interval = interval_parts(value, low, high)
    return f"{number} {interval}".rstrip() or "-"


_AXES = {"3d": "3-D", "xy": "xy", "z": "z"}
_NAMES = {
    "availability": "availability",
    "failure_rate": "failure rate",
    "nees_mean": "mean NEES",
    "iterations_mean": "mean iterations",
    "largest_share": "largest share of the sum of squares",
    "share_ok": "share of fixes ok",
    "seconds_per_step": "time per step",
    "seconds_per_replication": "time per replication",
}
_PATTERNS = (
    (r"rmse_q50_(3d|xy|z)_m", "median RMSE {axis}"),
    (r"rmse_(pooled|mean)_(3d|xy|z)_m", "{0} RMSE {axis}"),
    (r"rmse_q(\d\d)_(3d|xy|z)_m", "{0} % quantile of RMSE {axis}"),
    (r"cep(\d\d)_m", "CEP{0}"),
    (r"error_z_q(\d\d)_m", "{0} % quantile of the error in z"),
    (r"p_within_(\d)m", "share within {0} m"),
    (r"share_(\w+)", "share of fixes {0}"),
)


def metric_title(column: str) -> str:
    """The name in words of a column of summary.parquet or timing.parquet, without its unit."""
    for pattern, words in _PATTERNS:
        if column not in _NAMES and (found := re.fullmatch(pattern, column)):
            groups = found.groups()
            return words.format(*groups, axis=_AXES.get(groups[-1], ""))
    return _NAMES.get(column, column)
