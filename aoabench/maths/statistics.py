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

from aoabench.maths.estimate import Estimate as Estimate
from aoabench.maths.estimate import combined
from aoabench.maths.intervals import finite, normal_quantile

Array = np.ndarray


def mean(values: ArrayLike) -> Estimate:
    """Mean over replications (N,)."""
    x = finite(values)
    if len(x) == 0:
        return Estimate(math.nan, math.nan)
    value = float(x.mean())
    return from_influence(value, x - value)


def from_influence(value: float, influence: Array, curve: float = 0.0) -> Estimate:
    """An estimate from the influences (N,) of independent units, which sum to 0: N times the
    first-order change that each of them makes.

    `curve` is the second derivative of the estimate along the change of the data that moves it by
    its own amount, to first order in every quantity alike; 0 for a mean.
    """
    n = len(influence)
    if n < 2:
        return Estimate(value, math.nan, units=n)
    deviation = float(influence.std(ddof=1))
    third = 0.0
    if n > 2 and deviation > 0:
        scaled = (influence - influence.mean()) / deviation
        third = float((scaled * scaled * scaled).mean())
    return _of_moments(n, value, deviation, third, curve)


def _of_moments(n: int, value: float, deviation: float, third: float, curve: float) -> Estimate:
    """An estimate from n >= 2 influences with a standard deviation and the mean of their third
    powers in units of it; see `from_influence`.
    """
    se = deviation / math.sqrt(n)
    skew = 1.5 * se * curve
    if n > 2:
        skew += third * n**1.5 / ((n - 1) * (n - 2))  # unbiased third cumulant
    return Estimate(value, se, skew, n)


def mean_of_sums(n: int, first: float, second: float, third: float) -> Estimate:
    """Mean of n >= 2 values from the sums of their first three powers. It loses the digits by which
    the mean exceeds the deviation.
    """
    value, square, cube = first / n, second / n, third / n
    variance = max(square - value**2, 0.0) * n / (n - 1)
    central = cube - 3 * value * square + 2 * value**3
    scaled = central / variance**1.5 if variance > 0 else 0.0
    return _of_moments(n, value, math.sqrt(variance), scaled, 0.0)


def pooled_rmse(rmse: ArrayLike, fixes: ArrayLike | None = None) -> Estimate:
    """Root of the mean square over all fixes, from each replication's RMSE (N,) and number of
    accepted fixes (N,): the root of a ratio of means.
    """
    r = np.asarray(rmse, dtype=float)
    n = np.ones_like(r) if fixes is None else np.asarray(fixes, dtype=float)
    keep = np.isfinite(r) & (n > 0)
    r, n = r[keep], n[keep]
    return ratio(n * r**2, n).root()


