"""The rules of verdicts: equivalence, quantifiers, ties, power, and what more replications do."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import norm

from aoabench.maths import statistics
from aoabench.maths.estimate import Estimate
from aoabench.maths.intervals import normal_quantile
from aoabench.studies.claims import QUANTIFIERS, Limits
from aoabench.studies.verdict import (
    DEPENDS,
    FAILS,
    HOLDS,
    LEVEL,
    NOT_JUDGED,
    UNDECIDED,
    judge,
    together,
    word,
)

Z = normal_quantile(LEVEL)
POSITIVE = Limits(0.0, with_low=False)
PRINTED = Limits(0.325, 0.335)


def test_the_level_is_three_standard_errors():
    assert norm.cdf(Z) - norm.cdf(-Z) == pytest.approx(0.997)
    assert pytest.approx(2.968, abs=5e-4) == Z


@pytest.mark.parametrize(("expected", "limits", "value", "se"), [
    (HOLDS, PRINTED, 0.333, 0.0001),
    (HOLDS, PRINTED, 0.335, 0.0),
    (UNDECIDED, PRINTED, 0.335, 0.001),
    (UNDECIDED, PRINTED, 0.33, 0.01),
    (FAILS, PRINTED, 0.339, 0.001),
    (UNDECIDED, PRINTED, 0.339, 0.002),
    (HOLDS, POSITIVE, 3.0, 1.0),
    (UNDECIDED, POSITIVE, 2.9, 1.0),
    (UNDECIDED, POSITIVE, -2.9, 1.0),
    (FAILS, POSITIVE, -3.0, 1.0),
    (FAILS, POSITIVE, 0.0, 0.0),
    (HOLDS, Limits(4.0), 4.0, 0.0),
    (HOLDS, Limits(high=4.0), 4.0, 0.0),
    (FAILS, Limits(high=4.0, with_high=False), 4.0, 0.0),
    (UNDECIDED, PRINTED, 0.33, math.nan),
    (UNDECIDED, POSITIVE, math.nan, math.nan),
    (HOLDS, POSITIVE, math.inf, 0.0),
])  # fmt: skip
def test_a_claim_holds_only_if_the_whole_interval_lies_within_its_limits(
    expected, limits, value, se
):
    assert judge([Estimate(value, se)], limits).word == expected


VALUES = st.floats(-3, 3).map(lambda x: round(x, 3))
NUMBERS = st.lists(st.builds(Estimate, VALUES, st.floats(0, 1).map(lambda x: round(x, 3))), min_size=1, max_size=6)  # fmt: skip
LIMITS = st.tuples(VALUES, VALUES, st.booleans(), st.booleans()).map(lambda t: Limits(min(t[:2]), max(t[:2]), *t[2:]))  # fmt: skip
LIMITS |= st.builds(Limits, VALUES, st.just(math.inf), st.booleans())


@given(NUMBERS, LIMITS, st.sampled_from(QUANTIFIERS), st.sampled_from([0.0, 0.5]), st.data())
def test_a_larger_standard_error_never_makes_a_claim_hold(numbers, limits, quantifier, tie, data):
    before = judge(numbers, limits, quantifier, tie).word
    factors = data.draw(st.lists(st.floats(1, 50), min_size=len(numbers), max_size=len(numbers)))
    wider = [replace(e, se=f * e.se) for e, f in zip(numbers, factors)]
    after = judge(wider, limits, quantifier, tie).word
    assert not (after == HOLDS and before != HOLDS)


@given(NUMBERS, LIMITS, st.sampled_from(QUANTIFIERS), st.randoms(use_true_random=False))
def test_the_order_of_the_numbers_does_not_matter(numbers, limits, quantifier, random):
    shuffled = random.sample(numbers, len(numbers))
    assert judge(numbers, limits, quantifier).word == judge(shuffled, limits, quantifier).word


@pytest.mark.parametrize(("values", "every", "some", "most"), [
    ((1, 1, 1), HOLDS, HOLDS, HOLDS),
    ((1, 1, 0), UNDECIDED, HOLDS, HOLDS),
    ((1, 1, -1), FAILS, HOLDS, HOLDS),
    ((1, 0, 0), UNDECIDED, HOLDS, UNDECIDED),
    ((1, 0, -1), FAILS, HOLDS, UNDECIDED),
    ((1, -1, -1), FAILS, HOLDS, FAILS),
    ((0, -1, -1), FAILS, UNDECIDED, FAILS),
    ((-1, -1, -1), FAILS, FAILS, FAILS),
    ((1, -1), FAILS, HOLDS, FAILS),  # half is not most
    ((1, 1, -1, 0), FAILS, HOLDS, UNDECIDED),
])  # fmt: skip
def test_quantifiers(values, every, some, most):
    numbers = [Estimate(float(v), 0.1) for v in values]
    found = [judge(numbers, POSITIVE, quantifier) for quantifier in QUANTIFIERS]
    assert [j.word for j in found] == [every, some, most]
    for j in found:
        alone = word(POSITIVE, j.interval)
        assert alone == j.word, "the number that is shown is one that decides"


def test_a_number_without_an_error_does_not_hide_one_that_fails():
    numbers = [Estimate(9.0, math.nan), Estimate(-5.0, 0.1), Estimate(5.0, 0.1)]
    found = judge(numbers, POSITIVE)
    assert (found.word, found.decisive) == (FAILS, 1)
    assert judge(numbers[::2], POSITIVE).decisive == 0


def test_several_numbers_have_intervals_that_hold_together():
    """Bonferroni: each of m at 1 - 0.003/m; a number that alone holds is undecided among twenty."""
    z = norm.isf(0.0015 / 20)
    one = Estimate((Z + z) / 2, 1.0)
    assert judge([one], POSITIVE).word == HOLDS
    among = judge([one] + [Estimate(100.0, 1.0)] * 19, POSITIVE)
    assert (among.word, among.decisive) == (UNDECIDED, 0)
    assert among.interval[0] == pytest.approx(one.value - z)


def test_ties_count_neither_way():
    tie, high = Estimate(-0.01, 0.01), Estimate(5.0, 0.1)
    assert judge([tie, high], POSITIVE).word == UNDECIDED
    found = judge([tie, high], POSITIVE, tie=0.1)
    assert (found.word, found.ties, found.decisive) == (HOLDS, 1, 1)
    assert judge([tie], POSITIVE, tie=0.1).word == UNDECIDED, "nothing but ties"
    assert judge([tie], POSITIVE, "exists", tie=0.1).word == UNDECIDED
    wide = judge([Estimate(-0.01, 0.1), high], POSITIVE, tie=0.1)
    assert (wide.word, wide.ties) == (UNDECIDED, 0), "a tie must be shown, not assumed"
    for value in (0.09, -0.09):  # within on one side alone
        assert judge([Estimate(value, 0.01), high], POSITIVE, tie=0.1).ties == 0


@pytest.mark.parametrize(("words", "expected"), [
    ([HOLDS, HOLDS], HOLDS),
    ([HOLDS, NOT_JUDGED], HOLDS),
    ([HOLDS, UNDECIDED], UNDECIDED),
    ([HOLDS, FAILS, UNDECIDED], DEPENDS),
    ([FAILS, FAILS], FAILS),
    ([FAILS, UNDECIDED], UNDECIDED),
    ([NOT_JUDGED], NOT_JUDGED),
])  # fmt: skip
def test_readings_together(words, expected):
    assert together(words) == expected
    assert together(reversed(words)) == expected


@given(VALUES, st.floats(0.01, 1), st.floats(0, 2))
def test_the_replications_that_would_decide_decide(value, se, low):
    """At `more` times the replications the interval just reaches the nearest limit."""
    limits = Limits(low, low + 1.0)
    found = judge([Estimate(value, se)], limits)
    assert found.word == UNDECIDED or math.isnan(found.more)
    if found.word != UNDECIDED or found.more > 1e8:  # or on the limit up to rounding
        return
    for factor, undecided in ((1.001, False), (0.999, True)):
        again = judge([Estimate(value, se / math.sqrt(found.more * factor))], limits).word
        if found.more > 1.01:
            assert (again == UNDECIDED) == undecided


def test_power_by_simulation():
    """A true difference of `shows` is found in 80 % of 40 000 runs, +- 4 standard errors (0.8 %)."""
    shows = judge([Estimate(0.0, 0.3)], POSITIVE).shows
    values = np.random.default_rng(3).normal(shows, 0.3, 40_000)
    assert np.mean(values - Z * 0.3 > 0) == pytest.approx(0.8, abs=0.008)
    at = [judge([Estimate(v, 0.3)], POSITIVE).word == HOLDS for v in values[:300]]
    assert list(values[:300] - Z * 0.3 > 0) == at


def test_a_verdict_flips_where_it_says():
    numbers = [Estimate(3.0, 0.1), Estimate(2.0, 0.3)]
    low, high = judge(numbers, Limits(-5.0, 5.0)).flips
    for sides, expected in (((low, high), HOLDS), ((low + 1e-6, high), UNDECIDED), ((low, high - 1e-6), UNDECIDED)):  # fmt: skip
        assert judge(numbers, Limits(*sides)).word == expected
    best = judge(numbers, POSITIVE, "exists").flips[0]
    assert judge(numbers, Limits(best - 1e-6), "exists").word == HOLDS
    assert judge(numbers, Limits(best + 1e-6), "exists").word == UNDECIDED


@pytest.mark.parametrize("quantifier", QUANTIFIERS)
@pytest.mark.parametrize("n", [10, 40, 400])
def test_thinning_never_makes_a_false_statement_hold(n, quantifier):
    """20,000 laps whose mean differences are just not positive, thinned to n at random 1,000 times:
    at most 3 thinnings (0.3 %) may give `holds`.

    1.5 are expected at most (one side of 99.7 %), and more than 3 come with a probability of at
    most 7 % a case; the seed is fixed.
    """
    rng = np.random.default_rng(11)
    laps = rng.normal(size=(20_000, 3))
    laps += 0.0 - laps.mean(axis=0)
    if quantifier == "exists":
        laps -= 0.02
    found = []
    for _ in range(1000):
        some = laps[rng.choice(len(laps), n, replace=False)]
        numbers = [statistics.mean(column) for column in some.T]
        found.append(judge(numbers, POSITIVE, quantifier).word)
    assert found.count(HOLDS) <= 3
