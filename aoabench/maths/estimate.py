"""A number with its Monte Carlo error, and the interval and test that follow from both.

The interval is Student's, corrected for skewness. To second order, the studentised mean T of N
values with the skewness g is below y - a/6 - a y^2/3 as often as Student's variable is below y,
where a = g / sqrt(N) [Johnson 1978; Hall 1992]. This quadratic is not monotone. `_studentised` has
the same expansion and increases with y, so that intervals of growing confidence contain each other.

A few values tell little about their skewness: the standard error of a sample's skewness is 0.69 for
10 values and 0.24 for 100. Each end of an interval therefore takes the skewness by which it lies
farther from the estimate, within two standard errors of the estimated one. The terms that this adds
are of the order 1/N.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

Interval = tuple[float, float]
# beyond it the expansion is none, and the interval would leave its own number out; quantiles among
# values that differ by orders of magnitude have such a skewness, means have not
_MOST_SKEW = 3.0


@dataclass(frozen=True)
class Estimate:
    """A number and its Monte Carlo standard error (NaN for too few values, and of NaN).

    `skew` is the skewness a of the estimate (see the module): 0 for a symmetric interval; of a mean
    of N values, the skewness of the values / sqrt(N). `units` is the number of independent values
    behind the standard error; infinite where the standard error is known.
    """

    value: float
    se: float
    skew: float = 0.0
    units: float = math.inf

    def __post_init__(self) -> None:
        if math.isnan(self.value):
            object.__setattr__(self, "se", math.nan)

    def interval(self, confidence: float = 0.95) -> Interval:
        """The two-sided confidence interval (low, high), NaN where the standard error is NaN."""
        from scipy.special import stdtrit

        if not self.se > 0:
            return self.value - self.se, self.value + self.se
        y = float(stdtrit(self.units - 1, 0.5 + confidence / 2)) if self.units > 1 else math.nan
        least, most = self._skews()
        return (
            self.value - self.se * _studentised(y, least),
            self.value - self.se * _studentised(-y, most),
        )

    def p_value(self) -> float:
        """The two-sided p-value of the hypothesis that the true number is 0: it is below 1 - c if
        and only if the interval of confidence c leaves 0 out. NaN where the standard error is NaN.
        """
        from scipy.special import stdtr

        if not self.se > 0:
            return math.nan if math.isnan(self.se) else float(self.value == 0)
        least, most = self._skews()
        t = self.value / self.se
        y = max(_student(t, least), -_student(t, most))  # at most one is positive
        return float(2 * stdtr(self.units - 1, -max(y, 0.0))) if self.units > 1 else math.nan

    def _skews(self) -> tuple[float, float]:
        """The skewness minus and plus two standard errors, those of normal values, both within
        +- _MOST_SKEW.
        """
        n, margin = self.units, 0.0
        if n >= 3 and math.isfinite(n):
            margin = 2 * math.sqrt(6 * (n - 1) / ((n - 2) * (n + 1) * (n + 3)))
        ends = self.skew - margin, self.skew + margin
        least, most = (min(max(end, -_MOST_SKEW), _MOST_SKEW) for end in ends)
        return least, most

    def __mul__(self, factor: float) -> Estimate:
        """The estimate times a factor, for another unit."""
        skew = math.copysign(1.0, factor) * self.skew
        return Estimate(factor * self.value, abs(factor) * self.se, skew, self.units)

    __rmul__ = __mul__

    def __add__(self, other: Estimate | float) -> Estimate:
        """Sum with an independent estimate, or with a number that is known exactly.

        Variances and third cumulants add up; `units` are by Satterthwaite's formula.
        """
        if not isinstance(other, Estimate):
            return Estimate(self.value + other, self.se, self.skew, self.units)
        return combined(self.value + other.value, self, other)

    def __sub__(self, other: Estimate | float) -> Estimate:
        """Difference from an independent estimate, or from a number that is known exactly."""
        return self + -1 * other

    def root(self) -> Estimate:
        """Square root by the delta method, to second order: the error is NaN at 0; both are NaN
        below 0.
        """
        root = math.sqrt(self.value) if self.value >= 0 else math.nan
        if not root > 0:
            return Estimate(root, math.nan)
        se = self.se / (2 * root)
        return Estimate(root, se, self.skew - 1.5 * se / root, self.units)

    def percent(self) -> Estimate:
        """The estimate of a share, in percent."""
        return self * 100

    def columns(self, name: str, se: str = "") -> dict[str, float]:
        """Columns of a table, from which `stored` makes the estimate again: NAME for the value,
        `se` (default NAME_se) for the standard error, and, unless the estimate is normal, NAME_skew
        and NAME_units, named after `se`.
        """
        error, skew, units = _names(name, se)
        found = {name: self.value, error: self.se}
        normal = self.skew == 0 and math.isinf(self.units)
        return found if normal else found | {skew: self.skew, units: self.units}


def stored(row: Mapping[Any, Any], name: str, se: str = "") -> Estimate:
    """The estimate that `Estimate.columns` stored in a row of a table; normal where the skewness
    and the units are absent or NaN. Raises KeyError without a value or a standard error.
    """
    of_error, *more = _names(name, se)
    value, error = float(row[name]), float(row[of_error])
    skew, units = (float(row.get(column, math.nan)) for column in more)
    if math.isnan(skew) or math.isnan(units):
        return Estimate(value, error)
    return Estimate(value, error, skew, units)


def _names(name: str, se: str) -> tuple[str, str, str]:
    """Names of the columns of the standard error, the skewness and the units."""
    error = se or f"{name}_se"
    stem = error.removesuffix("_se")
    return error, f"{stem}_skew", f"{stem}_units"


def combined(value: float, *parts: Estimate) -> Estimate:
    """An estimate with the error of a sum of independent parts: variances and third cumulants add
    up; `units` by Satterthwaite's formula. Parts with the error 0 count for nothing.
    """
    variance = math.fsum(part.se**2 for part in parts)
    if not variance > 0:
        return Estimate(value, math.sqrt(variance))
    cubes = math.fsum(part.skew * part.se**3 for part in parts if part.se > 0)
    inverse = math.fsum(part.se**4 / (part.units - 1) for part in parts if part.units > 1)
    units = variance**2 / inverse + 1 if inverse > 0 else math.inf
    return Estimate(value, math.sqrt(variance), cubes / variance**1.5, units)


def _studentised(y: float, a: float) -> float:
    """The quantile of T at Student's quantile y, for the skewness a."""
    b, size = abs(a) / 3, abs(y)
    size = size * (1 + b * size) if a * y < 0 else _inverse(size, b)
    return math.copysign(size, y) - a / 6


def _student(t: float, a: float) -> float:
    """Student's quantile y at which `_studentised` is t."""
    b, shifted = abs(a) / 3, t + a / 6
    size = abs(shifted)
    size = _inverse(size, b) if a * shifted < 0 else size * (1 + b * size)
    return math.copysign(size, shifted)


def _inverse(size: float, b: float) -> float:
    """The x >= 0 with x (1 + b x) = size."""
    return 2 * size / (1 + math.sqrt(1 + 4 * b * size))
