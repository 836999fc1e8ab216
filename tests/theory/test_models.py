"""Measurement models: Jacobians against finite differences, likelihoods against scipy, residuals,
poles.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from aoabench.errors import BadValue
from aoabench.maths.geometry import euler, facing, to_unit, wrap
from aoabench.models.azel import AzEl, AzElAdaptive, AzElFitted, adaptive_table
from aoabench.models.unit_vector import UnitVector
from aoabench.noise.angular import FlippedAngles, VonMisesFisher
from aoabench.types import Anchors, Batch

NOISE = FlippedAngles(10.0)
MODELS = [
    AzEl(),
    AzEl(sigma_deg=7.0),
    AzElFitted(noise=NOISE),
    AzElAdaptive(noise=NOISE),
    UnitVector(),
    UnitVector(kappa=20.0),
]


def make_anchors(rng, B=4):
    return Anchors(
        rng.uniform(-5, 5, (1, B, 3)), np.stack([euler(rng.normal(size=3)) for _ in range(B)])[None]
    )


def make_batch(rng, anchors, R=6, T=3):
    shape = (R, T, anchors.count)
    sigma = np.full(shape, np.deg2rad(10))
    az, el = rng.uniform(-np.pi, np.pi, shape), rng.uniform(-1.5, 1.5, shape)
    return Batch(az, el, anchors, azimuth_sigma=sigma, elevation_sigma=sigma)


@pytest.mark.parametrize("h", MODELS, ids=lambda h: type(h).__name__)
@pytest.mark.parametrize("n", [3, 6])
def test_jacobian_equals_finite_differences(h, n, rng):
    """Central differences, step 1e-6 m: agreement to 1e-6; the state may be longer than a position
    (erratum N2).
    """
    anchors = make_anchors(rng)
    x = rng.uniform(-4, 4, (200, n))
    J = h.jacobian(x, anchors)
    assert J.shape == (200, h.predict(x, anchors).shape[-1], n)
    step = 1e-6
    for i in range(n):
        dx = step * np.eye(n)[i]
        numeric = h.residual(h.predict(x + dx, anchors), h.predict(x - dx, anchors)) / (2 * step)
        assert np.allclose(J[..., i], numeric, atol=1e-6, rtol=1e-5)
    if n > 3:
        assert np.all(J[..., 3:] == 0)


@pytest.mark.parametrize("h", MODELS, ids=lambda h: type(h).__name__)
def test_functions_broadcast_over_points(h, rng):
    """EKF (R, n), sigma points (R, S, n) and particles (R, M, n) get the same numbers."""
    anchors = make_anchors(rng)
    y, r = h.observe(make_batch(rng, anchors))
    x = rng.uniform(-4, 4, (6, 5, 3))
    for s in range(5):
        one = np.ascontiguousarray(x[:, s])
        assert np.allclose(h.predict(x, anchors)[:, s], h.predict(one, anchors), atol=1e-13)
        assert np.allclose(h.jacobian(x, anchors)[:, s], h.jacobian(one, anchors), atol=1e-13)
        many = np.broadcast_to(h.covariance(x, anchors, r[:, 0]), h.predict(x, anchors).shape)
        assert np.allclose(many[:, s], h.covariance(one, anchors, r[:, 0]))
        assert np.allclose(
            h.loglik(x, anchors, y[:, 0], r[:, 0])[:, s], h.loglik(one, anchors, y[:, 0], r[:, 0])
        )


def test_variances_are_the_squares_of_the_stated_deviations(rng):
    """Azimuth and elevation in turn; the unit vector takes the larger of the two thrice [(7)]."""
    anchors, shape = make_anchors(rng, 3), (2, 5, 3)
    a, e = rng.uniform(0.01, 0.3, (2, *shape))
    batch = Batch(
        rng.uniform(-3, 3, shape), rng.uniform(-1, 1, shape), anchors,
        azimuth_sigma=a, elevation_sigma=e,
    )  # fmt: skip
    y, r = AzEl().observe(batch)
    assert np.array_equal(y[..., 0::2], batch.azimuth)
    assert np.array_equal(y[..., 1::2], batch.elevation)
    assert np.allclose(r[..., 0::2], a**2, rtol=1e-14, atol=0)
    assert np.allclose(r[..., 1::2], e**2, rtol=1e-14, atol=0)
    _, r = UnitVector().observe(batch)
    assert np.allclose(r.reshape(*shape, 3), np.maximum(a, e)[..., None] ** 2, rtol=1e-14, atol=0)
    for own in (AzEl(sigma_deg=4.0), UnitVector(kappa=1 / np.deg2rad(4.0) ** 2)):
        assert np.allclose(own.observe(batch)[1], np.deg2rad(4.0) ** 2, rtol=1e-14, atol=0)


def test_directions_use_the_anchors_rotation(rng):
    """Erratum N8: (5) and (9) omit R_j; without it the expected direction is another one."""
    position, R = np.array([[[1.0, 2.0, 3.0]]]), facing([[1.0, 0.0, 0.0]])[None]
    x = np.array([[4.0, 2.0, 3.0]])
    assert np.allclose(UnitVector().predict(x, Anchors(position, R)), [[0, 0, 1]], atol=1e-15)
    assert np.allclose(
        UnitVector().predict(x, Anchors(position, np.eye(3)[None, None])), [[1, 0, 0]], atol=1e-15
    )


def test_vmf_loglik_equals_scipy(rng):
    anchors = make_anchors(rng, 2)
    batch = make_batch(rng, anchors)
    h = UnitVector(kappa=12.0)
    y, r = h.observe(batch)
    x = rng.uniform(-4, 4, (6, 3))
    mean = h.predict(x, anchors).reshape(6, 2, 3)
    u = to_unit(batch.azimuth, batch.elevation)[:, 0]
    expected = [
        sum(stats.vonmises_fisher(mean[i, j], 12.0).logpdf(u[i, j]) for j in range(2))
        for i in range(6)
    ]
    assert np.allclose(h.loglik(x, anchors, y[:, 0], r[:, 0]), expected, rtol=1e-10, atol=0)


def test_azel_loglik_equals_scipy_on_wrapped_residuals(rng):
    anchors = make_anchors(rng, 2)
    batch = make_batch(rng, anchors)
    h = AzEl(sigma_deg=15.0)
    y, r = h.observe(batch)
    x = rng.uniform(-4, 4, (6, 3))
    d = y[:, 0] - h.predict(x, anchors)
    d[:, 0::2] = wrap(d[:, 0::2])
    expected = stats.norm(scale=np.deg2rad(15)).logpdf(d).sum(axis=1)
    assert np.allclose(h.loglik(x, anchors, y[:, 0], r[:, 0]), expected, rtol=1e-12, atol=0)


@pytest.mark.parametrize(
    "h", [AzEl(sigma_deg=9.0), UnitVector(kappa=30.0)], ids=lambda h: type(h).__name__
)
def test_a_missing_measurement_is_left_out_of_the_likelihood(h, rng):
    anchors = make_anchors(rng, 3)
    batch = make_batch(rng, anchors)
    batch.azimuth[:, :, 1] = np.nan
    batch.elevation[:, :, 1] = np.nan
    fewer = anchors.those(np.array([0, 2]))
    less = Batch(batch.azimuth[..., [0, 2]], batch.elevation[..., [0, 2]], fewer)
    x = rng.uniform(-4, 4, (6, 3))
    (y, r), (y2, r2) = h.observe(batch), h.observe(less)
    all_of_them, few = (
        h.loglik(x, anchors, y[:, 0], r[:, 0]),
        h.loglik(x, fewer, y2[:, 0], r2[:, 0]),
    )
    assert np.allclose(all_of_them, few, rtol=1e-12, atol=0)


@pytest.mark.parametrize("kappa", [1e-6, 1.0, 1e8])
def test_vmf_loglik_neither_overflows_nor_loses_differences(kappa, rng):
    anchors = make_anchors(rng, 4)
    h = UnitVector(kappa=kappa)
    y, r = h.observe(make_batch(rng, anchors))
    with np.errstate(all="raise", under="ignore"):
        assert np.all(
            np.isfinite(h.loglik(rng.uniform(-4, 4, (6, 50, 3)), anchors, y[:, 0], r[:, 0]))
        )


def test_azimuth_residual_wraps_and_elevation_does_not():
    h = AzEl()
    d = h.residual(np.array([[3.1, 1.0]]), np.array([[-3.1, -1.0]]))
    assert np.allclose(d, [[6.2 - 2 * np.pi, 2.0]])


def test_jacobian_is_finite_on_the_pole_axis():
    anchors = Anchors(np.zeros((1, 1, 3)), np.eye(3)[None, None])
    for x in ([[0.0, 0.0, 2.0]], [[0.0, 0.0, 0.0]], [[1e-200, 0.0, 1.0]]):
        for h in (AzEl(), UnitVector()):
            assert np.all(np.isfinite(h.jacobian(np.array(x), anchors)))
            assert np.all(np.isfinite(h.predict(np.array(x), anchors)))


def test_adaptive_deviations_follow_the_table_of_model_1():
    h = AzElAdaptive(noise=VonMisesFisher(10.0))
    azimuth, up = adaptive_table(np.deg2rad(10))
    e = np.deg2rad([[0, -90.0, 0, -33.4, 0, 0.0, 0, 89.6]])
    v = h.covariance_of(e, np.ones((1, 8)))
    assert np.allclose(v[0, 0::2], azimuth[[0, 57, 90, 180]] ** 2)
    assert np.allclose(v[0, 1::2], up[[0, 57, 90, 180]] ** 2)


def test_fitted_deviations_printed_and_own():
    for noise, printed in (
        (FlippedAngles(10.0), 18),
        (VonMisesFisher(10.0), 21),
        (VonMisesFisher(kappa=1 / np.deg2rad(10) ** 2), 21),
    ):
        assert np.allclose(np.rad2deg(AzElFitted(noise=noise).sigmas()), [printed, 10])
        assert np.allclose(AzElFitted(noise=noise, fit="own").sigmas(), noise.fitted())
    elsewhere = FlippedAngles(5.0)
    assert np.allclose(AzElFitted(noise=elsewhere).sigmas(), elsewhere.fitted()), (
        "nothing printed at 5 deg"
    )


@pytest.mark.parametrize("model", [AzEl, UnitVector])
def test_measurements_without_stated_deviations_have_those_of_the_model(model, rng):
    """As if the measurements stated them; a deviation of the azimuth alone leaves the other one."""
    bare = Batch(np.zeros((1, 2, 4)), np.zeros((1, 2, 4)), make_anchors(rng))
    given = replace(bare, azimuth_sigma=np.full((1, 2, 4), np.deg2rad(5.0)))
    both = replace(given, elevation_sigma=np.full((1, 2, 4), np.deg2rad(9.0)))
    own = model(unstated_deg=(5.0, 9.0)).observe(bare)
    for found, expected in zip(own, model().observe(both)):
        assert np.allclose(found, expected, rtol=1e-14, atol=0)
    half = AzEl(unstated_deg=(1.0, 9.0)).observe(given)[1]
    assert np.allclose(half, AzEl().observe(both)[1], rtol=1e-14, atol=0)
    usual = AzEl().observe(bare)[1][0, 0, :2]
    assert np.allclose(np.rad2deg(np.sqrt(usual)), [6, 12], rtol=1e-14, atol=0)
    for wrong in ((0.0, 9.0), (5.0,), (5.0, 181.0)):
        with pytest.raises(BadValue, match="unstated_deg"):
            model(unstated_deg=wrong)


@pytest.mark.parametrize("h", [AzEl(), UnitVector()], ids=lambda h: type(h).__name__)
def test_a_stated_deviation_that_is_missing_makes_the_measurement_missing(h, rng):
    anchors = make_anchors(rng, 2)
    batch = make_batch(rng, anchors)
    batch.azimuth_sigma[:, :, 0] = np.nan
    y, r = h.observe(batch)
    d = y.shape[-1] // 2
    assert np.isnan(y[..., 0]).all()
    assert np.isfinite(y[..., d:]).all()
    assert np.isfinite(r).all()
