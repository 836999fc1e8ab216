"""Confidence intervals over independent replications, the bootstrap of whole replications, and
Holm's correction.

An interval is (low, high) at the two-sided level `confidence`, and NaN for too few values. NaN
values are left out.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

Array = np.ndarray
Interval = tuple[float, float]
NOTHING = (math.nan, math.nan)


def finite(values: ArrayLike) -> Array:
    """The finite values of `values` (N,)."""
    x = np.asarray(values, dtype=float)
    return x[np.isfinite(x)]


def normal_quantile(confidence: float) -> float:
    """z with P(|Z| <= z) = confidence for a standard normal Z."""
    from scipy.special import ndtri

    return float(ndtri(0.5 + confidence / 2))


def student_quantile(degrees: int, confidence: float = 0.95) -> float:
    """t with P(|T| <= t) = confidence for Student's T with `degrees` of freedom; NaN for 0."""
    from scipy.special import stdtrit

    return float(stdtrit(degrees, 0.5 + confidence / 2)) if degrees > 0 else math.nan


def mean_interval(values: ArrayLike, confidence: float = 0.95) -> Interval:
    """Interval of a mean over replications (N,), corrected for skewness [Hall 1992, transformation
    g2].

    With a = skewness / sqrt(N) the studentised mean T is replaced by T + a T^2/3 + a^2 T^3/27 +
    a/6, whose distribution is Student's to the next order; Student's interval is the case a = 0.
    """
    from scipy.special import stdtrit

    x = finite(values)
    n = len(x)
    if n < 2:
        return NOTHING
    middle, deviation = float(x.mean()), float(x.std(ddof=1))
    if deviation == 0.0:
        return middle, middle
    a = float((((x - middle) / deviation) ** 3).mean()) / math.sqrt(n)
    t = float(stdtrit(n - 1, 0.5 + confidence / 2))
    low, high = (_hall(y, a) for y in (t, -t))
    se = deviation / math.sqrt(n)
    return middle - se * low, middle - se * high


def _hall(y: float, a: float) -> float:
    """The T whose Hall transform is y."""
    if abs(a) < 1e-6:  # the cube root cancels; to first order in a
        return y - a * (1 + 2 * y * y) / 6
    return float(3 / a * (np.cbrt(1 + a * (y - a / 6)) - 1))


def rmse_interval(
    rmse: ArrayLike, fixes: ArrayLike | None = None, confidence: float = 0.95
) -> Interval:
    """Interval of the pooled RMSE from each replication's RMSE (N,) and number of accepted fixes
    (N,).

    The interval is the square root of the interval of the mean square, a ratio of means, whose
    linearised terms have the interval of `mean_interval`.
    """
    r = np.asarray(rmse, dtype=float)
    n = np.ones_like(r) if fixes is None else np.asarray(fixes, dtype=float)
    keep = np.isfinite(r) & (n > 0)
    r, n = r[keep], n[keep]
    if len(r) < 2:
        return NOTHING
    square = float((n * r**2).sum() / n.sum())
    low, high = mean_interval(square + n * (r**2 - square) / n.mean(), confidence)
    return math.sqrt(max(low, 0.0)), math.sqrt(max(high, 0.0))


def rate_interval(count: int, n: int, confidence: float = 0.95) -> Interval:
    """Wilson's score interval of a proportion, equal to that of scipy.stats.binomtest, whose import
    takes half a second.
    """
    if n == 0:
        return NOTHING
    z, p = normal_quantile(confidence), count / n
    centre, half = p + z * z / (2 * n), z * math.sqrt(p * (1 - p) / n + (z / (2 * n)) ** 2)
    scale = 1 + z * z / n
    return 0.0 if count == 0 else (centre - half) / scale, 1.0 if count == n else (
        centre + half
    ) / scale


def quantile_interval(values: ArrayLike, probability: float, confidence: float = 0.95) -> Interval:
    """Distribution-free interval of a quantile over replications (N,), between two order
    statistics.

    The coverage is at least `confidence` for any distribution; an end that no order statistic
    reaches is infinite.
    """
    from scipy.stats import quantile_test

    x = finite(values)
    if len(x) == 0:
        return NOTHING
    found = quantile_test(x, p=probability).confidence_interval(confidence)
    return (-math.inf if math.isnan(found.low) else float(found.low)), (
        math.inf if math.isnan(found.high) else float(found.high)
    )


