"""Monte Carlo standard errors, paired differences, and the one function that computes a verdict.

Replications are independent, so the standard errors are those of independent draws; steps within a
replication are never treated as draws. NaN values (failed replications) are left out of means and
counted in the failure rate. Intervals that need more than value and standard error are in
`intervals`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from aoabench import intervals
from aoabench.intervals import finite, normal_quantile

Array = np.ndarray
CLUSTERED = ("rmse_3d_m", "rmse_xy_m", "rmse_z_m", "iterations")  # metrics that Clusters knows
QUANTILES = (0.05, 0.25, 0.50, 0.75, 0.95)

REPRODUCED = "reproduced"
IN_KIND = "reproduced in kind"
NOT_REPRODUCIBLE = "not reproducible"
NOT_PRINTED = "not printed"
NOT_COMPUTED = "not computed"


@dataclass(frozen=True)
class Estimate:
    """A number and its Monte Carlo standard error (NaN where too few values tell)."""

    value: float
    se: float

    def interval(self, confidence: float = 0.95) -> tuple[float, float]:
        """Normal confidence interval."""
        half = normal_quantile(confidence) * self.se
        return self.value - half, self.value + half


def mean(values: ArrayLike) -> Estimate:
    """Mean over replications (N,)."""
    x = finite(values)
    if len(x) == 0:
        return Estimate(math.nan, math.nan)
    return Estimate(
        float(x.mean()), float(x.std(ddof=1) / math.sqrt(len(x))) if len(x) > 1 else math.nan
    )


def pooled_rmse(rmse: ArrayLike, fixes: ArrayLike | None = None) -> Estimate:
    """Root of the mean square over all fixes, from each replication's RMSE (N,) and number of
    accepted fixes (N,).

    A ratio of means, so its standard error comes from the delta method over replications.
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

    That is the deviation, under the empirical distribution, of the order statistic nearest to the
    quantile.
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
    """Quantile of all fixes' errors (R, T) m (NaN: no fix): of horizontal ones the circular error
    probable.

    Independent units lie along `axis`: 0 replications, 1 positions that all replications share. The
    standard error is that of `intervals.cep`, at two thirds' confidence.
    """
    e = finite(np.ravel(np.asarray(error, dtype=float)))
    low, high = intervals.cep(error, probability, axis, confidence=2 / 3)
    half = (high - low) / (2 * normal_quantile(2 / 3))
    return Estimate(float(np.quantile(e, probability)) if len(e) else math.nan, half)


def rate(count: int, n: int) -> Estimate:
    """A proportion with its standard error; half a count is added at 0 and n so that the error is
    never 0.
    """
    if n == 0:
        return Estimate(math.nan, math.nan)
    p = min(max(count, 0.5), n - 0.5) / n if n > 1 else 0.5
    return Estimate(count / n, math.sqrt(p * (1 - p) / n))


@dataclass(frozen=True)
class Paired:
    """Mean of a - b over n paired replications; `percent` is 100 (mean a / mean b - 1).

    `units` independent ones tell the standard errors: the replications, or the positions that these
    share.
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
        from scipy.special import stdtrit

        half = float(stdtrit(max(self.units - 1, 1), 0.5 + confidence / 2)) * estimate.se
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
    """Paired comparison of what happened (N,) or not to two estimators in the same replications.

    `percent` is the difference in percentage points, shrunken and with the error of [Bonett, Price
    2012], whose Wald interval covers where few or none differ; the p-value is McNemar's exact one.
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
    """How many independent units (see Paired) would show a true difference of that many per cent.

    With probability `power`, at the two-sided `level` shared among that many comparisons; NaN where
    nothing tells.
    """
    from scipy.special import ndtri

    z = float(ndtri(1 - level / (2 * max(comparisons, 1))) + ndtri(power))
    return pair.units * (z * pair.percent.se / percent) ** 2


