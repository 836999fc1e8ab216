"""Standard errors and intervals by simulation.

Simulations use fixed seeds; the tolerance on a standard error's mean is 4 of its own Monte Carlo
errors or as stated.
"""

import math
from dataclasses import fields

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from aoabench.columns import IDENTITY, SUMMARY
from aoabench.maths import statistics
from aoabench.maths.estimate import Estimate
from aoabench.store.clusters import Clusters, influences, position_sums
from aoabench.store.summary import QUANTILES, commonest, commonest_of_each, summarise


def spread(estimator, draw, repeats=2000, seed=1):
    """Mean estimated standard error, and the actual deviation of the estimate over repeated draws."""
    rng = np.random.default_rng(seed)
    found = [estimator(*draw(rng)) for _ in range(repeats)]
    return np.mean([f.se for f in found]), np.std([f.value for f in found], ddof=1), found


def skewed(rng, n=1000):
    return (rng.gamma(3.0, 0.3, n),)


@pytest.mark.parametrize(("estimator", "truth"), [
    (statistics.mean, 0.9),
    (statistics.pooled_rmse, math.sqrt(3 * 4 * 0.09)),
    (lambda x: statistics.quantile(x, 0.5), stats.gamma(3, scale=0.3).ppf(0.5)),
    (lambda x: statistics.quantile(x, 0.05), stats.gamma(3, scale=0.3).ppf(0.05)),
    (lambda x: statistics.quantile(x, 0.95), stats.gamma(3, scale=0.3).ppf(0.95)),
], ids=["mean", "rmse", "median", "q05", "q95"])  # fmt: skip
def test_standard_errors_and_coverage(estimator, truth):
    """Estimated error within 10 % of the actual one; 95 % intervals cover in at least 92 % of 2000
    samples of 1000.
    """
    estimated, actual, found = spread(estimator, skewed)
    assert estimated == pytest.approx(actual, rel=0.10)
    covered = np.mean([lo <= truth <= hi for lo, hi in (f.interval() for f in found)])
    assert covered > 0.92


def test_quantile_error_is_the_order_statistics():
    x = np.random.default_rng(3).gamma(2, size=301)
    for q in QUANTILES:
        ours = statistics.quantile(x, q)
        assert ours.value == pytest.approx(np.quantile(x, q))
        m = int(
            q * 301 + 0.5
        )  # the order statistic's own distribution, by quadrature over its beta density
        u = (np.arange(400_000) + 0.5) / 400_000
        picked = np.sort(x)[np.minimum((stats.beta(m, 302 - m).ppf(u) * 301).astype(int), 300)]
        assert ours.se == pytest.approx(picked.std(), rel=1e-3)


def test_quantile_error_does_not_cancel():
    x = 1e6 + 1e-3 * np.random.default_rng(3).normal(size=200)
    assert statistics.quantile(x, 0.5).se == pytest.approx(
        statistics.quantile(x - 1e6, 0.5).se, rel=1e-3
    )


@pytest.mark.parametrize("shape", [0.5, 3.0, 50.0])
def test_a_mean_of_sums_of_powers_is_that_of_the_values(shape, rng):
    """Its skewness is that of SciPy divided by the root of N."""
    x = rng.gamma(shape, 2.0, 5_000)
    found, mean = (
        statistics.mean_of_sums(len(x), x.sum(), (x**2).sum(), (x**3).sum()),
        statistics.mean(x),
    )
    assert (found.value, found.se) == pytest.approx((mean.value, mean.se), rel=1e-12, abs=0)
    skew = stats.skew(x, bias=False) / math.sqrt(len(x))
    assert (found.skew, mean.skew) == pytest.approx((skew, skew), rel=1e-8, abs=0)
    assert found.units == len(x)
    assert statistics.mean_of_sums(4, 8.0, 16.0, 32.0) == Estimate(2.0, 0.0, 0.0, 4)


def test_pooled_rmse_weighs_fixes():
    errors = [np.array([1.0, 2.0, 2.0]), np.array([4.0])]
    rmse = [np.sqrt(np.mean(e**2)) for e in errors]
    pooled = statistics.pooled_rmse(rmse, [3, 1])
    assert pooled.value == pytest.approx(np.sqrt(np.mean(np.concatenate(errors) ** 2)))

    def draw(rng):
        n = rng.integers(1, 30, 200)
        return np.sqrt(rng.chisquare(n) / n * (1 + n / 30)), n

    estimated, actual, _ = spread(statistics.pooled_rmse, draw)
    assert estimated == pytest.approx(actual, rel=0.1), "a ratio of two random means"


