"""The numbers in the figures of a run against SciPy, pandas and the stored tables."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy import stats

import aoabench
from aoabench.errors import UserError
from aoabench.report.runs import values
from aoabench.report.runs.choice import Asked, choose
from aoabench.report.runs.drawing import prepare
from aoabench.report.runs.source import read


def prepared(source, where=(), fixes=True, **asked):
    found = read(source, where)
    return found, choose(found, Asked(**asked), fixes, fixes)


@pytest.fixture
def steps(sweep):
    """The stored steps of one cell, by estimator."""
    frame = pd.read_parquet(sweep / "steps.parquet")
    cells = pd.read_parquet(sweep / "cells.parquet")
    (cell,) = cells[(cells["noise"] == "vmf") & (cells["noise.sigma_deg"] == 5)]["cell"]
    return dict(list(frame[frame["cell"] == cell].groupby("estimator")))


ONE = ("noise=vmf", "noise.sigma_deg=5")


def test_the_distribution_function_is_the_empirical_one(sweep, steps):
    found = values.distributions(*prepared(sweep, ONE, kind="cdf", metric="error_xy_m"))
    points = values.cdf_points(found)
    for name, mine in points.groupby("group"):
        cdf = stats.ecdf(steps[name]["error_xy_m"]).cdf
        np.testing.assert_allclose(mine["share"], [0.0, *cdf.probabilities])
        np.testing.assert_array_equal(mine["x"], [0.0, *cdf.quantiles])
        assert ((mine["low"] <= mine["share"]) & (mine["share"] <= mine["high"])).all()


def test_quantiles_and_counts_are_those_of_the_steps(sweep, steps):
    found = values.distributions(*prepared(sweep, ONE, kind="box"))
    for row in values.quantiles(found).to_dict("records"):
        error = steps[row["group"]]["error_3d_m"]
        levels = error.quantile([0.05, 0.25, 0.5, 0.75, 0.95]).tolist()
        assert [row[name] for name in values.LEVELS] == pytest.approx(levels)
        assert (row["minimum"], row["maximum"]) == (error.min(), error.max())
        assert (row["replications"], row["n"], row["of"]) == (7, 35, 35)
    inside = sum(int((e["error_3d_m"] > 0.5).sum()) for e in steps.values())
    assert values.outside(found, (0.0, 0.5)) == (0, inside)


def test_fixes_without_a_position_end_the_line_below_one(frame):
    whole = frame({"a": [1.0, np.nan, 3.0, 2.0], "b": [np.nan] * 4})
    found = values.distributions(*prepared(whole, fixes=False, kind="cdf"))
    points = values.cdf_points(found)
    assert points[points["group"] == "a"]["share"].tolist() == [0.0, 0.25, 0.5, 0.75]
    assert points[points["group"] == "b"]["share"].tolist() == [0.0]
    assert values.quantiles(found)["n"].tolist() == [3, 0]


def test_many_samples_become_quantiles(frame):
    x = np.random.default_rng(1).exponential(size=5000)
    found = values.distributions(*prepared(frame({"a": x}), fixes=False, kind="violin"))
    some = values.samples(found, most=500)["x"]
    assert len(some) == 500
    assert np.median(some) == pytest.approx(np.median(x), rel=1e-3)


def test_means_have_their_parameters(sweep):
    found = values.means(*prepared(sweep))
    assert list(dict.fromkeys(found["panel"])) == ["noise = ae_flip", "noise = vmf"]
    frame = aoabench.load(sweep)
    for row in found.to_dict("records"):
        mine = frame[
            (frame["noise.sigma_deg"] == row["noise.sigma_deg"])
            & (frame["estimator"] == row["group"])
            & (frame["noise"] == row["panel"].removeprefix("noise = "))
        ]
        assert len(mine) == 7
        assert row["value"] == pytest.approx(mine["rmse_3d_m"].mean())
        assert row["low"] < row["value"] < row["high"]


def test_estimators_that_are_not_causal_are_marked(sweep):
    source, choice = prepared(sweep, ONE)
    found = values.shown(replace(source, late=frozenset(["ekf_vmf"])), choice)
    assert [one.group for one in found] == ["ekf_vmf (non-causal)", "ekf_ae_nominal"]


def test_colours_of_another_column_give_panels_of_estimators(sweep):
    found = values.means(*prepared(sweep, by="noise.sigma_deg", over=("noise",)))
    assert list(dict.fromkeys(found["group"])) == ["2", "5", "10"]
    assert list(dict.fromkeys(found["panel"])) == ["ekf_vmf", "ekf_ae_nominal"]


def test_estimators_can_be_an_axis(sweep):
    found = values.means(*prepared(sweep, ONE[1:], by="noise", over=("estimator",), kind="curve"))
    frame = aoabench.load(sweep).query("`noise.sigma_deg` == 5")
    wanted = frame.groupby(["noise", "estimator"])["rmse_3d_m"].mean()
    assert found.set_index(["group", "estimator"])["value"].to_dict() == pytest.approx(
        wanted.to_dict()
    )


def test_the_course_is_the_median_of_the_replications(sweep, steps):
    found = values.courses(*prepared(sweep, ONE, kind="time", metric="error_xy_m"))
    assert found["timed"].all()
    for name, mine in found.groupby("group"):
        each = steps[name].groupby("step")["error_xy_m"]
        np.testing.assert_allclose(mine["median"], each.median())
        np.testing.assert_allclose(mine["low"], each.quantile(0.05))
        np.testing.assert_allclose(mine["high"], each.quantile(0.95))
        assert mine["x"].tolist() == pytest.approx(steps[name]["time_s"].unique().tolist())
        assert (mine["n"] == 7).all()


def test_many_steps_become_spans(monkeypatch, sweep, steps):
    monkeypatch.setattr(values, "_MOST_TIMES", 3)
    found = values.courses(*prepared(sweep, (*ONE, "estimator=ekf_vmf"), kind="time"))
    assert found["steps"].tolist() == [2, 2, 2]
    frame = steps["ekf_vmf"]
    spans = frame.groupby(frame["step"] // 2)
    np.testing.assert_allclose(found["median"], spans["error_3d_m"].median())
    np.testing.assert_allclose(found["x"], spans["time_s"].mean())
    assert found["n"].tolist() == [14, 14, 7]


def test_tracks_of_a_recording_stay_apart(recorded):
    where = ("estimator=ls_lines",)
    found = values.courses(*prepared(recorded(True), where, kind="time", metric="error_xy_m"))
    assert found["track"].value_counts().to_dict() == {0: 9, 1: 6}
    steps = pd.read_parquet(recorded(True) / "steps.parquet")
    mine = steps[steps["estimator"] == "ls_lines"]
    np.testing.assert_allclose(found["median"], mine["error_xy_m"])


@pytest.mark.parametrize("asked", [{}, {"kind": "time"}, {"kind": "pairs"}, {"metric": "nees"}])
def test_a_recording_without_truth_is_one_line(recorded, asked):
    with pytest.raises(UserError, match="without ground truth has no errors; give the truth with"):
        prepare(recorded(False), Asked(**asked))


def test_a_recording_without_truth_shows_what_it_has(recorded):
    found = values.distributions(*prepared(recorded(False), kind="box", metric="n_ok"))
    assert values.quantiles(found)["maximum"].tolist() == [9, 9]


@pytest.mark.parametrize("run", ["sweep", "grid"])
def test_pairs_state_the_change_of_compare(run, request):
    out = request.getfixturevalue(run)
    base = "ls" if run == "grid" else "ekf_vmf"
    points, rows = values.paired(*prepared(out, kind="pairs", baseline=base))
    table = aoabench.compare(out, base)
    assert len(rows) == len(table)
    columns = ["change", "change_low", "change_high", "n"]
    ours = rows.sort_values("change")[columns].to_numpy(dtype=float)
    np.testing.assert_array_equal(ours, table.sort_values("change")[columns].to_numpy(dtype=float))
    smaller = (points["y"] < points["x"]).groupby(points["panel"]).sum()
    assert dict(zip(rows["panel"], rows["smaller"])) == smaller.to_dict()


def test_pairs_of_a_frame_are_those_of_its_folder(sweep):
    _, rows = values.paired(*prepared(aoabench.load(sweep), kind="pairs"))
    _, wanted = values.paired(*prepared(sweep, kind="pairs"))
    pd.testing.assert_frame_equal(rows, wanted)


def test_pairs_without_values_and_ties_are_counted(frame):
    x = np.array([1.0, 2.0, 3.0, 4.0])
    whole = frame({"base": x, "same": x, "half": [0.5, 3, np.nan, 4], "none": [np.nan] * 4})
    _, rows = values.paired(*prepared(whole, kind="pairs", baseline="base"))
    counts = rows[["estimator", "n", "of", "smaller", "equal"]].to_numpy().tolist()
    assert counts == [["same", 4, 4, 0, 4], ["half", 3, 4, 1, 1], ["none", 0, 4, 0, 0]]


def test_a_baseline_alone_in_its_cells_is_one_line(frame):
    whole = frame({"a": [1.0, 2.0], "b": [1.0, 3.0], "c": [2.0, 3.0]}, x=[1, 2])
    apart = whole[(whole["x"] == 1) == (whole["estimator"] != "c")]
    with pytest.raises(
        UserError, match="baseline=c: no other estimator of these results has cells"
    ):
        values.paired(*prepared(apart, kind="pairs", baseline="c"))


def test_a_metric_without_any_value_is_one_line(frame):
    whole = frame({"a": [np.nan, np.nan]}, x=[1, 2])
    for kind, maker in (("curve", values.means), ("box", values.distributions)):
        with pytest.raises(
            UserError, match="metric=rmse_3d_m: no replication has a value; use ano"
        ):
            maker(*prepared(whole, fixes=False, kind=kind))
