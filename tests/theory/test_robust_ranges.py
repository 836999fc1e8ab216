"""Ranges in the robust likelihood: minima against scipy, one anchor alone, which ranges count."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from aoabench.errors import Unfit
from aoabench.estimators.robust import RobustLikelihood
from aoabench.estimators.robust_model import prepared
from aoabench.maths.geometry import LIGHT
from aoabench.roles import Noise
from aoabench.types import Outcome
from tests.helpers import Place
from tests.theory.test_robust import (
    EACH,
    ENGINES,
    LOSSES,
    ORACLES,
    SIGMA,
    TIGHT,
    check_gradient,
    errors,
    estimates,
    residuals,
    without_elevation,
    world,
)

RANGE_M = 0.4


def ranged(T=40, B=5, noise_m=RANGE_M, seed=3, **settings):
    """`world` with the distances to the anchors, and their deviations."""
    p, batch = world(T, B, **settings)
    away = np.linalg.norm(p[:, None] - batch.anchors.position[0, 0], axis=-1)
    noise = noise_m * np.random.default_rng(seed).normal(size=away.shape)
    sigma = np.full((1, T, B), RANGE_M / LIGHT)
    return p, replace(batch, delay=(np.abs(away + noise) / LIGHT)[None], delay_sigma=sigma)


def all_residuals(p, batch, t, height=None):
    """Deviations of one fix, ranges included, written without our code."""
    point = np.array([*p, height]) if height is not None else p
    away = np.linalg.norm(point - batch.anchors.position[0, 0], axis=-1)
    dr = (LIGHT * batch.delay[0, t] - away) / (LIGHT * batch.delay_sigma[0, t])
    return np.concatenate([residuals(p, batch, t, height), dr[np.isfinite(dr)]])


def alone(batch, i):
    """The batch in which one anchor alone measures."""
    mine = np.arange(batch.azimuth.shape[2]) == i
    only = {n: np.where(mine, getattr(batch, n), np.nan) for n in ("azimuth", "elevation", "delay")}
    return replace(batch, **only)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("loss", ORACLES)
@pytest.mark.parametrize("height", [None, 1.0])
def test_minima_are_those_of_scipy(engine, loss, height):
    p, batch = ranged(noise_deg=4.0)
    settings = {"loss": loss, "engine": engine, "tolerance_m": 1e-10, "updates": 1000}
    found = estimates(batch, height, **settings)
    assert np.all(found.outcome == Outcome.OK)
    name, scale = ORACLES[loss]
    for t in range(len(p)):
        start = p[t] if height is None else p[t, :2]
        fit = least_squares(all_residuals, start, "3-point", args=(batch, t, height), **TIGHT,
                            loss=name, f_scale=scale)  # fmt: skip
        assert np.abs(found.position[0, t, : len(start)] - fit.x).max() < 1e-6
        if name == "linear":
            freedom = len(fit.fun) - len(start)
            P = max((fit.fun**2).sum() / freedom, 1.0) * np.linalg.inv(fit.jac.T @ fit.jac)
            mine = found.covariance[0, t][: len(start), : len(start)]
            assert np.allclose(mine, P, rtol=1e-4, atol=1e-7)


@pytest.mark.parametrize("loss", EACH, ids=LOSSES)
@pytest.mark.parametrize("height", [np.nan, 1.0])
def test_the_gradient_equals_finite_differences(loss, height):
    p, batch = ranged(noise_deg=15.0, noise_m=1.0)
    shape = batch.azimuth[0].shape
    weights = [np.full(shape, 1 / v**2) for v in (*SIGMA, RANGE_M)]
    s = np.broadcast_to(batch.anchors.position[0], (*shape, 3))
    R = np.broadcast_to(batch.anchors.rotation[0], (*shape, 3, 3))
    r = LIGHT * batch.delay[0]
    given = batch.azimuth[0], batch.elevation[0], *weights[:2], r, weights[2]
    f, _, centre = prepared(given, s, R, height)
    check_gradient(f, p - centre + 0.3, loss, height)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("loss", LOSSES)
@pytest.mark.parametrize("known", [("height",), ("elevation",), ("height", "elevation")])
def test_one_anchor_is_enough_with_its_range(engine, loss, known):
    """Exact measurements of one anchor, whose range ends a ray or meets the plane."""
    p, batch = ranged(noise_deg=0.0, noise_m=0.0, tilt=0.1)
    batch = alone(batch, 2)
    height = 1.0 if "height" in known else None
    given = batch if "elevation" in known else without_elevation(batch)
    found = estimates(given, height, loss=loss, engine=engine, tolerance_m=1e-9, updates=1000)
    assert np.all(found.outcome == Outcome.OK)
    assert errors(found, p, 3 if height is None else 2).max() < 1e-6
    assert np.all(found.anchors_used == 1)
    without = replace(given, delay=None, delay_sigma=None)
    if known != ("height", "elevation"):
        assert np.all(estimates(without, height, loss=loss).outcome == Outcome.FAILED)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_range_far_off_loses_its_weight(engine):
    """One of five ranges 5 m too long, as by a reflection: the median error of student and
    truncated stays within 1.2 times that without this range; that of normal does not.
    """
    p, batch = ranged(T=400, noise_deg=3.0, noise_m=0.2)
    late = np.array([0, 5.0, 0, 0, 0]) / LIGHT
    fewer = replace(batch, delay=np.where(late > 0, np.nan, batch.delay))
    for loss, small in (("normal", False), ("student", True), ("truncated", True)):
        good, bad = (
            np.median(errors(estimates(b, loss=loss, engine=engine), p))
            for b in (fewer, replace(batch, delay=batch.delay + late))
        )
        assert (bad < 1.2 * good) == small, bad / good


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("sigma", [None, 0.0, np.nan, -1.0, np.inf])
def test_a_range_without_a_positive_deviation_is_not_used(engine, sigma):
    _, batch = ranged(noise_m=3.0)
    stated = None if sigma is None else np.full_like(batch.delay, sigma)
    found = estimates(replace(batch, delay_sigma=stated), engine=engine)
    without = estimates(replace(batch, delay=None, delay_sigma=None), engine=engine)
    assert np.array_equal(found.position, without.position)
    assert np.array_equal(found.score, without.score)
    given = estimates(replace(batch, delay_sigma=stated), engine=engine, range_sigma_m=RANGE_M)
    same = estimates(batch, engine=engine)
    assert np.allclose(given.position, same.position, rtol=0, atol=1e-9)
    assert np.abs(same.position - without.position).max() > 0.1
    none = estimates(batch, engine=engine, range_sigma_m=None)
    assert np.array_equal(none.position, without.position)


@pytest.mark.parametrize("engine", ENGINES)
def test_ranges_need_elevations_or_a_known_height(engine):
    """Without both, the slant range to a target of unknown height says nothing in the plane."""
    _, batch = ranged(tilt=0.0)
    flat = without_elevation(batch)
    found = estimates(flat, engine=engine)
    without = estimates(replace(flat, delay=None, delay_sigma=None), engine=engine)
    assert np.array_equal(found.position, without.position, equal_nan=True)
    known = estimates(flat, 1.0, engine=engine).position
    assert np.abs(known - without.position)[..., :2].max() > 0.01


@pytest.mark.parametrize("loss", LOSSES)
@pytest.mark.parametrize("height", [None, 1.0])
def test_both_engines_agree_on_any_pattern_of_measurements(loss, height, rng):
    """In all fixes with two angles more than unknowns: with fewer, a minimum of the loss normal may
    lie on an anchor's pole, where the last steps are rounding.
    """
    _, batch = ranged(T=400, noise_deg=8.0, noise_m=1.0, tilt=0.0)
    arrays = {}
    for name in ("azimuth", "elevation", "delay"):
        value = getattr(batch, name)
        arrays[name] = np.where(rng.random(value.shape) < 0.4, np.nan, value)
    azimuth, elevation = (np.isfinite(arrays[n])[0] for n in ("azimuth", "elevation"))
    enough = (azimuth * (1 + elevation)).sum(axis=1) >= 5
    arrays |= {"delay_sigma": batch.delay_sigma}
    arrays = {name: value[:, enough] for name, value in arrays.items()}
    batch = replace(batch, **arrays)
    fast, plain = (estimates(batch, height, loss=loss, engine=e) for e in ENGINES)
    assert np.array_equal(fast.outcome, plain.outcome)
    assert np.array_equal(fast.reason, plain.reason)
    assert np.array_equal(fast.anchors_used, plain.anchors_used)
    ok = fast.outcome == Outcome.OK
    assert ok.sum() > 100
    assert np.allclose(fast.position[ok], plain.position[ok], rtol=0, atol=1e-6, equal_nan=True)
    assert np.allclose(fast.score[ok], plain.score[ok], rtol=1e-6, atol=0, equal_nan=True)


class Measuring(Noise):
    def __init__(self, *what):
        self.what = frozenset(what)

    def offers(self):
        return self.what


@pytest.mark.parametrize("height", [None, 1.0])
@pytest.mark.parametrize("what", [(), ("elevation",), ("delay",), ("elevation", "delay")])
def test_one_anchor_fits_where_its_measurements_determine_a_position(what, height):
    _, batch = ranged(B=1)
    place, noise = Place(batch.anchors, height), Measuring(*what)
    enough = len(what) + (height is not None) >= 2
    if enough:
        RobustLikelihood().check(place, noise)
    else:
        with pytest.raises(Unfit):
            RobustLikelihood().check(place, noise)
    with pytest.raises(Unfit):
        RobustLikelihood(range_sigma_m=None, height_m="free").check(place, noise)
