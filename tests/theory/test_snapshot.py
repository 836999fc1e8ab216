"""Least squares and Gauss-Newton: exact data, the bound, scipy's optimiser, the errata, degenerate
geometry.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from aoabench import bounds
from aoabench.config.compose import compose_cells
from aoabench.engine.draws import Draws
from aoabench.estimators.least_squares import LeastSquares
from aoabench.estimators.maximum_likelihood import AZIMUTHS, GaussNewton
from aoabench.maths.geometry import facing, wrap
from aoabench.maths.linalg import solve
from aoabench.models.azel import AzEl
from aoabench.noise.angular import NormalAngles
from aoabench.types import Anchors, Batch, Outcome, Reason
from tests.theory.rounding import equal_but_for_rounding, moved_by_rounding

ENGINES = ("auto", "numpy")


def grid(sigma_deg=1.0, reps=1, *words):
    cell = compose_cells(
        [
            "scenario=bs_grid",
            "noise=ae_normal",
            "estimator=[ls]",
            f"noise.sigma_deg={sigma_deg}",
            *words,
        ]
    )[0]
    truth, batch = Draws(cell.scenario, cell.noise, 1).tile(0, reps)
    return cell.scenario, truth, batch


def exact(points, anchors):
    y = AzEl(1.0).predict(points[None], anchors).reshape(1, len(points), -1, 2)
    return Batch(y[..., 0], y[..., 1], anchors)


def rmse(estimates, truth):
    return np.sqrt(np.mean(((estimates.position - truth) ** 2).sum(-1)))


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("rows", ["printed", "invariant"])
def test_exact_angles_give_the_exact_position_in_any_frame(engine, rows, rng):
    anchors = Anchors(rng.uniform(-5, 5, (1, 5, 3)), facing(rng.normal(size=(5, 3)))[None])
    points = rng.uniform(-20, 20, (50, 3))
    for estimator in (
        LeastSquares(rows, engine=engine),
        GaussNewton("kcorr", start=rows, engine=engine),
    ):
        assert np.allclose(
            estimator(exact(points, anchors), None, None).position[0], points, atol=1e-7
        )


@pytest.mark.parametrize("engine", ENGINES)
def test_renaming_x_and_y_changes_the_printed_start_and_not_the_invariant_one(engine):
    """Erratum L6."""
    _, _, batch = grid(4.0)
    swap = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])  # a quarter turn of everything
    turned = replace(
        batch,
        azimuth=wrap(batch.azimuth - np.pi / 2),
        anchors=Anchors(batch.anchors.position @ swap.T, batch.anchors.rotation),
    )
    moved = {}
    for rows in ("printed", "invariant"):
        a, b = (LeastSquares(rows, engine=engine)(x, None, None).position for x in (batch, turned))
        moved[rows] = np.abs(a @ swap.T - b).max()
    assert moved["printed"] > 1.0
    assert moved["invariant"] < 1e-6


@pytest.mark.parametrize("azimuth", AZIMUTHS)
@pytest.mark.parametrize("sigma_deg", [0.5, 4.0, 15.0])
@pytest.mark.parametrize("as_printed", [None, "sign", "atan2"])
def test_the_kernel_equals_numpy(azimuth, sigma_deg, as_printed):
    """Outcomes, positions and numbers of updates. Of fixes that wander for long rounding may decide
    the number (at most 1 %).
    """
    if as_printed and azimuth == "arctan":
        pytest.skip("there is nothing printed otherwise")
    _, _, batch = grid(sigma_deg, 2)
    estimator = GaussNewton(azimuth, as_printed=as_printed, updates=50)
    fast, slow = (replace(estimator, engine=e)(batch, None, None) for e in ENGINES)
    same = (fast.outcome == slow.outcome) & (fast.iterations == slow.iterations)
    assert same.mean() > 0.99
    moved = moved_by_rounding(lambda b: estimator(b, None, None), batch)
    equal_but_for_rounding(fast, slow, moved, same)
    assert np.quantile(moved[0], 0.99) < 1e-9


@pytest.mark.parametrize("B", range(2, 10))
def test_any_number_of_anchors_will_do(B, rng):
    """Kernels pad the anchors to a multiple of four; whatever pads must not be seen."""
    anchors = Anchors(rng.uniform(-5, 5, (1, B, 3)), facing(rng.normal(size=(B, 3)))[None])
    batch = exact(rng.uniform(-20, 20, (50, 3)), anchors)
    noisy = replace(
        batch, azimuth=wrap(batch.azimuth + 0.01 * rng.standard_normal(batch.azimuth.shape))
    )
    a, b = (GaussNewton("kcorr", engine=engine)(noisy, None, None) for engine in ENGINES)
    assert np.mean(a.outcome == Outcome.OK) > 0.9
    assert np.array_equal(a.outcome, b.outcome)
    moved = moved_by_rounding(lambda batch: GaussNewton("kcorr")(batch, None, None), noisy)
    equal_but_for_rounding(a, b, moved)


@pytest.mark.parametrize("engine", ENGINES)
def test_what_is_not_measured_is_left_out(engine, rng):
    anchors = Anchors(rng.uniform(-5, 5, (1, 6, 3)), facing(rng.normal(size=(6, 3)))[None])
    batch = exact(rng.uniform(-9, 9, (40, 3)), anchors)
    azimuth, elevation = batch.azimuth + 0.02, batch.elevation.copy()
    azimuth[0, :, 1], elevation[0, :, 1], elevation[0, :, 4] = np.nan, np.nan, np.nan
    fewer = replace(batch, azimuth=azimuth, elevation=elevation)
    keep = [0, 2, 3, 4, 5]
    without = replace(
        fewer,
        azimuth=azimuth[..., keep],
        elevation=elevation[..., keep],
        anchors=Anchors(anchors.position[:, :, keep], anchors.rotation[:, :, keep]),
    )
    for estimator in (LeastSquares(engine=engine), GaussNewton(engine=engine)):
        a, b = (estimator(x, None, None).position for x in (fewer, without))
        assert np.isfinite(a).all()
        assert np.allclose(a, b, atol=1e-6)


def test_maximum_likelihood_is_what_scipy_minimises():
    scenario, truth, batch = grid(2.0)
    found = GaussNewton("kcorr")(batch, None, None)
    h, anchors = AzEl(1.0), scenario.true_anchors
    y = np.stack([batch.azimuth, batch.elevation], axis=-1)[0].reshape(1000, -1)
    for i in range(0, 1000, 50):
        best = least_squares(
            lambda x, i=i: h.residual(y[i], h.predict(x[None], anchors)[0]), truth[0, i], xtol=1e-12
        )
        assert np.allclose(
            found.position[0, i], best.x, atol=0.02
        )  # the last step is shorter than 0.01 m


@pytest.mark.parametrize("engine", ENGINES)
def test_an_azimuth_that_jumps_by_a_turn_is_corrected(engine, rng):
    """Three of five anchors see the target at azimuth 0, where [0, 2 pi) jumps: measured just below
    a turn and expected just above 0, and the other way round. The fix is what SciPy minimises with
    wrapped residuals.
    """
    position = np.array([[[0.0, 0, 0], [5, 1, 3], [-5, -1, 2], [20, -15, 1], [22, 15, 3]]])
    anchors = Anchors(position, np.tile(np.eye(3), (1, 5, 1, 1)))
    points = rng.uniform([15, -0.5, 0], [25, 0.5, 1], (40, 3))
    truth = exact(points, anchors)
    azimuth, elevation = (
        a + np.deg2rad(2.0) * rng.standard_normal(a.shape) for a in (truth.azimuth, truth.elevation)
    )
    batch = replace(truth, azimuth=wrap(azimuth), elevation=elevation)
    found = GaussNewton("kcorr", engine=engine, tolerance_m=1e-6)(batch, None, None)
    assert np.all(found.outcome == Outcome.OK)
    h, expected = AzEl(1.0), exact(found.position[0], anchors).azimuth
    jump = np.mod(batch.azimuth, 2 * np.pi) - np.mod(expected, 2 * np.pi)
    assert (jump > np.pi).sum() > 5
    assert (jump < -np.pi).sum() > 5
    y = np.stack([batch.azimuth, batch.elevation], axis=-1)[0].reshape(40, -1)
    for i in range(40):
        best = least_squares(
            lambda x, i=i: h.residual(y[i], h.predict(x[None], anchors)[0]), points[i], xtol=1e-12
        )
        assert np.allclose(found.position[0, i], best.x, rtol=0, atol=1e-4)


def test_corrected_likelihood_reaches_the_bound_at_small_noise():
    """Mean square error over the CRB, 100 000 fixes; its clustered standard error is 0.6 %, the
    test's bound 2.5 %.
    """
    scenario, truth, batch = grid(0.25, 100)
    found = GaussNewton("kcorr")(batch, None, None)
    sigma = np.deg2rad(0.25)
    bound = bounds.crb(bounds.azel_information(truth[0], scenario.true_anchors, sigma, sigma))
    assert np.all(found.outcome == Outcome.OK)
    assert rmse(found, truth) ** 2 / np.trace(bound, axis1=-2, axis2=-1).mean() == pytest.approx(
        1, abs=0.025
    )


def test_errata_as_printed_do_harm():
    """L1 (sign) and L2 (arguments of atan2)."""
    _, truth, batch = grid(4.0, 5)
    meant, sign, swapped = (
        GaussNewton(as_printed=p)(batch, None, None) for p in (None, "sign", "atan2")
    )
    assert np.mean(meant.outcome == Outcome.OK) > 0.999
    assert np.mean(sign.outcome == Outcome.OK) < 0.98
    assert rmse(swapped, truth) > 10 * rmse(meant, truth)


@pytest.mark.parametrize("engine", ENGINES)
def test_iterations_that_leave_every_bound_diverge(engine):
    """L5: divergence and oscillation return the start and are told apart; nothing is NaN."""
    _, _, batch = grid(15.0, 4)
    found, start = (
        GaussNewton("atan2", engine=engine, updates=200)(batch, None, None),
        LeastSquares(engine=engine)(batch, None, None),
    )
    for outcome in (Outcome.DIVERGED, Outcome.OSCILLATED):
        some = (found.outcome == outcome) & (found.reason != Reason.BEHIND)
        assert some.sum() > 20
        assert np.allclose(found.position[some], start.position[some])
    assert np.all(found.iterations[found.outcome == Outcome.OSCILLATED] == 200)
    assert np.all(found.iterations[found.outcome == Outcome.DIVERGED] < 200)
    assert np.all(np.isfinite(found.position))


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("azimuth", AZIMUTHS)
def test_rank_deficient_geometry_fails_that_fix_alone(engine, azimuth):
    """One anchor, identical anchors, anchors in line with the target: failed, NaN; the fix beside
    it is fine.
    """
    line = np.array([[[0.0, 0, 0], [1, 1, 1], [2, 2, 2]]])
    for position in (line[:, :1], np.zeros((1, 4, 3)), line):
        anchors = Anchors(position, np.tile(np.eye(3), (1, position.shape[1], 1, 1)))
        batch = exact(np.array([[5.0, 5, 5], [4.0, 1, 2]]), anchors)
        for estimator in (LeastSquares(engine=engine), GaussNewton(azimuth, engine=engine)):
            found = estimator(batch, None, None)
            assert found.outcome[0, 0] == Outcome.FAILED
            assert np.all(np.isnan(found.position[0, 0]))
            if position is line:
                assert np.allclose(found.position[0, 1], [4, 1, 2], atol=1e-6)


@pytest.mark.parametrize("engine", ENGINES)
def test_identical_anchors_fail_with_noise_too(engine, rng):
    """All planes pass through the one place; taking their intersection for a fix would answer the
    anchors' position.
    """
    anchors = Anchors(
        np.tile([[[3.0, 4, 5], [3.0, 4, 5], [3.0, 4, 5], [90.0, 0, 0]]], 1),
        np.tile(np.eye(3), (1, 4, 1, 1)),
    )
    batch = exact(rng.uniform(-9, 9, (30, 3)), anchors)
    azimuth, elevation = (
        a + 0.05 * rng.normal(size=a.shape) for a in (batch.azimuth, batch.elevation)
    )
    azimuth[0, :10, 3] = elevation[0, :10, 3] = np.nan  # the one that stands elsewhere
    batch = replace(batch, azimuth=azimuth, elevation=elevation)
    for estimator in (LeastSquares(engine=engine), GaussNewton(engine=engine)):
        found = estimator(batch, None, None)
        assert np.all(found.outcome[0, :10] == Outcome.FAILED)
        assert np.all(np.isnan(found.position[0, :10]))
        assert np.all(found.outcome[0, 10:] != Outcome.FAILED)


def test_solve_is_numpy_solve(rng):
    A = rng.normal(size=(100, 5, 3))
    A, g = np.swapaxes(A, 1, 2) @ A, rng.normal(size=(100, 3))
    assert np.allclose(solve(A, g), np.linalg.solve(A, g[..., None])[..., 0])


def test_zones_and_positions(rng):
    for zone, least in (("strip", 50.0), ("disc", 50.0), ("none", 0.0)):
        scenario, truth, _ = grid(1.0, 2, f"scenario.zone={zone}", f"scenario.clearance_m={50}")
        assert np.array_equal(truth[0], truth[1])  # fixed by the seed
        d = np.abs(truth[0][:, None, :2] - scenario.true_anchors.position[0, 0, None, :, :2])
        assert {"strip": d.min(), "disc": np.linalg.norm(d, axis=-1).min(), "none": 0.0}[
            zone
        ] >= least
        assert np.all((truth >= 0) & (truth <= [1000, 1000, 20]))
    scenario, truth, _ = grid(1.0, 1, "scenario.zone=ring", "scenario.clearance_m=3")
    d = np.linalg.norm(
        truth[0][:, None, :2] - scenario.true_anchors.position[0, 0, None, :, :2], axis=-1
    ).min(axis=1)
    assert np.allclose(d, 3)
    assert NormalAngles(1.0).sigma > 0