def test_estimates_are_scaled_subtracted_and_rooted():
    a, b = Estimate(4.0, 0.3), Estimate(1.0, 0.4)
    assert -2 * a == a * -2 == Estimate(-8.0, 0.6)
    assert a.percent() == Estimate(400.0, 30.0)
    assert a - b == Estimate(3.0, pytest.approx(0.5)), "independent errors add up in quadrature"
    assert a + b == Estimate(5.0, pytest.approx(0.5))
    assert a - 1 == Estimate(3.0, 0.3), "a number has no error"
    assert a + 1 == Estimate(5.0, 0.3)
    assert a.columns("x") == {"x": 4.0, "x_se": 0.3}
    assert a.columns("x_m", "x_se") == {"x_m": 4.0, "x_se": 0.3}
    assert a.root() == Estimate(2.0, pytest.approx(0.3 / 4), pytest.approx(-1.5 * 0.3 / 8))
    assert (Estimate(0.0, 0.1).root().value, math.isnan(Estimate(0.0, 0.1).root().se)) == (0, True)
    for below in (-1.0, math.nan):
        assert all(
            math.isnan(v)
            for v in (Estimate(below, 0.1).root().value, Estimate(below, 0.1).root().se)
        )


def shared_units(rng, n=400):
    """Sums of two methods over units with a common difficulty: hits and tries of each."""
    hard = rng.gamma(2.0, 0.5, n)
    tries = rng.integers(20, 60, n), rng.integers(5, 60, n)
    hits = [k * (s + 0.4 * hard + 0.1 * rng.normal(size=n)) for k, s in zip(tries, (2.0, 1.0))]
    return hits[0], tries[0], hits[1], tries[1]


@pytest.mark.parametrize(("compared", "truth"), [
    (statistics.ratio_difference, 1.0),
    (statistics.ratio_of_ratios, 2.4 / 1.4),
    (lambda *sums: statistics.ratio_of_ratios(*sums).root(), math.sqrt(2.4 / 1.4)),
])  # fmt: skip
def test_errors_of_compared_ratios_count_what_they_share(compared, truth):
    estimated, actual, found = spread(compared, shared_units)
    assert estimated == pytest.approx(actual, rel=0.1)
    assert np.mean([f.value for f in found]) == pytest.approx(
        truth, abs=4 * actual / math.sqrt(2000) + 1e-3
    )
    x, n, y, m = shared_units(np.random.default_rng(1))
    alone = statistics.ratio(x, n) - statistics.ratio(y, m)
    assert statistics.ratio_difference(x, n, y, m).se < 0.8 * alone.se
    assert statistics.ratio_difference(x, n, x, n) == Estimate(0.0, 0.0, units=400)


def test_ratios_without_a_denominator_are_nan():
    none, some = np.zeros(3), np.ones(3)
    for found in (
        statistics.ratio(none, none),
        statistics.ratio_difference(some, some, none, none),
        statistics.ratio_of_ratios(some, some, none, none),
        statistics.ratio_of_ratios(some, some, none, some),
    ):
        assert math.isnan(found.value)
        assert math.isnan(found.se)


def test_jackknife_of_a_mean_is_its_standard_error(rng):
    x = rng.normal(size=(30, 4))
    found = statistics.jackknife(x, lambda e: float(e.mean()))
    each = statistics.mean(x.mean(axis=1))
    assert (found.value, found.se) == (pytest.approx(each.value), pytest.approx(each.se))
    grouped = statistics.jackknife(x, lambda e: float(e.mean()), groups=10)
    tens = statistics.mean([x[g::10].mean() for g in range(10)])
    assert (grouped.value, grouped.se) == (pytest.approx(tens.value), pytest.approx(tens.se))
    assert statistics.jackknife(x, lambda e: float(e.mean()), groups=99) == found


def test_jackknife_of_a_grouped_median_is_its_spread():
    """Within 15 % of the deviation over repeated samples of 400 (20 groups make it rough)."""

    def estimator(x):
        return statistics.jackknife(x, lambda e: float(np.median(e)), groups=20)

    estimated, actual, _ = spread(estimator, lambda rng: skewed(rng, 400), repeats=400)
    assert estimated == pytest.approx(actual, rel=0.15)


def test_jackknife_of_too_little_is_nan():
    assert math.isnan(statistics.jackknife([1.0], lambda e: float(e.sum())).se)
    only = statistics.jackknife([1.0, math.nan], lambda e: float(e[0]) if len(e) == 2 else math.nan)
    assert only.value == 1.0
    assert math.isnan(only.se)


