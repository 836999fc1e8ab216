"""Monte Carlo standard errors and paired differences.

Replications are independent, so the standard errors are those of independent draws; steps within a
replication are never treated as draws. NaN values (failed replications) are left out of means and
counted in the failure rate. Intervals that need more than value and standard error are in
`intervals`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from aoabench.maths import intervals
from aoabench.maths.intervals import finite, normal_quantile

Array = np.ndarray


@dataclass(frozen=True)
class Estimate:
    """A number and its Monte Carlo standard error (NaN for too few values, and of NaN)."""

    value: float
    se: float

    def __post_init__(self) -> None:
        if math.isnan(self.value):
            object.__setattr__(self, "se", math.nan)

    def interval(self, confidence: float = 0.95) -> tuple[float, float]:
        """Normal confidence interval."""
        half = normal_quantile(confidence) * self.se
        return self.value - half, self.value + half

    def __mul__(self, factor: float) -> Estimate:
        """Value and standard error times a factor, for another unit."""
        return Estimate(factor * self.value, abs(factor) * self.se)

    __rmul__ = __mul__

    def __add__(self, other: Estimate | float) -> Estimate:
        """Sum with an independent estimate, or with a number that is known exactly."""
        b = other if isinstance(other, Estimate) else Estimate(other, 0.0)
        return Estimate(self.value + b.value, math.hypot(self.se, b.se))

    def __sub__(self, other: Estimate | float) -> Estimate:
        """Difference from an independent estimate, or from a number that is known exactly."""
        return self + -1 * other

    def root(self) -> Estimate:
        """Square root, its standard error by the delta method: NaN at 0; both NaN below 0."""
        root = math.sqrt(self.value) if self.value >= 0 else math.nan
        return Estimate(root, self.se / (2 * root) if root > 0 else math.nan)

    def percent(self) -> Estimate:
        """The estimate of a share, in percent."""
        return self * 100

    def columns(self, name: str, se: str = "") -> dict[str, float]:
        """Two columns of a table: NAME for the value, `se` (default NAME_se) for the error."""
        return {name: self.value, se or f"{name}_se": self.se}


def mean(values: ArrayLike) -> Estimate:
    """Mean over replications (N,)."""
    x = finite(values)
    se = float(x.std(ddof=1) / math.sqrt(len(x))) if len(x) > 1 else math.nan
    return Estimate(float(x.mean()) if len(x) else math.nan, se)


def pooled_rmse(rmse: ArrayLike, fixes: ArrayLike | None = None) -> Estimate:
    """Root of the mean square over all fixes, from each replication's RMSE (N,) and number of
    accepted fixes (N,).

    It is the root of a ratio of means; its standard error is by the delta method over replications.
    """
    r = np.asarray(rmse, dtype=float)
    n = np.ones_like(r) if fixes is None else np.asarray(fixes, dtype=float)
    keep = np.isfinite(r) & (n > 0)
    r, n = r[keep], n[keep]
    if len(r) == 0:
        return Estimate(math.nan, math.nan)
    square = float((n * r**2).sum() / n.sum())
    root = math.sqrt(square)
    if len(r) < 2 or root == 0.0:
        return Estimate(root, math.nan)
    influence = n * (r**2 - square) / n.mean()
    return Estimate(root, float(influence.std(ddof=1) / math.sqrt(len(r)) / (2 * root)))


def quantile(values: ArrayLike, probability: float) -> Estimate:
    """Quantile over replications (N,) with the Maritz-Jarrett standard error.

    This error is the standard deviation, under the empirical distribution, of the order statistic
    nearest to the quantile.
    """
    x = np.sort(finite(values))
    n = len(x)
    if n == 0:
        return Estimate(math.nan, math.nan)
    value = float(np.quantile(x, probability))
    if n < 3:
        return Estimate(value, math.nan)
    from scipy.special import betainc

    m = min(max(math.floor(probability * n + 0.5), 1), n)
    w = np.diff(betainc(m, n - m + 1, np.arange(n + 1) / n))
    return Estimate(value, math.sqrt(float(w @ (x - w @ x) ** 2)))


def cep(error: ArrayLike, probability: float = 0.5, axis: int = 0) -> Estimate:
    """Quantile of all fixes' errors (R, T) m (NaN: no fix); for horizontal errors, the circular
    error probable.

    Independent units lie along `axis`: 0 replications, 1 positions that all replications share. The
    standard error is derived from `intervals.cep_interval` at the confidence 2/3.
    """
    e = finite(np.ravel(np.asarray(error, dtype=float)))
    low, high = intervals.cep_interval(error, probability, axis, confidence=2 / 3)
    half = (high - low) / (2 * normal_quantile(2 / 3))
    return Estimate(float(np.quantile(e, probability)) if len(e) else math.nan, half)


def rate(count: int, n: int) -> Estimate:
    """A proportion with its standard error: never 0, as half a count is added at 0 and n; NaN for
    n = 1.
    """
    if n < 2:
        return Estimate(float(count) if n else math.nan, math.nan)
    p = min(max(count, 0.5), n - 0.5) / n
    return Estimate(count / n, math.sqrt(p * (1 - p) / n))


@dataclass(frozen=True)
class Paired:
    """Mean of a - b over n paired replications; `percent` is 100 (mean a / mean b - 1).

    `units` is the number of independent units behind the standard errors: replications, or the
    positions that replications share.
    """

    n: int
    difference: Estimate
    percent: Estimate
    p_value: float
    units: int

    def interval(self, confidence: float = 0.95) -> tuple[float, float]:
        """Student-t interval of the difference."""
        return self._around(self.difference, confidence)

    def percent_interval(self, confidence: float = 0.95) -> tuple[float, float]:
        """Student-t interval of the percentage."""
        return self._around(self.percent, confidence)

    def _around(self, estimate: Estimate, confidence: float) -> tuple[float, float]:
        half = intervals.student_quantile(max(self.units - 1, 1), confidence) * estimate.se
        return estimate.value - half, estimate.value + half


def paired(a: ArrayLike, b: ArrayLike, influences: tuple[Array, Array] | None = None) -> Paired:
    """Paired comparison of values (N,) of two estimators over the same replications; pairs with a
    NaN are left out.

    `influences` of shared positions (P,) on the two means (Clusters.influence) cluster the standard
    errors by position.
    """
    from scipy.special import stdtr

    x, y = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    keep = np.isfinite(x) & np.isfinite(y)
    x, y = x[keep], y[keep]
    u, v = (x, y) if influences is None else influences
    n, units = len(x), len(u)
    if n < (2 if influences is None else 1) or units < 2:
        nothing = Estimate(math.nan, math.nan)
        return Paired(n, nothing, nothing, math.nan, units)
    difference = Estimate(float((x - y).mean()), mean(u - v).se)
    ratio = x.mean() / y.mean() if y.mean() else math.nan
    spread = (
        mean(u - ratio * v).se / abs(y.mean()) if y.mean() else math.nan
    )  # delta method for a ratio of means
    t = (
        difference.value / difference.se
        if difference.se > 0
        else (0.0 if difference.value == 0 else math.inf)
    )
    p = 2 * float(stdtr(units - 1, -abs(t)))
    return Paired(n, difference, Estimate(100 * (ratio - 1), 100 * spread), p, units)


def paired_rate(a: ArrayLike, b: ArrayLike) -> Paired:
    """Paired comparison of an event's occurrence (N,) for two estimators in the same replications.

    `percent` is the difference in percentage points, shrunken and with the error of [Bonett, Price
    2012], whose Wald interval is valid if few or no pairs differ; the p-value is McNemar's exact.
    """
    from scipy.special import betainc

    x, y = np.asarray(a, dtype=bool), np.asarray(b, dtype=bool)
    n, more, fewer = len(x), int((x & ~y).sum()), int((~x & y).sum())
    if n < 1:
        nothing = Estimate(math.nan, math.nan)
        return Paired(n, nothing, nothing, math.nan, n)
    up, down = (more + 1) / (n + 2), (fewer + 1) / (n + 2)
    shift = Estimate(up - down, math.sqrt((up + down - (up - down) ** 2) / (n + 2)))
    m, k = more + fewer, min(more, fewer)
    p = (
        1.0 if more == fewer else min(1.0, 2 * float(betainc(m - k, k + 1, 0.5)))
    )  # P(B <= k), B binomial (m, 1/2)
    return Paired(
        n, Estimate((more - fewer) / n, shift.se), Estimate(100 * shift.value, 100 * shift.se), p, n
    )


def needed(
    pair: Paired, percent: float, comparisons: int = 1, level: float = 0.05, power: float = 0.8
) -> float:
    """Number of independent units (see Paired) needed to detect a true difference of `percent`.

    The detection probability is `power` at the two-sided `level` divided by `comparisons`; NaN if
    the standard error is unknown.
    """
    from scipy.special import ndtri

    z = float(ndtri(1 - level / (2 * max(comparisons, 1))) + ndtri(power))
    return pair.units * (z * pair.percent.se / percent) ** 2


def ratio(numerator: ArrayLike, denominator: ArrayLike) -> Estimate:
    """sum of numerators / sum of denominators over independent units (N,), standard error by the
    delta method.
    """
    value, influence = _ratio(numerator, denominator)
    return Estimate(value, mean(influence).se)


def ratio_difference(
    numerator: ArrayLike, denominator: ArrayLike, other: ArrayLike, other_denominator: ArrayLike
) -> Estimate:
    """One ratio minus another of the same independent units (N,), standard error by the delta
    method.

    Each ratio is a sum of numerators over a sum of denominators; the standard error takes the
    dependence of both within a unit into account.
    """
    a, influence = _ratio(numerator, denominator)
    b, other_influence = _ratio(other, other_denominator)
    return Estimate(a - b, mean(influence - other_influence).se)


def ratio_of_ratios(
    numerator: ArrayLike, denominator: ArrayLike, other: ArrayLike, other_denominator: ArrayLike
) -> Estimate:
    """One ratio over another of the same independent units (N,), standard error by the delta
    method.

    Each ratio is a sum of numerators over a sum of denominators. NaN if the other ratio is not
    above 0.
    """
    a, influence = _ratio(numerator, denominator)
    b, other_influence = _ratio(other, other_denominator)
    if not b > 0:
        return Estimate(math.nan, math.nan)
    return Estimate(a / b, mean((influence - a / b * other_influence) / b).se)


def _ratio(numerator: ArrayLike, denominator: ArrayLike) -> tuple[float, Array]:
    """Ratio of two sums over units (N,) and each unit's influence (N,) on it; NaN if the
    denominators do not add up to more than 0.
    """
    x, n = np.asarray(numerator, dtype=float), np.asarray(denominator, dtype=float)
    if not n.sum() > 0:
        return math.nan, np.full(len(x), math.nan)
    value = float(x.sum() / n.sum())
    return value, (x - value * n) / n.mean()


def jackknife(x: ArrayLike, f: Callable[[Array], float], groups: int | None = None) -> Estimate:
    """f of all independent units x (N, ...), its standard error from leaving out one at a time.

    With `groups`, unit i belongs to group i modulo `groups`, and one group is left out at a time;
    use it for an f that is not smooth (a median) and for many units. The error is NaN for a single
    unit, and if f is NaN without one of the groups.
    """
    units = np.asarray(x)
    n = len(units) if groups is None else min(groups, len(units))
    whole = float(f(units))
    if n < 2:
        return Estimate(whole, math.nan)
    group = np.arange(len(units)) % n
    left = np.array([f(units[group != g]) for g in range(n)], dtype=float)
    return Estimate(whole, math.sqrt((n - 1) / n * float(((left - left.mean()) ** 2).sum())))
