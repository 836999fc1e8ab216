"""Confidence intervals over independent replications, the bootstrap of whole replications, and
Holm's correction.

An interval is (low, high) at the two-sided level `confidence`, and NaN for too few values. NaN
values are left out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
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


def rate_interval(count: float, n: float, confidence: float = 0.95) -> Interval:
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
    reaches is infinite. It is the interval of scipy.stats.quantile_test, whose import takes half a
    second.
    """
    from scipy.special import bdtr

    x = np.sort(finite(values))
    n = len(x)
    if n == 0:
        return NOTHING
    below = bdtr(np.arange(n, dtype=float), n, probability)  # P(at most k of n below the quantile)
    tail = (1 - confidence) / 2
    low = int(np.searchsorted(below, tail, side="right"))
    high = int(np.searchsorted(below, 1 - tail))
    return (
        float(x[low - 1]) if low > 0 else -math.inf,
        float(x[high]) if high < n else math.inf,
    )


def by_place(x: Array, place: np.ndarray | None) -> Array:
    """Sums (R, P) of x (R, T) over the fixes of each position; `place` (T,) numbers the position of
    each fix from 0, or is None where each has its own.
    """
    if place is None or np.array_equal(place, np.arange(x.shape[1])):
        return x
    if (np.diff(place) < 0).any():
        order = np.argsort(place, kind="stable")
        x, place = x[:, order], place[order]
    starts = np.flatnonzero(np.diff(place, prepend=-1))
    return np.add.reduceat(x, starts, axis=1, dtype=float)


def by_replication(x: Array, counts: np.ndarray | None) -> Array:
    """Sums (R, 1) of x, (F,) or (1, F), over the fixes of replications that have `counts` (R,)
    fixes each, one after the other; x itself without counts.
    """
    if counts is None:
        return x
    starts = np.cumsum(counts) - counts
    return np.add.reduceat(np.ravel(x), starts, dtype=float)[:, None]


def share_error(hits: Array, tries: Array, place: np.ndarray | None = None) -> float:
    """Standard error of the share sum of `hits` / sum of `tries`, both (R, T); NaN for less than
    two units.

    The replications are the independent units. With `place` they share their positions, which are
    units too: see statistics.crossed.
    """
    if place is not None:  # a position in one replication is the smallest unit
        hits, tries = by_place(hits, place), by_place(tries, place)
    each, all_ = hits.sum(axis=1, dtype=float), tries.sum(axis=1, dtype=float)
    n = max(float(all_.sum()), 1.0)
    share = each.sum() / n
    R = len(each)
    over = R / (R - 1) * float((((each - share * all_) / n) ** 2).sum()) if R > 1 else math.nan
    if place is None:
        return math.sqrt(over)
    cells = (hits - share * tries) / n
    P = cells.shape[1]
    if P < 2:
        return math.nan
    more = over - float((cells**2).sum()) if R > 1 else 0.0
    return math.sqrt(P / (P - 1) * float((cells.sum(axis=0) ** 2).sum()) + max(more, 0.0))


def share_interval(
    hits: ArrayLike, tries: ArrayLike, place: np.ndarray | None = None, confidence: float = 0.95
) -> Interval:
    """Interval of the share sum of `hits` / sum of `tries`, both (R, T), whose fixes depend on each
    other as in `share_error`.

    It is Wilson's interval for the number of independent tries that has this standard error; for a
    share of 0 or 1, which has no error of its own, this is the number of units.
    """
    h, n = np.asarray(hits), np.asarray(tries)
    se = share_error(h, n, place)
    if math.isnan(se) or not n.sum() > 0:
        return NOTHING
    share = float(h.sum() / n.sum())
    units = len(h) if place is None else len(np.unique(place))
    equal = share * (1 - share) / se**2 if se > 0 else float(units)
    return rate_interval(share * equal, equal, confidence)


def cep_interval(
    error: ArrayLike,
    probability: float = 0.5,
    place: np.ndarray | None = None,
    confidence: float = 0.95,
) -> Interval:
    """Interval of one quantile of all fixes' errors; see `cep_intervals`."""
    return cep_intervals(error, [probability], place, confidence)[0]


def cep_intervals(
    error: ArrayLike,
    probabilities: Sequence[float],
    place: np.ndarray | None = None,
    confidence: float = 0.95,
    counts: np.ndarray | None = None,
) -> list[Interval]:
    """Intervals of quantiles of all fixes' errors (R, T) m (NaN: no fix), which depend on each
    other as in `share_error`. With `counts` (R,), the errors (F,) are those of replications of so
    many fixes each, one after the other.

    For horizontal errors this is the circular error probable, CEP50, CEP90 and so on. Woodruff's
    method: the empirical quantile function maps the interval of the share of fixes below the
    estimate to errors.
    """
    e = np.atleast_2d(np.asarray(error, dtype=float))
    known = np.isfinite(e)
    pooled = e[known]
    if len(pooled) == 0:
        return [NOTHING] * len(probabilities)
    z, tries = normal_quantile(confidence), by_replication(known, counts)
    below = (by_replication(e <= q, counts) for q in np.quantile(pooled, probabilities))
    half = np.array([z * share_error(hits, tries, place) for hits in below])
    if np.isnan(half).any():  # of all of them: there are too few units
        return [NOTHING] * len(probabilities)
    p = np.asarray(probabilities)
    low, high = np.quantile(pooled, np.clip([p - half, p + half], 0.0, 1.0))
    return list(zip(low.tolist(), high.tolist()))


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
    replication are never separated. Use it for statistics without an interval of their own; those
    of `statistics` have a better coverage and are faster.
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