def test_values_that_are_missing_are_left_out_and_too_few_give_nan():
    assert statistics.mean([1.0, np.nan, 3.0]).value == 2.0
    assert math.isnan(statistics.mean([np.nan]).value)
    assert math.isnan(statistics.mean([1.0]).se)
    assert math.isnan(statistics.quantile([], 0.5).value)
    assert math.isnan(statistics.pooled_rmse([np.nan], [0]).value)
    assert math.isnan(statistics.rate(0, 0).value)
    assert math.isnan(statistics.paired([1.0], [2.0]).p_value)
    assert statistics.rate(0, 100).se > 0


def test_paired_differences_cover_and_are_nearly_students():
    """Intervals of the difference and of the percentage: at least 94 % of 5000 samples of 200 pairs
    (a true 95 % misses that with probability 0.001).
    """
    rng = np.random.default_rng(5)
    inside = np.zeros(2)
    for _ in range(5000):
        common = rng.gamma(4, 0.2, 200)
        a, b = 1.1 * common + rng.normal(0, 0.1, 200), common + rng.normal(0, 0.1, 200)
        pair = statistics.paired(a, b)
        inside += [
            lo <= t <= hi
            for (lo, hi), t in zip(
                (pair.difference.interval(), pair.percent.interval()), (0.08, 10.0)
            )
        ]
    assert np.all(inside / 5000 >= 0.94)
    reference = stats.ttest_rel(a, b)
    ends, theirs = pair.difference.interval(), reference.confidence_interval()
    assert ends == pytest.approx(tuple(theirs), abs=0.1 * pair.difference.se)
    assert ends[1] - ends[0] > theirs.high - theirs.low


def test_pairing_beats_independence():
    rng = np.random.default_rng(6)
    common = rng.gamma(4, 0.2, 500)
    a, b = common + 0.01 * rng.normal(size=500), common + 0.01 * rng.normal(size=500)
    assert statistics.paired(a, b).difference.se < 0.1 * math.hypot(
        statistics.mean(a).se, statistics.mean(b).se
    )


def test_equal_values_show_no_difference():
    pair = statistics.paired([1.0, 2.0, 3.0], [1.0, 2.0, 3.0])
    assert (pair.difference.value, pair.difference.se) == (0.0, 0.0)
    assert pair.p_value == 1.0


def test_summary_of_replications():
    rng = np.random.default_rng(1)
    n = 50
    frame = pd.DataFrame({
        "rmse_3d_m": rng.gamma(2, size=n), "rmse_xy_m": 1.0, "rmse_z_m": np.nan, "outcome": ["ok"] * 45 + ["failed"] * 5,
        "n_fixes": 10, "n_ok": [10] * 45 + [6] * 5, "n_rejected": 0, "n_oscillated": 0, "n_diverged": 0,
        "n_failed": [0] * 45 + [4] * 5, "nees": 3.0, "iterations": np.nan, "n_unmeasured": [0] * 49 + [5],
        "n_imprecise": 1,
    })  # fmt: skip
    row = summarise(frame)
    assert set(row) | set(IDENTITY) == set(SUMMARY)
    assert row["replications"] == n
    assert (row["share_unmeasured"], row["share_imprecise"]) == (5 / 500, 50 / 500)
    assert (row["reason"], math.isnan(row["share_reason"])) == (None, True)
    pooled = statistics.pooled_rmse(frame["rmse_3d_m"], frame["n_ok"])
    assert row["rmse_pooled_3d_m_low"] == pooled.interval()[0]
    assert row["rmse_mean_3d_m_high"] == statistics.mean(frame["rmse_3d_m"]).interval()[1]
    median = stats.quantile_test(frame["rmse_3d_m"], p=0.5).confidence_interval(0.95)
    assert (row["rmse_q50_3d_m_low"], row["rmse_q50_3d_m_high"]) == (median.low, median.high)
    squares = frame["n_ok"] * frame["rmse_3d_m"] ** 2
    assert row["largest_share"] == pytest.approx(squares.max() / squares.sum())
    assert row["heavy_tail"] == (row["largest_share"] > 1 - (0.05 / n) ** (1 / (n - 1)))
    assert row["availability"] == pytest.approx(480 / 500)
    assert row["availability_low"] < 480 / 500 < row["availability_high"]
    assert math.isnan(row["cep50_m"]), "no fix is known"
    assert row["failure_rate"] == pytest.approx(0.1)
    wilson = stats.binomtest(5, n).proportion_ci(method="wilson")
    assert (row["failure_rate_low"], row["failure_rate_high"]) == pytest.approx(
        (wilson.low, wilson.high)
    )
    assert row["share_failed"] == pytest.approx(20 / 500)
    assert math.isnan(row["rmse_mean_z_m"])
    assert row["rmse_q50_3d_m"] == pytest.approx(frame["rmse_3d_m"].median())
    assert row["nees_mean"] == 3.0


