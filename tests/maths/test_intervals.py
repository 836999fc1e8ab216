"""Coverage of every interval: by simulation, or by exact enumeration where the distribution is
discrete.

Seeds are fixed. Simulated coverages rest on 10 000 samples unless said otherwise: their standard
error is 0.22 %, so a true coverage of 94.7 % is measured below the limit of 94 % with probability
0.001 (the false-alarm rate per case).
"""

import math

import numpy as np
import pytest
from scipy import stats

from aoabench.maths import intervals, statistics
from aoabench.store.clusters import AXES, position_sums
from aoabench.store.summary import QUANTILES

SIMULATIONS, N = 10_000, 200

# name -> draw (N,), mean, mean square; the last two are as skewed as the errors of filters that
# sometimes get lost
POPULATIONS = {
    "rayleigh": (lambda rng: rng.rayleigh(1.0, N), math.sqrt(math.pi / 2), 2.0),
    "maxwell": (lambda rng: np.sqrt(rng.chisquare(3, N)), 2 * math.sqrt(2 / math.pi), 3.0),
    "gamma": (lambda rng: rng.gamma(3.0, 0.3, N), 0.9, 1.08),
    "exponential": (lambda rng: rng.exponential(1.0, N), 1.0, 2.0),
    "lognormal": (lambda rng: rng.lognormal(0.0, 0.5, N), math.exp(0.125), math.exp(0.5)),
}


def coverage(interval, draw, truth, simulations=SIMULATIONS, seed=20180710):
    rng = np.random.default_rng(seed)
    found = np.array([interval(draw(rng)) for _ in range(simulations)])
    return np.mean((found[:, 0] <= truth) & (truth <= found[:, 1]))


@pytest.mark.parametrize("name", POPULATIONS)
def test_means_and_rmse_cover(name):
    """At least 94 % of nominal 95 % for both, of 200 replications; 93 % for the squares of
    exponential and lognormal values, whose kurtosis is 70 and 114.
    """
    draw, mean, square = POPULATIONS[name]
    assert 0.94 <= coverage(lambda x: statistics.mean(x).interval(), draw, mean) < 0.965
    assert (
        (0.93 if name in ("lognormal", "exponential") else 0.94)
        <= coverage(lambda x: statistics.pooled_rmse(x).interval(), draw, math.sqrt(square))
        < 0.965
    )


def test_rmse_weighs_fixes_and_covers():
    def draw(rng):
        n = rng.integers(1, 30, N)
        return np.stack([np.sqrt(rng.chisquare(n) / n * (1 + n / 30)), n])

    n = np.arange(1, 30)
    truth = math.sqrt((n * (1 + n / 30)).sum() / n.sum())
    assert coverage(lambda x: statistics.pooled_rmse(*x).interval(), draw, truth) >= 0.94


@pytest.mark.parametrize("n", [1, 7, 50, 200])
def test_wilson_is_scipys_and_its_coverage_by_enumeration(n):
    """Mean coverage over all rates within 1 % of nominal from 50 on; at least 92 % where 10 or more
    are expected.
    """
    k = np.arange(n + 1)
    found = np.array([intervals.rate_interval(int(i), n) for i in k])
    theirs = [stats.binomtest(int(i), n).proportion_ci(method="wilson") for i in k]
    assert found == pytest.approx(np.array([(c.low, c.high) for c in theirs]), abs=1e-12)
    p = np.linspace(0.0005, 0.9995, 2000)
    covered = stats.binom.pmf(k, n, p[:, None]) @ np.eye(n + 1)
    covered = (covered * ((found[:, 0] <= p[:, None]) & (p[:, None] <= found[:, 1]))).sum(axis=1)
    if n >= 50:
        assert covered.mean() == pytest.approx(0.95, abs=0.01)
        assert covered[np.minimum(p, 1 - p) * n >= 10].min() > 0.92


@pytest.mark.parametrize("n", [200, 301, 1000])
@pytest.mark.parametrize("q", QUANTILES)
def test_quantile_intervals_by_enumeration(n, q):
    """Between order statistics l and u: covered are l <= B < u, B binomial. Neither tail above 2.5
    %, none wasted.
    """
    low, high = (int(v) for v in intervals.quantile_interval(np.arange(1, n + 1), q))
    B = stats.binom(n, q)
    assert B.cdf(low - 1) <= 0.025 < B.cdf(low)
    assert B.sf(high - 1) <= 0.025 < B.sf(high - 2)
    assert 0.95 <= B.cdf(high - 1) - B.cdf(low - 1) < 0.99


