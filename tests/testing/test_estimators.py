"""The kit of rules for estimators: a good one passes, and each rule finds what breaks it."""

import numpy as np
import pytest

from aoabench import Estimates, UserError
from aoabench.models.unit_vector import UnitVector
from aoabench.testing import ContractError, check_estimator
from aoabench.testing.estimators import RULES
from tests.filters.test_recursion import PlainEKF
from tests.testing.plugins import FAULTY, DenseOnly, Lines


def broken(plugin, **more):
    """The rules that a plug-in breaks, with what they say."""
    with pytest.raises(ContractError) as error:
        check_estimator(plugin, **more)
    return {one.rule: one.problem for one in error.value.results if one.problem}, str(error.value)


def test_a_good_estimator_obeys_every_rule():
    found = check_estimator(Lines())
    assert [one.rule for one in found] == [rule.name for rule in RULES]
    skipped = {one.rule for one in found if one.skipped}
    assert skipped == {"covariances", "heard"}


def test_a_good_filter_obeys_every_rule():
    found = check_estimator(PlainEKF(UnitVector(100.0)))
    assert {one.rule: one.skipped for one in found if one.skipped} == {
        "nothing": "a filter predicts",
        "rotated": "the motion model is not the same in all directions",
    }


@pytest.mark.parametrize(("rule", "plugin", "words"), FAULTY, ids=[f"{r}-{i}" for i, (r, *_) in enumerate(FAULTY)])  # fmt: skip
def test_each_rule_finds_what_breaks_it(rule, plugin, words):
    found, text = broken(plugin)
    assert rule in found
    with pytest.raises(ContractError, match=words):
        raise ContractError("x", [one for one in _results(plugin) if one.rule == rule])
    assert f"of {len(RULES)} rules" in text


def _results(plugin):
    with pytest.raises(ContractError) as error:
        check_estimator(plugin)
    return error.value.results


def test_the_rule_of_heard_anchors_finds_a_filter_that_takes_all():
    found, _ = broken(DenseOnly(UnitVector(100.0)))
    assert "a batch of the anchors heard" in found["heard"]


def test_all_broken_rules_are_listed_at_once():
    plugin = next(p for r, p, _ in FAULTY if r == "missing")
    found, text = broken(plugin)
    assert {"missing", "nothing"} <= set(found)
    assert text.splitlines()[0] == f"Changed breaks {len(found)} of {len(RULES)} rules"
    assert len(text.splitlines()) == 1 + len(found)


def test_a_bare_function_is_an_estimator_too():
    found, _ = broken(lambda batch, scenario, streams: 3)
    assert "must return Estimates, not int" in found["values"]


def test_a_rule_that_cannot_hold_is_skipped_with_its_reason():
    plugin = next(p for r, p, _ in FAULTY if r == "permuted")
    reasons = dict.fromkeys(broken(plugin)[0], "as is")
    found = check_estimator(plugin, skip=reasons)
    assert {one.rule: one.skipped for one in found if one.skipped == "as is"} == reasons
    with pytest.raises(
        UserError, match=r"skip='permutes': no such rule; did you mean 'permuted'\?"
    ):
        check_estimator(plugin, skip={"permutes": "as is"})


def test_an_estimator_that_fits_nowhere():
    class Alone(Lines):
        needs = frozenset({"height", "delay"})

    with pytest.raises(UserError, match=r"Alone does not fit .* state a scenario and a noise"):
        check_estimator(Alone())


def test_a_random_estimator_is_not_held_to_laws():
    def guess(batch, scenario, streams):
        shape = batch.azimuth.shape[:2]
        draws = [streams.estimator(i).standard_normal((shape[1], 3)) for i in range(shape[0])]
        lost = np.isnan(batch.azimuth).all(axis=2)
        return Estimates(np.where(lost[..., None], np.nan, draws), None, None, np.where(lost, 4, 0))

    found = check_estimator(guess, skip={"sendable": "a local function"})
    laws = ("permuted", "shifted", "turned", "azimuths")
    assert all("draws random numbers" in one.skipped for one in found if one.rule in laws)