@pytest.mark.parametrize("n", [1, 2, 30])
def test_nothing_that_is_nan_has_a_standard_error_or_interval(n):
    """Replications that all failed, also where their positions are shared; and a single one."""
    frame = pd.DataFrame({
        "rmse_3d_m": np.nan, "rmse_xy_m": np.nan, "rmse_z_m": np.nan, "outcome": ["failed"] * n,
        "n_fixes": 7, "n_ok": 0, "n_rejected": 0, "n_oscillated": 0, "n_diverged": 0, "n_failed": 7,
        "nees": np.nan, "iterations": np.nan, "n_unmeasured": 0, "n_imprecise": 0,
    })  # fmt: skip
    nothing = np.full((n, 7), np.nan)
    sums = position_sums(nothing, nothing, nothing, np.zeros((n, 7), dtype=bool))
    for row in (summarise(frame), summarise(frame, sums)):
        assert row["failure_rate"] == 1
        assert math.isnan(row["failure_rate_se"]) == (n == 1)
        assert 0 < row["failure_rate_low"] < row["failure_rate_high"] == 1
        values = [name for name in row if f"{name}_se" in row and name != "failure_rate"]
        assert len(values) == 13
        for name in values:
            for end in ("", "_se", "_low", "_high"):
                assert math.isnan(row.get(name + end, math.nan)), name + end


def test_a_standard_error_of_nan_is_nan():
    assert math.isnan(Estimate(math.nan, 0.0).se)
    assert math.isnan((Estimate(1.0, 0.1) - math.nan).se)
    assert math.isnan(statistics.rate(1, 1).se)
    assert statistics.rate(1, 1).value == 1.0
    whole = statistics.jackknife(np.arange(5.0), lambda x: math.nan if len(x) == 5 else x.mean())
    assert math.isnan(whole.value)
    assert math.isnan(whole.se)


def clustered(rng, R, P):
    """Errors (R, P) m whose scale belongs to the position; some fixes fail."""
    scale = rng.uniform(0.5, 1.5, size=P)
    error = np.abs(rng.normal(size=(R, P))) * scale
    accepted = rng.random((R, P)) > 0.1
    return error, 0.6 * error, np.where(accepted, 2.0 + scale, np.nan), accepted


def rows_of(error, plane, iterations, accepted):
    """Replications with these errors (R, P) m, as a table."""

    def rms(e):
        return np.sqrt((np.where(accepted, e, 0.0) ** 2).sum(axis=1) / accepted.sum(axis=1))

    return pd.DataFrame({
        "rmse_3d_m": rms(error), "rmse_xy_m": rms(plane),
        "rmse_z_m": np.sqrt(rms(error) ** 2 - rms(plane) ** 2), "outcome": "ok",
        "n_fixes": error.shape[1], "n_ok": accepted.sum(axis=1), "n_rejected": (~accepted).sum(axis=1),
        "n_oscillated": 0, "n_diverged": 0, "n_failed": 0, "nees": 3.0,
        "iterations": np.nanmean(iterations, axis=1), "n_unmeasured": 0, "n_imprecise": 0,
    })  # fmt: skip


def test_clustered_sums_add_up_and_are_the_plain_ones_of_independent_fixes(rng):
    whole = clustered(rng, 20, 50)
    c, halves = (
        position_sums(*whole),
        position_sums(*(a[:7] for a in whole)) + position_sums(*(a[7:] for a in whole)),
    )
    for f in fields(Clusters):
        assert np.allclose(getattr(c, f.name), getattr(halves, f.name))
    error, _, iterations, accepted = (
        a[:1] for a in whole
    )  # one replication: every fix is its own cluster
    one = tuple(a[:1] for a in whole)
    row = summarise(rows_of(*one), position_sums(*one))
    e = error[accepted]
    assert row["rmse_pooled_3d_m_se"] == pytest.approx(statistics.pooled_rmse(e).se, rel=0.02)
    assert row["rmse_mean_3d_m_se"] == pytest.approx(statistics.pooled_rmse(e).se, rel=0.06)
    assert row["rmse_pooled_z_m_se"] == pytest.approx(0.8 * row["rmse_pooled_3d_m_se"])
    assert row["iterations_mean_se"] == pytest.approx(
        statistics.mean(iterations[accepted]).se, rel=0.02
    )


