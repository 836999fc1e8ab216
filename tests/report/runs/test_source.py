"""Conditions on the replications of a figure, and the parameters that tell them apart."""

import pytest

from aoabench.errors import UserError
from aoabench.report.runs.source import Source, ordered, read, value_text, varied

TWO = {"a": [1.0, 2.0], "b": [3.0, 4.0]}


@pytest.mark.parametrize("text", ["5", "5.0", "5e0"])
def test_numbers_are_chosen_however_they_are_written(frame, text):
    whole = frame(TWO, **{"noise.sigma_deg": [2, 5, 10]})
    chosen = read(whole, [f"noise.sigma_deg={text}", "estimator=b"]).frame
    assert chosen["noise.sigma_deg"].unique().tolist() == [5]
    assert chosen["estimator"].unique().tolist() == ["b"]
    assert len(read(whole, [f"noise.sigma_deg={text},10"]).frame) == 8


def test_values_with_commas_and_without_value_can_be_chosen(frame):
    whole = frame(TWO, **{"scenario.shape": ["[1,2]", None], "flag": [True, False]})
    assert set(read(whole, ["scenario.shape=[1,2]"]).frame["scenario.shape"]) == {"[1,2]"}
    assert read(whole, ["scenario.shape=null", "flag=true"]).frame["cell"].unique() == "None-True"


@pytest.mark.parametrize(
    ("condition", "message"),
    [
        ("noise", "where noise: not a condition; allowed: KEY=VALUE[,VALUE]"),
        ("sigma_deg=2", "where sigma_deg: no such column; did you mean 'noise.sigma_deg'?"),
        ("rmse_3d_m=1", "where rmse_3d_m: no such column; allowed: estimator, scenario, noise"),
        ("noise.sigma_deg=3", "where noise.sigma_deg=3: no results have it; allowed: 2, 10"),
        ("estimator=aa", "where estimator=aa: no results have it; did you mean 'a'?"),
    ],
)
def test_a_condition_that_does_not_fit_is_one_line(frame, condition, message):
    with pytest.raises(UserError) as error:
        read(frame(TWO, **{"noise.sigma_deg": [2, 10]}), [condition])
    assert str(error.value).startswith(message)


def test_conditions_that_leave_nothing_are_one_line(frame):
    whole = frame(TWO, x=[1, 2])
    whole = whole[(whole["x"] == 1) | (whole["estimator"] == "a")]
    with pytest.raises(UserError, match="where x=2 and estimator=b: no results have all of these"):
        read(whole, ["x=2", "estimator=b"])


def test_a_frame_of_something_else_is_one_line(frame):
    with pytest.raises(UserError, match="the frame has no column cell, replication; allowed"):
        read(frame(TWO).drop(columns=["cell", "replication"]))


def test_the_frame_given_stays_as_it_is(frame):
    whole = frame(TWO)
    before = whole.copy()
    read(whole)
    assert before.equals(whole)


def test_parameters_that_others_determine_are_left_out(frame):
    whole = frame(TWO, **{"noise.sigma_deg": [2, 5], "scenario.points": [10, 20]})
    whole["noise"] = whole["noise.sigma_deg"].map({2: "x", 5: "y"})
    assert varied(read(whole)) == ["estimator", "noise", "scenario.points"]
    first = varied(read(whole), ["noise.sigma_deg"])
    assert first == ["noise.sigma_deg", "estimator", "scenario.points"]


def test_cells_that_no_parameter_tells_apart_are_named(frame):
    whole = frame(TWO, hidden=[1, 2]).drop(columns="hidden")
    assert varied(read(whole)) == ["estimator", "cell"]


def test_the_kind_of_measurements_is_known(frame):
    whole = frame(TWO, noise=["vmf", "recorded"])
    assert read(whole).recorded == "synthetic and recorded"
    assert read(whole, ["noise=vmf"]).recorded == "synthetic"
    assert read(whole, ["noise=recorded"]).recorded == "recorded"


def test_numbers_come_in_order_before_texts(frame):
    whole = frame(TWO, x=[10, 9, 100])
    assert ordered(whole["x"]) == [9, 10, 100]
    assert [value_text(v) for v in (5.0, 0.25, True, None, float("nan"), "a")] == [
        "5",
        "0.25",
        "true",
        "null",
        "null",
        "a",
    ]


def test_a_folder_has_the_rows_of_its_summary_that_are_chosen(sweep):
    found = read(sweep, ["noise=vmf", "estimator=ekf_vmf"])
    assert isinstance(found, Source)
    assert len(found.summary) == 3
    assert set(found.summary["estimator"]) == {"ekf_vmf"}
    assert len(found.frame) == 3 * 7
