"""Estimates: laws of their intervals and tests, second order by brute force, and coverage."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from aoabench.maths import statistics
from aoabench.maths.estimate import Estimate, _student, _studentised, combined, stored
from aoabench.maths.tails import largest_share, usual_share

skews, quantiles = st.floats(-3, 3), st.floats(-9, 9)
estimates = st.builds(
    Estimate, st.floats(-5, 5), st.floats(0.01, 3), st.floats(-1, 1), st.floats(3, 1e4)
)


@given(quantiles, quantiles, skews)
def test_the_transformation_increases_and_is_inverted(y, z, a):
    assert _student(_studentised(y, a), a) == pytest.approx(y, abs=1e-8)
    if y < z:
        assert _studentised(y, a) <= _studentised(z, a)
    assert _studentised(-y, -a) == -_studentised(y, a)


@given(st.floats(-3, 3), st.floats(-1e-4, 1e-4))
def test_the_transformation_is_johnsons_to_second_order(y, a):
    expected = y - a / 6 - a * y * y / 3
    assert _studentised(y, a) == pytest.approx(expected, abs=10 * a * a * (1 + abs(y) ** 3) + 1e-15)


def test_a_symmetric_known_error_gives_the_normal_interval():
    assert Estimate(3.0, 0.5).interval(0.9) == pytest.approx(stats.norm.interval(0.9, 3.0, 0.5))
    assert Estimate(1.0, 0.5).p_value() == pytest.approx(2 * stats.norm.sf(2))


def test_many_values_give_students_interval():
    """The margin of the skewness is 2 sqrt(6) / N, whose effect on an end is that times (1 + 2 y^2) / 6."""
    x = np.concatenate([np.arange(2000.0), -np.arange(2000.0)])
    ends, theirs = statistics.mean(x).interval(), stats.ttest_1samp(x, 0).confidence_interval()
    se = statistics.mean(x).se
    assert ends == pytest.approx(tuple(theirs), abs=2 * math.sqrt(6) / 4000 * 1.5 * se)
    assert ends[0] < theirs.low
    assert ends[1] > theirs.high


@given(estimates, st.floats(-4, 4), st.floats(-10, 10), st.sampled_from([0.5, 0.95, 0.999]))
def test_intervals_scale_and_shift(e, a, b, confidence):
    low, high = e.interval(confidence)
    ends = sorted((a * low + b, a * high + b))
    assert (a * e + b).interval(confidence) == pytest.approx(tuple(ends), abs=1e-9)


@given(
    st.builds(
        Estimate, st.floats(-5, 5), st.floats(0.01, 3), st.floats(-30, 30), st.just(math.inf)
    ),
    st.sampled_from([0.8, 0.95, 0.997, 0.999]),
)
def test_an_interval_contains_its_number_however_skew_this_is(e, confidence):
    low, high = e.interval(confidence)
    assert low <= e.value <= high


@given(
    st.floats(-5, 5), st.floats(0.01, 3), st.floats(-30, 30), st.sampled_from([0.8, 0.95, 0.997])
)
def test_tests_and_intervals_agree_however_skew_the_number_is(value, se, skew, confidence):
    e = Estimate(value, se, skew)
    low, high = e.interval(confidence)
    if min(abs(low), abs(high)) > 1e-9:
        assert (e.p_value() < 1 - confidence) == (low > 0 or high < 0)


@given(estimates)
def test_intervals_are_nested(e):
    ends = [e.interval(c) for c in (0.5, 0.8, 0.95, 0.99, 0.999)]
    lows, highs = zip(*ends)
    assert list(lows) == sorted(lows, reverse=True)
    assert list(highs) == sorted(highs)


@given(estimates, st.sampled_from([0.3, 0.8, 0.95, 0.999]))
def test_the_p_value_inverts_the_interval(e, confidence):
    for end in e.interval(confidence):
        assert (e - end).p_value() == pytest.approx(1 - confidence, abs=1e-6)
    inside, beyond = e.value, e.interval(confidence)[1] + 0.01 * e.se
    assert (e - inside).p_value() > 1 - confidence
    assert (e - beyond).p_value() < 1 - confidence


def test_a_p_value_of_no_error_is_0_or_1():
    assert Estimate(0.0, 0.0).p_value() == 1
    assert Estimate(0.1, 0.0).p_value() == 0
    assert math.isnan(Estimate(0.1, math.nan).p_value())
    assert Estimate(2.0, 0.0).interval() == (2.0, 2.0)
    assert all(math.isnan(end) for end in Estimate(2.0, math.nan).interval())
    assert all(math.isnan(end) for end in statistics.mean([1.0]).interval())


def test_means_have_the_unbiased_skewness(rng):
    x = rng.exponential(size=40)
    e = statistics.mean(x)
    assert e.skew == pytest.approx(stats.skew(x, bias=False) / math.sqrt(40))
    assert (e.value, e.se, e.units) == (x.mean(), pytest.approx(stats.sem(x)), 40)
    assert statistics.mean(rng.permutation(x)).interval() == pytest.approx(e.interval())


def of(f):
    """A function of weights (N,) from a function of weighted means."""
    return lambda columns, w: f(*(columns @ w))


@pytest.mark.parametrize(("ours", "plain"), [
    (lambda x: statistics.mean(x[0]), of(lambda a, b, c, d: a)),
    (lambda x: statistics.ratio(x[0], x[1]), of(lambda a, b, c, d: a / b)),
    (lambda x: statistics.ratio(x[0], x[1]).root(), of(lambda a, b, c, d: math.sqrt(a / b))),
    (lambda x: statistics.pooled_rmse(np.sqrt(x[0] / x[1]), x[1]), of(lambda a, b, c, d: math.sqrt(a / b))),
    (lambda x: statistics.ratio_difference(*x), of(lambda a, b, c, d: a / b - c / d)),
    (lambda x: statistics.ratio_of_ratios(*x), of(lambda a, b, c, d: a * d / (b * c))),
    (lambda x: statistics.ratio_of_ratios(*x).root(), of(lambda a, b, c, d: math.sqrt(a * d / (b * c)))),
    (lambda x: statistics.paired(x[0], x[1]).percent, of(lambda a, b, c, d: 100 * (a / b - 1))),
    (lambda x: statistics.paired(x[0], x[1]).difference, of(lambda a, b, c, d: a - b)),
], ids=["mean", "ratio", "root", "rmse", "difference", "ratios", "root of ratios", "percent", "paired"])  # fmt: skip
def test_second_order_by_brute_force(ours, plain):
    """Influences and the curvature along them by differences of weights: value, error, skewness."""
    n = 60
    x = np.random.default_rng(1).gamma(3, size=(4, n))
    even, step = np.full(n, 1 / n), 1e-5
    nudge = step * (np.eye(n) - even)
    influence = np.array([(plain(x, even + d) - plain(x, even - d)) / (2 * step) for d in nudge])
    direction, long = influence / n / influence.var(), 1e-3
    ends = [plain(x, even + h * direction) for h in (long, -long)]
    curve = (sum(ends) - 2 * plain(x, even)) / long**2
    se = influence.std(ddof=1) / math.sqrt(n)
    e = ours(x)
    assert (e.value, e.se) == (pytest.approx(plain(x, even)), pytest.approx(se, rel=1e-6))
    expected = stats.skew(influence, bias=False) / math.sqrt(n) + 1.5 * se * curve
    assert e.skew == pytest.approx(expected, abs=1e-4)


def test_independent_sums_add_cumulants(rng):
    """Against the sum of 10^6 draws of each, from gamma distributions, whose skewness is known."""
    a, b = Estimate(3.0, 0.5, 0.8, 12), Estimate(1.0, 0.3, -0.4, 7)
    total = a - b
    third = 0.8 * 0.5**3 + 0.4 * 0.3**3
    assert (total.value, total.se) == (2.0, pytest.approx(math.hypot(0.5, 0.3)))
    assert total.skew == pytest.approx(third / total.se**3)
    welch = (0.25 + 0.09) ** 2 / (0.25**2 / 11 + 0.09**2 / 6)
    assert total.units == pytest.approx(welch + 1)
    assert (a + 1).interval() == pytest.approx(tuple(1 + v for v in a.interval()))
    assert combined(5.0, a, Estimate(0.0, 0.0)) == Estimate(
        5.0, pytest.approx(0.5), pytest.approx(0.8), pytest.approx(12)
    )


def test_estimates_survive_a_table():
    e = Estimate(2.0, 0.3, 0.2, 20)
    assert stored(e.columns("x"), "x") == e
    assert stored(e.columns("x_m", "x_se"), "x_m", "x_se") == e
    assert set(e.columns("x_m", "x_se")) == {"x_m", "x_se", "x_skew", "x_units"}
    plain = Estimate(2.0, 0.3)
    assert plain.columns("x") == {"x": 2.0, "x_se": 0.3}
    assert stored(plain.columns("x"), "x") == plain
    mixed = {"x": 2.0, "x_se": 0.3, "x_skew": math.nan, "x_units": math.nan}
    assert stored(mixed, "x") == plain, "of a table whose other rows are not normal"
    with pytest.raises(KeyError):
        stored({"x": 3.0}, "x")  # of a table of another version


@pytest.mark.parametrize(("n", "least"), [(10, 0.905), (25, 0.915), (100, 0.925)])
def test_intervals_cover_the_mean_of_a_lognormal(n, least):
    """Skewness 6.2, kurtosis 111: `least` of 3000 samples (false alarm 1e-3); value ± 1.96 standard
    errors cover 79, 85 and 91 %.
    """
    rng, inside = np.random.default_rng(2), np.zeros(2)
    truth = math.exp(0.5)
    for _ in range(3000):
        e = statistics.mean(rng.lognormal(size=n))
        low, high = e.interval()
        inside += [low <= truth <= high, abs(e.value - truth) <= 1.96 * e.se]
    assert inside[0] / 3000 >= least
    assert inside[1] / 3000 < least


@pytest.mark.parametrize("count", [0, 1, 5, 50])
def test_rates_are_near_wilsons_interval(count):
    ends = statistics.rate(count, 100).interval()
    theirs = stats.binomtest(count, 100).proportion_ci(method="wilson")
    assert ends == pytest.approx((theirs.low, theirs.high), abs=0.013)


def test_quantiles_have_the_interval_of_the_order_statistics():
    """At least 92 % of 1000 samples of 25 for three quantiles (false alarm 1e-3 at 94.5 %)."""
    rng, inside = np.random.default_rng(3), 0
    for _ in range(1000):
        low, high = statistics.quantile(rng.lognormal(size=25), 0.5).interval()
        inside += low <= 1 <= high
    assert inside / 1000 >= 0.92


def test_the_largest_share_is_usual_for_exponential_squares_and_not_beyond():
    """5 % of 4000 samples exceed it, 4 to 6.2 % (false alarm 1e-3); for the union bound is nearly
    exact. Means of 30 squares never do.
    """
    rng = np.random.default_rng(4)
    for n in (10, 25, 100):
        squares = rng.exponential(size=(4000, n))
        shares = np.array([largest_share(x) for x in squares])
        assert shares == pytest.approx(squares.max(axis=1) / squares.sum(axis=1))
        assert 0.04 <= (shares > usual_share(n)).mean() <= 0.062
        means = rng.gamma(30, size=(1000, n))
        assert max(largest_share(x) for x in means) < usual_share(n)
    assert usual_share(1) == 1
    assert math.isnan(largest_share([]))
    assert math.isnan(largest_share([0.0, math.nan]))
    assert largest_share([1.0, math.nan, 3.0]) == 0.75