def test_a_place_per_fix_is_no_place_and_order_does_not_matter(rng):
    whole = clustered(rng, 6, 12)
    mixed = rng.permutation(12)
    plain = position_sums(*whole)
    again = position_sums(*(a[:, mixed] for a in whole), mixed)
    for f in fields(Clusters):
        assert np.allclose(getattr(plain, f.name), getattr(again, f.name))


COVERED = ("rmse_pooled_3d_m", "rmse_mean_xy_m")


@pytest.mark.parametrize("shared", [False, True], ids=["fixes", "campaigns"])
def test_clustered_intervals_cover(shared):
    """400 studies of 12 draws at 80 positions, without and with a part that all fixes of a
    replication share: 92 to 99 % of the intervals cover (false alarm 0.005 at a true 95 %); with
    so few replications, the interval is wider than it need be.
    """
    rng, hits = np.random.default_rng(3), np.zeros(2)
    square = (1 + 1 / 12) * (1 + 1 / 12 if shared else 1)  # mean square of the scales
    truth = {"rmse_pooled_3d_m": np.sqrt(square), "rmse_mean_xy_m": 0.6 * np.sqrt(square)}
    if shared:  # the mean of the replications' RMSE, whose scales have the mean 1
        truth["rmse_mean_xy_m"] = 0.6 * np.sqrt(1 + 1 / 12)
    for _ in range(400):
        error, xy, iterations, accepted = clustered(rng, 12, 80)
        scale = rng.uniform(0.5, 1.5, (12, 1)) if shared else 1.0
        made = error * scale, xy * scale, iterations, accepted
        row = summarise(rows_of(*made), position_sums(*made))
        hits += [row[f"{name}_low"] <= truth[name] <= row[f"{name}_high"] for name in COVERED]
    assert np.all((hits / 400 >= 0.92) & (hits / 400 <= 0.99))


def test_clustered_comparisons_cover():
    """1000 studies of two methods, 10 draws at 200 positions: 93 to 98 % hold the true 10 % (false
    alarm below 1e-4).
    """
    rng, hits = np.random.default_rng(3), 0
    for _ in range(1000):
        scale, rmse, influence = rng.uniform(0.5, 1.5, size=200), [], []
        for factor in (1.1, 1.0):
            own = factor * rng.uniform(0.8, 1.2, size=200)  # each has its own bad positions
            error, accepted = (
                np.abs(rng.normal(size=(10, 200))) * scale * own,
                rng.random((10, 200)) > 0.1,
            )
            rmse.append(np.sqrt((error**2 * accepted).sum(axis=1) / accepted.sum(axis=1)))
            influence.append(influences("rmse_3d_m", error, error, np.ones_like(error), accepted))
        pair = statistics.paired(*rmse, tuple(influence))
        low, high = pair.percent.interval()
        hits += low < 10 < high
    assert pair.units == 200
    assert 0.93 < hits / 1000 < 0.98


def test_packets_of_one_position_are_one_cluster(rng):
    """Grouped sums are those of a batch whose packets were summed per position first."""
    error = rng.rayleigh(size=(6, 12))
    place, all_ = np.repeat(np.arange(4), 3), np.ones(error.shape, dtype=bool)
    c = position_sums(error, error, np.ones_like(error), all_)
    g = position_sums(error, error, np.ones_like(error), all_, place)
    assert np.allclose(g.totals[1], (error**2).reshape(6, 4, 3).sum(axis=(0, 2)))
    assert g.replications == 6
    assert np.allclose(g.influence[0], c.influence[0].reshape(4, 3).sum(axis=1), atol=1e-12)
    same = np.repeat(error[:, ::3], 3, axis=1)
    made = same, same, np.ones_like(error), all_
    grouped, alone = (
        summarise(rows_of(*made), position_sums(*made, at))["rmse_pooled_3d_m_se"]
        for at in (place, None)
    )
    assert grouped > 1.3 * alone


def test_the_commonest_reason_of_each_replication_is_that_of_its_rows(rng):
    """Few different counts and reasons, so that many are equally common."""
    names = np.array(["behind", "innovations", "no_agreement", "covariance"])
    rows = pd.DataFrame(
        [(r, name, rng.integers(1, 4)) for r in range(40) for name in rng.permutation(names)[:3]],
        columns=["replication", "reason", "n"],
    )
    plain = {int(r): commonest(some)[0] for r, some in rows.groupby("replication")}
    assert commonest_of_each(rows) == plain
    assert commonest_of_each(rows[:0]) == {}