def test_quantile_intervals_say_where_no_order_statistic_reaches():
    low, high = intervals.quantile_interval(np.arange(20), 0.05)
    assert low == -math.inf
    assert 0 < high < 20


@pytest.mark.parametrize("n", [20, 200])
def test_pointwise_band_by_enumeration(n):
    """Each point of the distribution function is covered with at least 95 %, whatever its value."""
    band = intervals.cdf_band(np.arange(n), pointwise=True)
    k = np.arange(n + 1)
    low, high = np.append(0.0, band.low), np.append(1 - 0.025 ** (1 / n), band.high)
    p = np.linspace(0.001, 0.999, 999)[:, None]
    covered = (stats.binom.pmf(k, n, p) * ((low <= p) & (p <= high))).sum(axis=1)
    assert covered.min() >= 0.95
    exact = stats.binomtest(n // 2, n).proportion_ci(method="exact")
    assert (band.low[n // 2 - 1], band.high[n // 2 - 1]) == pytest.approx((exact.low, exact.high))


def test_simultaneous_band_covers_the_whole_function():
    """Uniform values, no end of the band overstepped anywhere; 95 to 96.5 % (false alarm: 0.02, its
    truth is 95.4 %).
    """
    rng, inside = np.random.default_rng(2), 0
    for _ in range(SIMULATIONS):
        band = intervals.cdf_band(rng.random(N))
        before = np.append(band.high[0] - 1 / N, band.high[:-1])  # just left of each step
        inside += bool(np.all(band.low <= band.x) and np.all(band.x <= before))
    assert 0.95 <= inside / SIMULATIONS < 0.965
    narrow, wide = (
        intervals.cdf_band(rng.random(N), pointwise=True),
        intervals.cdf_band(rng.random(N)),
    )
    assert np.mean(narrow.high - narrow.low) < np.mean(wide.high - wide.low)


def test_bands_know_ties_and_leave_out_what_is_missing():
    for pointwise in (False, True):
        band = intervals.cdf_band([1.0, 2.0, 2.0, math.nan, 3.0], pointwise=pointwise)
        assert list(band.x) == [1, 2, 2, 3]
        assert list(band.share) == [0.25, 0.75, 0.75, 1.0]
        assert len(intervals.cdf_band([], pointwise=pointwise).x) == 0


def lost_together(rng, R=N, T=10):
    """Horizontal errors (R, T) m whose scale belongs to the replication; a tenth of the fixes is
    missing.
    """
    e = rng.rayleigh(1.0, (R, T)) * rng.uniform(0.5, 1.5, (R, 1))
    return np.where(rng.random((R, T)) < 0.1, np.nan, e)


@pytest.mark.parametrize("probability", [0.5, 0.9, 0.95])
def test_cep_covers_though_fixes_depend_on_each_other(probability):
    from scipy.integrate import quad
    from scipy.optimize import brentq

    def below(e):
        return quad(lambda c: 1 - math.exp(-((e / c) ** 2) / 2), 0.5, 1.5)[0]

    truth = brentq(lambda e: below(e) - probability, 0.01, 10)
    assert coverage(lambda e: intervals.cep_interval(e, probability), lost_together, truth) >= 0.94


@pytest.mark.parametrize("probability", [0.5, 0.9, 0.95])
def test_cep_intervals_are_as_wide_as_the_actual_error_and_the_bootstraps(probability):
    """Within 8 % of the deviation over 2000 samples."""
    rng = np.random.default_rng(4)
    samples = [lost_together(rng) for _ in range(2000)]
    actual = np.std([np.nanquantile(e, probability) for e in samples])
    z = intervals.normal_quantile(2 / 3)
    ends = [intervals.cep_interval(e, probability, confidence=2 / 3) for e in samples]
    assert np.mean([high - low for low, high in ends]) / (2 * z) == pytest.approx(actual, rel=0.08)
    e = lost_together(rng, R=400)
    se, (low, high) = intervals.bootstrap(
        lambda x: np.nanquantile(x, probability), e, resamples=1000
    )
    assert intervals.cep_interval(e, probability) == pytest.approx((low, high), abs=0.8 * se)


def test_cep_intervals_count_what_a_replication_shares():
    """Positions with a scale of their own, and replications too: 93 to 98 % of 400 samples, less
    than 90 % over either alone (false alarm: 1e-3).
    """
    rng, place, inside = np.random.default_rng(14), np.arange(30), np.zeros(3)
    truth = np.median(
        rng.rayleigh(1.0, 10**6) * rng.uniform(0.3, 1.7, 10**6) * rng.uniform(0.3, 1.7, 10**6)
    )
    for _ in range(400):
        e = rng.rayleigh(1.0, (30, 30))
        e *= rng.uniform(0.3, 1.7, (30, 1)) * rng.uniform(0.3, 1.7, 30)
        both, draws = intervals.cep_interval(e, 0.5, place), intervals.cep_interval(e)
        alone = intervals.cep_interval(e.T)
        inside += [low <= truth <= high for low, high in (both, draws, alone)]
    assert 0.93 <= inside[0] / 400 <= 0.98
    assert max(inside[1:]) / 400 < 0.9


def test_intervals_of_several_quantiles_are_those_of_each(rng):
    """Also of errors in single precision, whose quantiles are taken in double precision."""
    e = np.where(rng.random((9, 40)) < 0.1, np.nan, rng.rayleigh(1.0, (9, 40)))
    for error, place in ((e, None), (e, rng.permutation(40) % 7), (e.astype(np.float32), None)):
        found = intervals.cep_intervals(error, [0.1, 0.5, 0.9], place)
        for p, ends in zip((0.1, 0.5, 0.9), found):
            known = np.isfinite(error)
            below = (error <= np.quantile(error[known].astype(float), p)).astype(float)
            se = intervals.share_error(below, known.astype(float), place)
            levels = np.clip([p - 1.959964 * se, p + 1.959964 * se], 0, 1)
            assert ends == pytest.approx(np.quantile(error[known].astype(float), levels), rel=1e-6)
            assert intervals.cep_interval(error, p, place) == ends


def test_the_error_of_a_share_is_that_of_plain_influences(rng):
    """Of each fix on the share, summed over the fixes of a unit; places come in any order."""
    tries = rng.random((8, 24)) < 0.8
    hits, place = tries & (rng.random((8, 24)) < 0.4), rng.permutation(np.arange(24) % 6)
    n, share = tries.sum(), hits.sum() / tries.sum()
    influence = (hits - share * tries) / n
    over = 8 / 7 * sum(influence[r].sum() ** 2 for r in range(8))
    assert intervals.share_error(hits, tries) == pytest.approx(np.sqrt(over))
    cells = np.array([[influence[r, place == p].sum() for p in range(6)] for r in range(8)])
    square = 6 / 5 * (cells.sum(axis=0) ** 2).sum() + max(over - (cells**2).sum(), 0)
    for kind in (bool, float):
        found = intervals.share_error(hits.astype(kind), tries.astype(kind), place)
        assert found == pytest.approx(np.sqrt(square))


def test_packets_of_one_position_are_one_unit():
    rng = np.random.default_rng(15)
    e, place = rng.rayleigh(1.0, (5, 30)), np.repeat(np.arange(10), 3)
    copies, hits = np.repeat(e[:, ::3], 3, axis=1), np.ones((5, 30))
    once = intervals.share_interval((e[:, ::3] < 1), hits[:, ::3], np.arange(10))
    assert intervals.share_interval((copies < 1), hits, place) == pytest.approx(once)
    mixed = rng.permutation(30)
    assert intervals.share_interval((copies < 1)[:, mixed], hits, place[mixed]) == pytest.approx(
        once
    )


def test_shares_of_independent_fixes_have_wilsons_interval():
    rng = np.random.default_rng(16)
    hits = rng.random((4000, 1)) < 0.3
    expected = stats.binomtest(int(hits.sum()), 4000).proportion_ci(method="wilson")
    found = intervals.share_interval(hits, np.ones((4000, 1)))
    assert found == pytest.approx((expected.low, expected.high), rel=2e-4)
    never = intervals.share_interval(np.zeros((20, 50)), np.ones((20, 50)))
    expected = stats.binomtest(0, 20).proportion_ci(method="wilson")
    assert never == (0.0, pytest.approx(expected.high)), "20 units, not 1000 tries"
    whole = intervals.share_interval(np.ones((20, 50)), np.ones((20, 50)), np.arange(50))
    assert whole[0] == pytest.approx(stats.binomtest(50, 50).proportion_ci(method="wilson").low)
    nothing = pytest.approx((math.nan, math.nan), nan_ok=True)
    assert intervals.share_interval(np.zeros((3, 0)), np.zeros((3, 0))) == nothing
    assert intervals.share_interval(np.ones((1, 5)), np.ones((1, 5))) == nothing


@pytest.mark.parametrize("n", [1, 2, 6, 25, 100])
def test_quantile_intervals_are_scipys(n):
    x = np.random.default_rng(17).normal(size=n)
    for q in (0.05, 0.5, 0.9):
        theirs = stats.quantile_test(x, p=q).confidence_interval(0.95)
        low, high = intervals.quantile_interval(x, q)
        assert low == (-math.inf if math.isnan(theirs.low) else theirs.low)
        assert high == (math.inf if math.isnan(theirs.high) else theirs.high)


def root(x):
    return math.sqrt(np.mean(x * x))


def test_bootstrap_and_delta_method_agree_for_the_rmse():
    rng = np.random.default_rng(5)
    x = rng.gamma(3.0, 0.3, 1000)
    se, (low, high) = intervals.bootstrap(root, x, resamples=4000)
    assert se == pytest.approx(statistics.pooled_rmse(x).se, rel=0.05)
    assert statistics.pooled_rmse(x).interval() == pytest.approx((low, high), abs=0.15 * se)
    n = rng.integers(1, 20, 1000)
    weighted, _ = intervals.bootstrap(
        lambda r, n: math.sqrt((n * r * r).sum() / n.sum()), x, n, resamples=4000
    )
    assert weighted == pytest.approx(statistics.pooled_rmse(x, n).se, rel=0.05)


def clustered_estimates(sums, error, fixes):
    """The clustered estimates of errors (R, P) m in 3-D."""
    rmse = np.sqrt((error**2).mean(axis=1))
    over = {f"rmse_pooled_{axis}_m": statistics.pooled_rmse(rmse, fixes) for axis in AXES}
    over |= {f"rmse_mean_{axis}_m": statistics.mean(rmse) for axis in AXES}
    return sums.estimates(over | {"iterations_mean": statistics.mean(rmse)})


def test_bootstrap_of_whole_positions_agrees_with_clusters():
    rng = np.random.default_rng(6)
    scale = rng.uniform(0.5, 1.5, 300)
    error = np.abs(rng.normal(size=(10, 300))) * scale
    everything = position_sums(
        error, 0.6 * error, np.ones_like(error), np.ones(error.shape, dtype=bool)
    )
    se, _ = intervals.bootstrap(root, error, axis=1, resamples=3000)
    found = clustered_estimates(everything, error, np.full(10, 300))
    assert found["rmse_pooled_3d_m"].se == pytest.approx(se, rel=0.07)
    assert intervals.bootstrap(root, error, axis=0, resamples=500)[0] < 0.6 * se, (
        "draws alone tell too little"
    )


def test_bootstrap_is_paired_and_repeats_itself():
    rng = np.random.default_rng(7)
    common = rng.gamma(4, 0.2, 300)
    a, b = 1.1 * common + rng.normal(0, 0.05, 300), common + rng.normal(0, 0.05, 300)

    def percent(x, y):
        return 100 * (x.mean() / y.mean() - 1)

    once, again = (intervals.bootstrap(percent, a, b, resamples=2000) for _ in range(2))
    assert once == again
    pair = statistics.paired(a, b)
    assert once[0] == pytest.approx(pair.percent.se, rel=0.07)
    assert once[1] == pytest.approx(pair.percent.interval(), abs=0.3 * once[0])
    assert math.isnan(intervals.bootstrap(root, [1.0])[0])


def test_bootstrap_covers():
    """BCa of 500 samples of 200, 400 resamples each: at least 91.5 % (a true 94.5 % misses that
    with 0.003).
    """
    draw, _, square = POPULATIONS["gamma"]
    found = coverage(
        lambda x: intervals.bootstrap(root, x, resamples=400)[1], draw, math.sqrt(square), 500
    )
    assert found >= 0.915


def test_too_few_values_give_nan():
    nothing = pytest.approx((math.nan, math.nan), nan_ok=True)
    assert statistics.mean([1.0]).interval() == pytest.approx((math.nan, math.nan), nan_ok=True)
    assert math.isnan(statistics.pooled_rmse([1.0, math.nan]).interval()[0])
    assert intervals.rate_interval(0, 0) == nothing
    assert intervals.quantile_interval([], 0.5) == nothing
    assert intervals.cep_interval(np.full((5, 3), math.nan)) == nothing
    assert statistics.mean([2.0, 2.0]).interval() == (2.0, 2.0)


# --- several comparisons --------------------------------------------------------------------------


def test_holm_by_hand():
    """Sorted 0.005 0.01 0.03 0.04 times 4 3 2 1, never falling: 0.02 0.03 0.06 0.06; a NaN does not
    count.
    """
    assert intervals.holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert intervals.holm([0.01, math.nan, 0.5]) == pytest.approx(
        [0.02, math.nan, 0.5], nan_ok=True
    )
    assert intervals.holm([0.6, 0.7]) == pytest.approx([1.0, 1.0])
    assert len(intervals.holm([])) == 0


def test_holm_holds_the_rate_of_false_claims():
    """Six estimators that are all alike against one: any claim in at most 5 % (+ 3 of its errors)
    of 10 000 tables.
    """
    rng = np.random.default_rng(8)
    z = (rng.normal(size=(SIMULATIONS, 6)) - rng.normal(size=(SIMULATIONS, 1))) / math.sqrt(2)
    false = np.array([np.any(intervals.holm(p) < 0.05) for p in 2 * stats.norm.sf(np.abs(z))])
    assert false.mean() < 0.05 + 3 * 0.0022
    assert np.mean(2 * stats.norm.sf(np.abs(z)).min(axis=1) < 0.05) > 0.15, "without it"


def events(n, both, only_a, only_b):
    a, b = np.zeros(n, dtype=bool), np.zeros(n, dtype=bool)
    a[: both + only_a] = True
    b[:both] = True
    b[both + only_a : both + only_a + only_b] = True
    return a, b


def test_paired_rates_are_mcnemars():
    for more, fewer in ((0, 0), (1, 0), (7, 2), (3, 3), (30, 12)):
        pair = statistics.paired_rate(*events(200, 5, more, fewer))
        expected = stats.binomtest(more, more + fewer).pvalue if more + fewer else 1.0
        assert pair.p_value == pytest.approx(expected)
        assert pair.difference.value == (more - fewer) / 200
        low, high = pair.percent.interval()
        assert low < 100 * pair.difference.value < high, (
            "never of no width, even where nothing differs"
        )


@pytest.mark.parametrize(
    ("p", "q"), [(0.01, 0.01), (0.05, 0.01), (0.1, 0.1), (0.3, 0.1), (0.002, 0.0)]
)
def test_paired_rates_cover_by_enumeration(p, q):
    """All outcomes of 100 replications of which a share p fails only in one and q only in the
    other: at least 94 %.
    """
    n, covered = 100, 0.0
    X = stats.multinomial(n, [p, q, 1 - p - q])
    for more in range(60):
        for fewer in range(40):
            weight = X.pmf([more, fewer, n - more - fewer])
            if weight > 1e-9:
                low, high = statistics.paired_rate(*events(n, 0, more, fewer)).percent.interval()
                covered += weight * (low <= 100 * (p - q) <= high)
    assert covered >= 0.94


def test_so_many_replications_do_show_it():
    """Predicted from one run: power 0.8 at a true difference of 1 %, over 2000 runs of that size
    (0.77 to 0.83).
    """
    rng = np.random.default_rng(11)

    def pair(n, percent=1.0):
        common = rng.gamma(4, 0.25, n)
        return statistics.paired(
            common * (1 + percent / 100) + rng.normal(0, 0.05, n), common + rng.normal(0, 0.05, n)
        )

    n = round(np.mean([statistics.needed(pair(300, 0.0), 1.0, comparisons=4) for _ in range(200)]))
    assert np.mean([pair(n).p_value < 0.05 / 4 for _ in range(2000)]) == pytest.approx(
        0.8, abs=0.03
    )