@dataclass(frozen=True)
class Clusters:
    """Sums over replications for each of P true positions that all replications share; every array
    (P,).

    fixes: accepted ones; square_3d, square_xy: of their errors, m^2; iterations: theirs;
    influence_3d, ..: what the position adds to the mean over replications of the RMSE, about that
    mean, m; replications: how many were summed.
    """

    replications: int
    fixes: Array
    square_3d: Array
    square_xy: Array
    iterations: Array
    influence_3d: Array
    influence_xy: Array
    influence_z: Array

    def __add__(self, other: Clusters) -> Clusters:
        return Clusters(*(getattr(self, f.name) + getattr(other, f.name) for f in fields(self)))

    def grouped(self, place: np.ndarray) -> Clusters:
        """The same with one position for each number among `place` (P,), which counts from 0."""
        sums = (
            np.bincount(place, getattr(self, f.name))
            for f in fields(self)
            if f.name != "replications"
        )
        return Clusters(self.replications, *sums)

    def influence(self, metric: str) -> Array | None:
        """P times what each position (P,) adds to the mean over replications of a metric, about it;
        None if unknown.

        The metric is a column of the replications table; the standard error of its mean is that of
        these terms' mean.
        """
        if metric == "iterations":
            n = np.maximum(self.fixes, 1e-300)  # none at all: nothing to tell, without a warning
            return (self.iterations - n * self.iterations.sum() / n.sum()) / n.mean()
        axis = {"rmse_3d_m": "3d", "rmse_xy_m": "xy", "rmse_z_m": "z"}.get(metric)
        return (
            None
            if axis is None
            else len(self.fixes) * getattr(self, f"influence_{axis}") / self.replications
        )

    def standard_errors(self) -> dict[str, float]:
        """Standard errors clustered by position, by the summary's names of what they belong to.

        Positions are taken as drawn independently; all fixes of one position may depend on each
        other.
        """
        n = np.where(self.fixes > 0, self.fixes, np.nan)
        squares = {
            "3d": self.square_3d,
            "xy": self.square_xy,
            "z": np.maximum(self.square_3d - self.square_xy, 0.0),
        }
        found = {}
        for axis, square in squares.items():
            found[f"rmse_pooled_{axis}_m"] = pooled_rmse(np.sqrt(square / n), self.fixes).se
            found[f"rmse_mean_{axis}_m"] = mean(cast(Array, self.influence(f"rmse_{axis}_m"))).se
        found["iterations_mean"] = ratio(self.iterations, self.fixes).se
        return found


def clusters(error_3d: Array, error_xy: Array, iterations: Array, accepted: np.ndarray) -> Clusters:
    """Sums per position from errors in m, iterations and whether a fix counts, each (R, P)."""
    a, n = accepted.astype(float), np.maximum(accepted.sum(axis=1), 1)[:, None]
    square = {"3d": np.where(accepted, error_3d, 0.0).astype(float) ** 2}
    square["xy"] = np.where(accepted, error_xy, 0.0).astype(float) ** 2
    square["z"] = np.maximum(square["3d"] - square["xy"], 0.0)
    influence = {}
    for axis, s in square.items():
        ms = s.sum(axis=1, keepdims=True) / n
        influence[axis] = (a * (s - ms) / (2 * np.sqrt(np.where(ms > 0, ms, np.inf)) * n)).sum(
            axis=0
        )
    counted = np.where(accepted, iterations, 0.0).sum(axis=0)
    sums = a.sum(axis=0), square["3d"].sum(axis=0), square["xy"].sum(axis=0), counted
    return Clusters(len(a), *sums, influence["3d"], influence["xy"], influence["z"])


def ratio(numerator: ArrayLike, denominator: ArrayLike) -> Estimate:
    """sum of numerators / sum of denominators over independent units (N,), standard error by the
    delta method.
    """
    x, n = np.asarray(numerator, dtype=float), np.asarray(denominator, dtype=float)
    if not n.sum() > 0:
        return Estimate(math.nan, math.nan)
    value = float(x.sum() / n.sum())
    return Estimate(value, mean((x - value * n) / n.mean()).se)


