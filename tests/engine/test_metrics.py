"""Errors, outcomes and consistency of single replications by hand."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from aoabench.engine import metrics
from aoabench.types import Estimates, Outcome


def estimates(error, outcome, covariance=None):
    position = np.asarray(error, dtype=float)
    return Estimates(position, covariance, None, np.asarray(outcome, dtype=np.int8)), np.zeros_like(
        position
    )


def test_only_fixes_with_a_position_count_and_outcomes_are_counted():
    error = [[[3, 0, 4], [0, 0, 0], [np.nan] * 3, [100, 0, 0], [1, 0, 0]]]
    outcome = [[Outcome.OK, Outcome.OSCILLATED, Outcome.FAILED, Outcome.REJECTED, Outcome.DIVERGED]]
    row = metrics.per_replication(*estimates(error, outcome))
    assert row["rmse_3d_m"][0] == pytest.approx(np.sqrt((25 + 0 + 1) / 3))
    assert row["rmse_xy_m"][0] == pytest.approx(np.sqrt((9 + 0 + 1) / 3))
    assert row["rmse_z_m"][0] == pytest.approx(np.sqrt(16 / 3))
    assert row["outcome"][0] == "failed"
    assert [
        row[f"n_{n}"][0] for n in ("fixes", "ok", "diverged", "oscillated", "failed", "rejected")
    ] == [
        5,
        1,
        1,
        1,
        1,
        1,
    ]


def test_consistency_is_that_of_the_fixes_with_a_position():
    """A rejected fix may come with a position and a covariance: it counts in no mean."""
    outcome = [[Outcome.OK, Outcome.REJECTED, Outcome.DIVERGED]]
    covariance = np.tile(4 * np.eye(3), (1, 3, 1, 1))
    found, truth = estimates([[[2, 0, 0], [50, 0, 0], [0, 4, 0]]], outcome, covariance)
    row = metrics.per_replication(replace(found, iterations=np.array([[2.0, 9.0, 4.0]])), truth)
    assert row["nees"][0] == pytest.approx((1 + 4) / 2)
    assert row["iterations"][0] == pytest.approx(3)


def test_height_is_missing_for_two_dimensional_methods_and_nothing_accepted_gives_nan():
    row = metrics.per_replication(*estimates([[[3, 4, np.nan]]], [[Outcome.OK]]))
    assert row["rmse_xy_m"][0] == pytest.approx(5)
    assert np.isnan(row["rmse_z_m"][0])
    row = metrics.per_replication(*estimates([[[np.nan] * 3]], [[Outcome.FAILED]]))
    assert np.isnan(row["rmse_3d_m"][0])


def test_nees_of_gaussian_errors_is_chi_square_with_three_degrees(rng):
    """Mean and Kolmogorov-Smirnov over 20 000 draws: false alarm 1e-4 each."""
    A = rng.normal(size=(3, 3))
    P = A @ A.T + 0.1 * np.eye(3)
    error = rng.multivariate_normal(np.zeros(3), P, size=(20_000, 1))
    value = metrics.nees(error, np.broadcast_to(P, (20_000, 1, 3, 3)))[:, 0]
    assert abs(value.mean() - 3) < 4 * np.sqrt(6 / 20_000)
    assert stats.kstest(value, stats.chi2(3).cdf).pvalue > 1e-4


def test_nees_of_a_broken_covariance_is_missing_not_an_exception():
    P = np.stack([np.eye(3), np.zeros((3, 3)), np.full((3, 3), np.nan), np.diag([1.0, 1.0, 1e-9])])[
        None
    ]
    value = metrics.nees(np.ones((1, 4, 3)), P)
    assert value[0, 0] == pytest.approx(3)
    assert np.isnan(value[0, 1:]).all()


def test_fixes_of_one_position_share_a_place():
    truth = np.array([[1.0, 2, 0], [0, 0, 0], [1, 2, 0], [0, 5, 0], [0, 0, 0]])
    assert metrics.places(truth).tolist() == [0, 1, 0, 2, 1]