def cep_interval(
    error: ArrayLike, probability: float = 0.5, axis: int = 0, confidence: float = 0.95
) -> Interval:
    """Interval of a quantile of all fixes' errors (R, T) m (NaN: no fix), whose independent units
    lie along `axis`.

    For horizontal errors this is the circular error probable, CEP50, CEP90 and so on. Axis 0:
    replications; axis 1: positions that all replications share. Woodruff's method: the empirical
    quantile function maps the interval of the share of fixes below the estimate, a ratio of means
    over the units, to errors.
    """
    e = np.moveaxis(np.atleast_2d(np.asarray(error, dtype=float)), axis, 0)
    known = np.isfinite(e)
    pooled = e[known]
    if len(e) < 2 or len(pooled) == 0:
        return NOTHING
    fixes, below = known.sum(axis=1), (known & (e <= np.quantile(pooled, probability))).sum(axis=1)
    influence = (below - fixes * below.sum() / fixes.sum()) / fixes.mean()
    half = normal_quantile(confidence) * float(influence.std(ddof=1)) / math.sqrt(len(e))
    low, high = np.quantile(pooled, np.clip([probability - half, probability + half], 0.0, 1.0))
    return float(low), float(high)


@dataclass(frozen=True)
class Band:
    """An empirical distribution function with its band: shares (N,) of values up to x (N,)."""

    x: Array
    share: Array
    low: Array
    high: Array


def cdf_band(values: ArrayLike, confidence: float = 0.95, pointwise: bool = False) -> Band:
    """Distribution function of independent values (N,), sorted, with its band.

    The band contains the whole function with probability `confidence` [Dvoretzky, Kiefer,
    Wolfowitz; Massart 1990]. With `pointwise` it is narrower and contains each single point of the
    function with this probability [Clopper, Pearson].
    """
    x = np.sort(finite(values))
    n = len(x)
    share = np.searchsorted(x, x, side="right") / max(n, 1)
    if not pointwise:
        half = math.sqrt(math.log(2 / (1 - confidence)) / (2 * max(n, 1)))
        return Band(x, share, np.maximum(share - half, 0.0), np.minimum(share + half, 1.0))
    from scipy.special import betaincinv

    k, tail = np.rint(share * n), (1 - confidence) / 2
    low = betaincinv(k, n - k + 1, tail) if n else share
    high = np.where(k < n, betaincinv(k + 1, np.maximum(n - k, 1), 1 - tail), 1.0)
    return Band(x, share, low, high)


def bootstrap(
    statistic: Callable[..., float],
    *arrays: ArrayLike,
    axis: int = 0,
    confidence: float = 0.95,
    resamples: int = 2000,
    seed: int = 0,
) -> tuple[float, Interval]:
    """Standard error and BCa interval of `statistic(*arrays)` by drawing whole units along `axis`
    with replacement.

    The arrays share that axis and are drawn together: paired. Axis 0 of (R,) or (R, T): whole
    replications; axis 1 of (R, P): whole positions that all replications share. Steps within a
    replication are never separated. Use it for statistics without an interval of their own;
    `mean_interval` and `rmse_interval` have a slightly better coverage and are faster.
    """
    from scipy import stats

    given = [np.asarray(a) for a in arrays]
    n = given[0].shape[axis]
    if n < 2:
        return math.nan, NOTHING

    def drawn(index: Array) -> float:
        return statistic(*(np.take(a, index, axis=axis) for a in given))

    found = stats.bootstrap(
        (np.arange(n),),
        drawn,
        vectorized=False,
        n_resamples=resamples,
        confidence_level=confidence,
        rng=seed,
    )
    return float(found.standard_error), (
        float(found.confidence_interval.low),
        float(found.confidence_interval.high),
    )


def holm(p_values: ArrayLike) -> Array:
    """p-values (M,) adjusted for all M comparisons [Holm 1979]; NaN values are not counted.

    If all differences with an adjusted p-value below 0.05 are claimed, the probability of a false
    claim is at most 0.05 for any dependence between the comparisons.
    """
    p = np.asarray(p_values, dtype=float)
    adjusted = np.full(p.shape, math.nan)
    order = np.argsort(p)[: np.isfinite(p).sum()]  # NaN sorts last
    adjusted[order] = np.minimum(
        np.maximum.accumulate(p[order] * np.arange(len(order), 0, -1)), 1.0
    )
    return adjusted