def quantile(values: ArrayLike, probability: float) -> Estimate:
    """Quantile over replications (N,) with the Maritz-Jarrett standard error.

    This error is the standard deviation, under the empirical distribution, of the order statistic
    nearest to the quantile; the skewness is the one with which the interval at 0.95 ends where the
    distribution of the order statistic, expanded to second order, has its quantiles.
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
    off = x - w @ x
    se = math.sqrt(float(w @ off**2))
    square = normal_quantile(0.95) ** 2
    skew = float(w @ (off / se) ** 3) * (square - 1) / (1 + 2 * square) if se > 0 else 0.0
    return Estimate(value, se, skew)


def rate(count: int, n: int) -> Estimate:
    """A proportion with its standard error: never 0, as half a count is added at 0 and n; NaN for
    n = 1.
    """
    if n < 2:
        return Estimate(float(count) if n else math.nan, math.nan)
    p = min(max(count, 0.5), n - 0.5) / n
    se = math.sqrt(p * (1 - p) / n)
    return Estimate(count / n, se, (1 - 2 * p) / (n * se))


def crossed(value: float, units: Estimate, replications: Estimate, within: float) -> Estimate:
    """The estimate `value` over units that all replications share: the variance over the `units`,
    plus that over the `replications`, less `within`, the sum of the squared influences of each unit
    in each replication, which both contain [Cameron, Gelbach, Miller 2011].

    Replications whose units vary independently add nothing, and never take anything away.
    """
    more = math.sqrt(max(replications.se**2 - within, 0.0)) if replications.se > 0 else 0.0
    return combined(value, units, Estimate(0.0, more, replications.skew, replications.units))


@dataclass(frozen=True)
class Paired:
    """Mean of a - b over n paired replications; `percent` is 100 (mean a / mean b - 1).

    `p_value` belongs to the hypothesis of no difference. `units` is the number of independent units
    behind the standard errors: replications, or the positions that replications share.
    """

    n: int
    difference: Estimate
    percent: Estimate
    p_value: float
    units: int


def paired(a: ArrayLike, b: ArrayLike, cells: tuple[Array, Array] | None = None) -> Paired:
    """Paired comparison of values (N,) of two estimators over the same replications; pairs with a
    NaN are left out. The p-value is that of the percentage, or of the difference without one.

    `cells` of N replications that share P positions are the influences (N, P) of each fix on the
    two means (fixes.influences); they cluster the standard errors by position.
    """
    x, y = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    keep = np.isfinite(x) & np.isfinite(y)
    x, y = x[keep], y[keep]
    n, units = len(x), len(x) if cells is None else cells[0].shape[1]
    if n < (2 if cells is None else 1) or units < 2:
        nothing = Estimate(math.nan, math.nan)
        return Paired(n, nothing, nothing, math.nan, units)
    difference, sign = mean(x - y), math.copysign(1.0, y.mean())
    percent = (ratio(sign * x, sign * y) - 1).percent()
    if cells is not None:
        u, v = cells
        difference = _clustered(difference, u - v)
        if math.isfinite(percent.value):
            weights, factor = v / y.mean(), 1 + percent.value / 100
            percent = _clustered(percent, 100 * (u / y.mean() - factor * weights), weights)
    shown = percent if math.isfinite(percent.value) else difference
    return Paired(n, difference, percent, shown.p_value(), units)


def _clustered(over: Estimate, cells: Array, weights: Array | None = None) -> Estimate:
    """An estimate over replications, clustered by position through the influences (N, P) of each
    fix; of a ratio, `weights` (N, P) are the relative influences on the denominator.
    """
    by_position = cells.shape[1] * cells.sum(axis=0)
    curve = 0.0
    if weights is not None:
        curve = -2 * _slope(cells.shape[1] * weights.sum(axis=0), by_position)
    units = from_influence(over.value, by_position, curve)
    return crossed(over.value, units, over, float((cells**2).sum()))


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
    """sum of numerators / sum of denominators over independent units (N,), by the delta method to
    second order.
    """
    value, influence, weight = _ratio(numerator, denominator)
    return from_influence(value, influence, -2 * _slope(weight, influence))


def ratio_difference(
    numerator: ArrayLike, denominator: ArrayLike, other: ArrayLike, other_denominator: ArrayLike
) -> Estimate:
    """One ratio minus another of the same independent units (N,), by the delta method to second
    order.

    Each ratio is a sum of numerators over a sum of denominators; the standard error takes the
    dependence of both within a unit into account.
    """
    a, of_a, weight = _ratio(numerator, denominator)
    b, of_b, other_weight = _ratio(other, other_denominator)
    i = of_a - of_b
    curve = -2 * (_slope(of_a, i) * _slope(weight, i) - _slope(of_b, i) * _slope(other_weight, i))
    return from_influence(a - b, i, curve)


def ratio_of_ratios(
    numerator: ArrayLike, denominator: ArrayLike, other: ArrayLike, other_denominator: ArrayLike
) -> Estimate:
    """One ratio over another of the same independent units (N,), by the delta method to second
    order.

    Each ratio is a sum of numerators over a sum of denominators. NaN if the other ratio is not
    above 0.
    """
    a, of_a, weight = _ratio(numerator, denominator)
    b, of_b, other_weight = _ratio(other, other_denominator)
    if not b > 0:
        return Estimate(math.nan, math.nan)
    i = (of_a - a / b * of_b) / b
    up, down = _slope(of_a, i) / b, _slope(of_b, i) / b
    curve = -2 * (up * _slope(weight, i) - a / b * down * _slope(other_weight, i) + down)
    return from_influence(a / b, i, curve)


def _ratio(numerator: ArrayLike, denominator: ArrayLike) -> tuple[float, Array, Array]:
    """Ratio of two sums over units (N,), each unit's influence (N,) on it, and its denominator
    relative to their mean, minus 1 (N,); NaN if the denominators do not add up to more than 0.
    """
    x, n = np.asarray(numerator, dtype=float), np.asarray(denominator, dtype=float)
    if not n.sum() > 0:
        nothing = np.full(len(x), math.nan)
        return math.nan, nothing, nothing
    value = float(x.sum() / n.sum())
    return value, (x - value * n) / n.mean(), n / n.mean() - 1


def _slope(y: Array, x: Array) -> float:
    """Change of y (N,) with x (N,) by least squares; 0 where x is 0."""
    square = float(x @ x)
    return float(y @ x) / square if square > 0 else 0.0


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
    found = from_influence(whole, (n - 1) * (left.mean() - left))
    se = math.sqrt((n - 1) / n * float(((left - left.mean()) ** 2).sum()))
    return Estimate(whole, se, found.skew, n)