def summarise(rows: Any, clusters: Clusters | None = None) -> dict[str, Any]:
    """One row of the summary table from the replications (a frame) of one estimator in one cell.

    With `clusters`, standard errors of RMSE and iterations are clustered by position (`se_by`);
    those of quantiles and of the failure rate, whose 95 % interval is Wilson's, are always over
    replications.
    """
    n = len(rows)
    accepted = rows["n_ok"] + rows["n_oscillated"] + rows["n_diverged"]
    bad = int(rows["outcome"].isin(["failed", "diverged"]).sum())
    result: dict[str, Any] = {"replications": n}

    def put(name: str, estimate: Estimate) -> None:
        result[name], result[f"{name}_se"] = estimate.value, estimate.se

    for axis in ("3d", "xy", "z"):
        put(f"rmse_pooled_{axis}_m", pooled_rmse(rows[f"rmse_{axis}_m"], accepted))
        put(f"rmse_mean_{axis}_m", mean(rows[f"rmse_{axis}_m"]))
    for q in QUANTILES:
        put(f"rmse_q{round(100 * q):02d}_3d_m", quantile(rows["rmse_3d_m"], q))
    put("failure_rate", rate(bad, n))
    result["failure_rate_low"], result["failure_rate_high"] = intervals.rate(bad, n)
    put("nees_mean", mean(rows["nees"]))
    put("iterations_mean", mean(rows["iterations"]))
    for name in ("ok", "rejected", "oscillated", "diverged", "failed"):
        result[f"share_{name}"] = float(rows[f"n_{name}"].sum() / max(rows["n_fixes"].sum(), 1))
    result["se_by"] = "replication" if clusters is None else "position"
    if clusters is not None:
        result |= {f"{name}_se": se for name, se in clusters.standard_errors().items()}
    return result


def verdict(
    printed: float | tuple[float, float] | None,
    rounding: float,
    ours: Estimate | None,
    *,
    printed_se: float = 0.0,
    in_kind: bool = False,
    strict: bool = False,
    z: float = 3.0,
) -> str:
    """The verdict on one printed number or claim, from the numbers alone.

    `printed` is a number, known to +- `rounding` (half a unit of its last digit), or an interval
    that the paper claims (low, high); `printed_se` is the printed number's own Monte Carlo error,
    where its sample size is known. Reproduced means: ours lies in the printed interval, widened by
    z standard errors; for a claim with `strict`: it lies inside by z standard errors, so that
    chance alone does not confirm it. `in_kind` says whether ordering or shape holds. With z = 3 a
    true number is missed with probability below 0.3 %. A number without a standard error (NaN) is
    not judged: not computed. Errors that are exactly 0 belong to closed forms.
    """
    if ours is None or math.isnan(ours.value) or math.isnan(ours.se):
        return NOT_COMPUTED
    if printed is None:
        return NOT_PRINTED
    low, high = printed if isinstance(printed, tuple) else (printed - rounding, printed + rounding)
    slack = z * math.hypot(ours.se, printed_se)
    tolerance = 1e-9 * max(
        abs(low) if math.isfinite(low) else 0, abs(high) if math.isfinite(high) else 0
    )
    if strict:
        slack = -slack
    if strict and ours.value in (
        low,
        high,
    ):  # not by any margin, even where there is no error at all
        return IN_KIND if in_kind else NOT_REPRODUCIBLE
    if low - slack - tolerance <= ours.value <= high + slack + tolerance:
        return REPRODUCED
    return IN_KIND if in_kind else NOT_REPRODUCIBLE


def undecided(
    printed: Any, rounding: float, ours: Estimate, *, strict: bool = False, z: float = 3.0
) -> str:
    """Why a verdict rests on too few replications: a sentence, or nothing if it does not.

    A strict claim is undecided while ours lies within z standard errors of its bound; a number
    while z standard errors exceed five times its rounding, unless ours is clearly another one.
    """
    slack = z * ours.se
    if strict and isinstance(printed, tuple):
        low, high = printed
        outside = ours.value + slack < low or ours.value - slack > high
        inside = low + slack <= ours.value <= high - slack
        return "" if inside or outside else f"undecided: within {z:g} standard errors of the bound"
    if rounding > 0 and slack > 5 * rounding and abs(ours.value - printed) <= rounding + slack:
        return "undecided: the standard error is too large for the printed digits"
    return ""


def same_order(printed: ArrayLike, ours: ArrayLike) -> bool:
    """Whether numbers that differ in print stand in the same order among ours."""
    p, o = np.asarray(printed, dtype=float), np.asarray(ours, dtype=float)
    i, j = np.triu_indices(len(p), 1)
    return bool(np.all(np.sign(p[i] - p[j]) * np.sign(o[i] - o[j]) >= 0)) and bool(
        np.all(np.isfinite(o))
    )
