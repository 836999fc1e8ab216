"""The error of every fix against the stored replications and steps."""

import json

import numpy as np
import pandas as pd
import pytest
from scipy import stats

import aoabench
from aoabench.maths.intervals import share_interval
from aoabench.store.every_fix import FixErrors, errors_over_time, fix_errors

WORDS = ("filter=[ekf_vmf]", "filter.ekf_vmf.engine=numpy", "reps=3", "runner.n_jobs=1")


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Folders of a run with steps, one without, and one whose replications share positions."""
    folder = tmp_path_factory.mktemp("every")
    aoabench.run(*WORDS, "scenario.steps=5", "store.steps=true", out=folder / "steps")
    aoabench.run(*WORDS, "scenario.steps=5", out=folder / "plain")
    grid = ("scenario=bs_grid", "noise=vmf", "scenario.positions=9", "estimator=[vmf_ml]")
    aoabench.run(*grid, *WORDS[2:], out=folder / "shared")
    return folder


def entry_of(out):
    (file,) = (out / "cells").glob("*.json")
    ((_, entry),) = json.loads(file.read_text())["estimators"].items()
    return entry


@pytest.mark.parametrize("axis", ["3d", "xy", "z"])
@pytest.mark.parametrize("run", ["steps", "shared"])
def test_their_mean_squares_are_those_of_the_replications(runs, run, axis):
    found = fix_errors(runs / run, entry_of(runs / run), axis)
    stored = aoabench.load(runs / run)[f"rmse_{axis}_m"]
    ours = np.sqrt(np.nanmean(found.error.astype(float) ** 2, axis=1))
    np.testing.assert_allclose(ours, stored, rtol=1e-6 if run == "shared" else 1e-12)
    assert found.replications == 3
    assert found.tried.all()
    assert (found.place is None) == (run == "steps")


def test_without_steps_or_shared_positions_they_are_unknown(runs):
    assert fix_errors(runs / "plain", entry_of(runs / "plain"), "3d") is None


def test_the_course_is_that_of_the_steps(runs):
    found = errors_over_time(runs / "steps", entry_of(runs / "steps"), "z")
    steps = pd.read_parquet(runs / "steps" / "steps.parquet")
    np.testing.assert_array_equal(found["error"], steps["error_z_m"].abs())
    assert (steps["error_z_m"] < 0).any()
    assert found["step"].tolist() == 3 * list(range(5))


def test_the_band_of_single_values_is_wilson_s():
    values = np.arange(1.0, 11.0)[:, None]
    low, high = FixErrors(values, np.ones(values.shape, dtype=bool)).share_band(
        np.array([3.0, 7.0])
    )
    for i, count in enumerate((3, 7)):
        wilson = stats.binomtest(count, 10).proportion_ci(0.95, "wilson")
        assert (low[i], high[i]) == pytest.approx((wilson.low, wilson.high), rel=0.06)


def test_the_band_takes_fixes_of_a_replication_as_dependent():
    errors = np.random.default_rng(3).exponential(size=(20, 1)) * np.ones((20, 50))
    at = np.sort(errors[:, 0])
    low, high = FixErrors(errors, np.ones(errors.shape, dtype=bool)).share_band(at)
    for i in (5, 10, 15):  # as for 20 single values, as all fixes of a replication are equal
        one = share_interval(errors[:, :1] <= at[i], np.ones((20, 1)))
        assert (low[i], high[i]) == pytest.approx(one, rel=1e-9)


def test_the_band_never_falls():
    """A share of 1 has an interval of its own (see `share_interval`), which is wider than that of
    shares just below.
    """
    errors = np.random.default_rng(3).exponential(size=(20, 50))
    at = np.sort(errors.ravel())[[0, 300, 990, 999]]
    low, high = FixErrors(errors, np.ones(errors.shape, dtype=bool)).share_band(at)
    assert (np.diff(low) >= 0).all()
    assert (np.diff(high) >= 0).all()
    alone = share_interval(errors <= at[-1], np.ones(errors.shape))
    assert alone[0] < low[-2] == low[-1]
