"""Means and intervals of the figures are those of the summary and of `compare`."""

import numpy as np
import pandas as pd
import pytest
from scipy import stats

import aoabench
from aoabench.errors import UserError
from aoabench.report.runs.metrics import NAMES, estimates, label, mean_label
from aoabench.report.runs.source import read


@pytest.mark.parametrize(
    ("metric", "column"),
    [
        ("rmse_3d_m", "rmse_mean_3d_m"),
        ("rmse_xy_m", "rmse_mean_xy_m"),
        ("failure_rate", "failure_rate"),
        ("cep50_m", "cep50_m"),
        ("rmse_pooled_z_m", "rmse_pooled_z_m"),
    ],
)
@pytest.mark.parametrize("run", ["sweep", "grid"])
def test_a_folder_gives_the_numbers_of_its_summary(run, metric, column, request):
    out = request.getfixturevalue(run)
    found = estimates(read(out), metric).set_index(["cell", "estimator"])
    summary = pd.read_parquet(out / "summary.parquet").set_index(["cell", "estimator"])
    for name, ours in (("value", column), ("low", f"{column}_low"), ("high", f"{column}_high")):
        wanted = summary[ours].loc[found.index]
        np.testing.assert_array_equal(found[name], wanted)
    if metric == "rmse_3d_m":
        table = aoabench.compare(out)
        for row in table.to_dict("records"):
            assert found["value"][row["cell"], row["estimator"]] == pytest.approx(row["mean"])


def test_other_columns_have_student_s_interval(frame):
    """Of symmetric values, whose skewness is 0: Student's interval, widened for the skewness that
    few values may hide.
    """
    x = np.linspace(-1, 1, 2001) + 5
    row = estimates(read(frame({"a": x})), "rmse_3d_m").iloc[0]
    low, high = stats.t.interval(0.95, len(x) - 1, loc=5, scale=stats.sem(x))
    assert row["value"] == pytest.approx(5.0)
    assert (row["low"], row["high"]) == pytest.approx((low, high), rel=1e-4)


def test_a_rate_has_wilson_s_interval(frame):
    whole = frame({"a": np.ones(9)})
    whole.loc[:1, "outcome"] = ["failed", "diverged"]
    row = estimates(read(whole), "failure_rate").iloc[0]
    wilson = stats.binomtest(2, 9).proportion_ci(0.95, "wilson")
    assert row["value"] == pytest.approx(2 / 9)
    assert (row["low"], row["high"]) == pytest.approx((wilson.low, wilson.high))


def test_iterations_are_clustered_where_positions_are_shared(grid):
    """The standard error of the summary lies behind the interval: its half-width is Student's."""
    found = estimates(read(grid), "iterations").set_index(["cell", "estimator"])
    frame = pd.read_parquet(grid / "summary.parquet").set_index(["cell", "estimator"])
    assert set(frame["se_by"]) == {"position"}
    rows = frame[frame["iterations_mean"].notna()]
    assert len(rows) == 2
    for key, row in rows.iterrows():
        half = (found["high"][key] - found["low"][key]) / 2
        assert found["value"][key] == row["iterations_mean"]
        assert half > 1.96 * row["iterations_mean_se"]
        plain = estimates(read(aoabench.load(grid)), "iterations").set_index(["cell", "estimator"])
        assert half != pytest.approx((plain["high"][key] - plain["low"][key]) / 2)


def test_values_that_lack_are_counted(frame):
    found = estimates(read(frame({"a": [1.0, np.nan, 3.0], "b": [np.nan] * 3})), "rmse_3d_m")
    assert found["n"].tolist() == [2, 0]
    assert found["of"].tolist() == [3, 3]
    assert found["value"].isna().tolist() == [False, True]


def test_one_replication_has_no_interval(frame):
    row = estimates(read(frame({"a": [1.0]})), "rmse_3d_m").iloc[0]
    assert row["value"] == 1.0
    assert np.isnan([row["low"], row["high"]]).all()


def test_a_frame_lacks_the_summary(frame):
    with pytest.raises(UserError, match="metric=cep50_m: a frame does not hold it; allowed"):
        estimates(read(frame({"a": [1.0]})), "cep50_m")


def test_each_metric_has_a_label_with_its_unit():
    for name in NAMES:
        assert ("[m]" in label(name)) == name.endswith("_m"), name
    assert label("noise.sigma_deg") == "noise.sigma [deg]"
    assert label("noise.kappa") == "noise.kappa"
    assert mean_label("rmse_xy_m") == "mean RMSE in the plane [m]"
    assert mean_label("rmse_q50_3d_m") == "median RMSE 3-D [m]"
    assert mean_label("cep90_m") == "CEP90, error in the plane [m]"
