"""The coverage study at its quick scale, and the committed table."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from aoabench.maths.estimate import Estimate
from aoabench.report.plots import error_bars
from aoabench.studies import study

RESULTS = Path(__file__).parents[2] / "results"
STUDY = study.load("coverage")


@pytest.fixture(scope="module")
def quick():
    frames = [getattr(STUDY.numbers, item.name)("quick") for item in STUDY.items]
    return pd.concat(frames, ignore_index=True)


def test_a_quick_run_has_a_row_for_every_method_and_quantity(quick):
    methods = {"ekf_vmf", "ukf_ae_adaptive", "ekf_aoa", "ml_arctan", "ml_atan2", "discrepancy"}
    assert set(quick["estimator"]) == methods
    assert set(quick["quantity"]) == {"pooled RMSE", "mean RMSE", "median", "change"}
    assert quick["coverage"].between(0, 1).all()
    assert (quick["coverage_low"] <= quick["coverage"]).all()
    assert (quick["unflagged_runs"] <= quick["coverage_runs"]).all()
    assert (quick["coverage_runs"] == 3).all()


def test_the_reference_is_the_value_of_all_runs(quick):
    """The mean of the runs' mean squares, and medians of pooled values between those of the runs."""
    numbers = STUDY.numbers
    values = np.array([1.0, 2.0, 3.0])
    assert numbers._reference("pooled RMSE", values, []).value == pytest.approx(np.sqrt(14 / 3))
    assert numbers._reference("mean RMSE", values, []).value == 2.0
    pools = [np.array([1.0, 9.0]), np.array([2.0]), np.array([3.0, 3.5])]
    assert numbers._reference("median", values, pools).value == 3.0
    means = [np.array([1.0, 2.0]), np.array([2.0, 2.0])]
    assert numbers._reference("change", values, means).value == pytest.approx(-25.0)


def test_committed_coverage_is_what_the_readme_states():
    """Where at most 5 % of the runs are flagged, the upper limit of the coverage of the runs without
    a flag reaches 93 %, but for the cases that the README names.
    """
    readme = (STUDY.folder / "README.md").read_text(encoding="utf-8")
    for item in STUDY.items:
        frame = pd.read_parquet(study.table_path(RESULTS, STUDY, item))
        plain = frame[frame["flagged"] <= 0.05]
        for row in plain[plain["unflagged_high"] < 0.93].itertuples():
            assert f"`{item.name}`, `{row.estimator}`" in readme, row
        assert (frame.loc[frame["estimator"] == "ekf_vmf", "flagged"] <= 0.05).all()


def test_error_bars_are_three_standard_errors_or_the_interval():
    rows = pd.DataFrame([Estimate(2.0, 0.1).columns("x"), Estimate(3.0, 0.2, 0.5, 20).columns("x")])
    below, above = error_bars(rows, "x")
    assert (below[0], above[0]) == pytest.approx((0.3, 0.3))
    low, high = Estimate(3.0, 0.2, 0.5, 20).interval(0.9973002039367398)
    assert (below[1], above[1]) == pytest.approx((3 - low, high - 3))
    assert above[1] > 2 * below[1]
    wide = pd.DataFrame([Estimate(1.0, 2.0).columns("x")])
    assert error_bars(wide, "x", log=True)[0] == pytest.approx(0.9)
    assert np.isnan(error_bars(pd.DataFrame([{"x": 1.0, "x_se": np.nan}]), "x")).all()
