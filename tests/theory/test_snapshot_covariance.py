"""Covariances of the snapshot estimators against finite differences of the estimators themselves,
and deviations from residuals against the noise.
"""

from dataclasses import fields, replace

import numpy as np
import pytest

from aoabench.estimators.centroid import WeightedCentroid
from aoabench.maths.geometry import LIGHT, euler
from aoabench.maths.linalg import inverse, solve
from aoabench.types import Anchors, Batch, Outcome
from tests.contracts.test_geometry import engines, preset
from tests.helpers import Place

HEIGHT = 1.0
SPACE = ("ls", "ls_lines", "ml_kcorr", "vmf_ml")
PLANE = ("vmf_ml", "anchor_mean", "single_anchor_1")
SIGMA = np.radians(1.5)


def anchors_and_point(rng, anchors=4):
    s = rng.uniform([0, 0, 2], [10, 8, 3], (anchors, 3))
    R = np.array([euler(turn).T for turn in rng.uniform(-0.5, 0.5, (anchors, 3))])
    return Anchors(s, R), np.array([4.2, 3.1, HEIGHT])


def exact_angles(anchors, p):
    local = np.einsum("bij,bj->bi", anchors.rotation[0, 0], p - anchors.position[0, 0])
    x, y, z = local.T
    return np.stack([np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))])


def estimate(name, engine, angles, anchors, sigma=None, height=None):
    """Estimates from angles (2, N, B) rad with stated deviations (2, B), None for none."""
    estimator = preset(name)
    names = {f.name for f in fields(estimator)}
    if engine != "auto":
        estimator = replace(estimator, engine=engine)
    if height is not None and "height_m" in names:
        estimator = replace(estimator, height_m=height)
    if "tolerance_m" in names:
        estimator = replace(estimator, tolerance_m=1e-9)
    stated = (None, None)
    if sigma is not None:
        stated = tuple(np.broadcast_to(s, angles[0].shape)[None] for s in sigma)
    batch = Batch(angles[0][None], angles[1][None], anchors, None, None, *stated)
    return estimator(batch, Place(anchors, height), None)


def by_differences(name, engine, angles, anchors, sigma, height=None, h=1e-6):
    """J diag(sigma^2) J^T with the derivatives J of the position by the angles."""
    B, axes = angles.shape[1], 3 if height is None else 2
    shifts = np.concatenate([np.eye(2 * B), -np.eye(2 * B)]).reshape(-1, 2, B)
    shifted = np.moveaxis(angles + h * shifts, 1, 0)
    p = estimate(name, engine, shifted, anchors, sigma, height).position[0, :, :axes]
    J = ((p[: 2 * B] - p[2 * B :]) / (2 * h)).T
    return J @ np.diag(np.ravel(sigma) ** 2) @ J.T


CASES = [
    pytest.param(name, engine, height, id=f"{name}-{engine}{'-plane' if height else ''}")
    for names, height in ((SPACE, None), (PLANE, HEIGHT))
    for name in names
    for engine in engines(preset(name))
]


@pytest.mark.parametrize(("name", "engine", "height"), CASES)
def test_covariance_is_that_of_the_estimator_by_finite_differences(name, engine, height, rng):
    """Isotropic deviations: sigma in elevation, sigma / cos elevation in azimuth."""
    for _ in range(3):
        anchors, p = anchors_and_point(rng)
        angles = exact_angles(anchors, p)
        each = SIGMA * rng.uniform(0.5, 2.0, angles.shape[1])
        sigma = np.stack([each / np.cos(angles[1]), each])
        found = estimate(name, engine, angles[:, None], anchors, sigma, height)
        axes = 3 if height is None else 2
        ours = found.covariance[0, 0, :axes, :axes]
        right = by_differences(name, engine, angles, anchors, sigma, height)
        assert np.allclose(ours, right, rtol=1e-4, atol=1e-6 * np.trace(right))


@pytest.mark.parametrize("engine", ["auto", "numpy"])
@pytest.mark.parametrize("name", ["ls", "ml_kcorr"])
def test_unequal_deviations_of_azimuth_and_elevation(name, engine, rng):
    anchors, p = anchors_and_point(rng)
    angles = exact_angles(anchors, p)
    sigma = SIGMA * rng.uniform(0.2, 3.0, angles.shape)
    ours = estimate(name, engine, angles[:, None], anchors, sigma).covariance[0, 0]
    right = by_differences(name, engine, angles, anchors, sigma)
    assert np.allclose(ours, right, rtol=1e-4, atol=1e-6 * np.trace(right))


@pytest.mark.parametrize("engine", ["auto", "numpy"])
@pytest.mark.parametrize("name", SPACE)
def test_unstated_deviations_come_from_the_residuals(name, engine, rng):
    """Mean covariance of 20 000 fixes of 5 anchors against that of their positions: the relative
    standard error of the latter's trace is at most sqrt(2 / 20000) = 0.01, and that of the mean of
    sigma-hat^2 with 7 degrees of freedom 0.004. The bound is 4.4 of both (false alarm 1e-5), and
    2 % for what is not linear at 0.3 deg.
    """
    if engine not in engines(preset(name)):
        pytest.skip("has one engine")
    sigma, N = np.radians(0.3), 20_000
    anchors, p = anchors_and_point(rng, 5)
    exact = exact_angles(anchors, p)
    angular = name in ("ls", "ml_kcorr")  # one deviation of both angles; else of the directions
    each = np.stack([np.full(5, sigma) if angular else sigma / np.cos(exact[1]), np.full(5, sigma)])
    angles = exact[:, None] + each[:, None] * rng.normal(size=(2, N, 5))
    found = estimate(name, engine, angles, anchors)
    ours = np.trace(found.covariance[0].mean(axis=0))
    assert abs(ours / np.trace(np.cov(found.position[0].T)) - 1) < 4.4 * (0.01 + 0.004) + 0.02


@pytest.mark.parametrize("name", SPACE)
def test_errors_agree_with_stated_covariances(name, rng):
    """NEES of 4000 fixes with stated deviations of 0.3 deg: the mean is 3 with a standard error of
    sqrt(6 / 4000) = 0.039; the bound is 4.4 of them (false alarm 1e-5) and 0.03 for curvature.
    """
    sigma = np.radians(0.3)
    anchors, p = anchors_and_point(rng, 5)
    exact = exact_angles(anchors, p)
    each = np.stack([sigma / np.cos(exact[1]), np.full(5, sigma)])
    angles = exact[:, None] + each[:, None] * rng.normal(size=(2, 4000, 5))
    found = estimate(name, "auto", angles, anchors, each)
    e = found.position[0] - p
    nees = np.einsum("ni,nij,nj->n", e, np.linalg.inv(found.covariance[0]), e)
    assert (found.outcome == Outcome.OK).all()
    assert abs(nees.mean() - 3) < 4.4 * 0.039 + 0.03


def test_covariance_of_the_weighted_centroid_by_finite_differences(rng):
    anchors, p = anchors_and_point(rng)
    angles = exact_angles(anchors, p)
    delay = np.linalg.norm(p - anchors.position[0, 0], axis=-1) / LIGHT
    sigma = np.stack([*(SIGMA * rng.uniform(0.5, 2, (2, 4))), 1e-9 * rng.uniform(0.5, 2, 4)])
    moved = rng.uniform(0.05, 0.2, (4, 3))
    stated = replace(anchors, position_sigma=moved)

    def position(values, at=stated):
        a, e, t = (v[None, None] for v in values)
        given = (s[None, None] for s in sigma)
        batch = Batch(a, e, at, t, None, *given)
        found = WeightedCentroid()(batch, Place(at), None)
        return found.position[0, 0], found.covariance[0, 0]

    values = np.stack([*angles, delay])
    h = np.array([1e-6, 1e-6, 1e-15])
    J = np.zeros((3, 3, 4))
    for i in range(3):
        for j in range(4):
            step = np.zeros((3, 4))
            step[i, j] = h[i]
            J[:, i, j] = (position(values + step)[0] - position(values - step)[0]) / (2 * h[i])
    right = (J.reshape(3, -1) * sigma.ravel() ** 2) @ J.reshape(3, -1).T
    for j in range(4):
        for i in range(3):
            offset = np.zeros((4, 3))
            offset[j, i] = 1e-6
            there, back = (replace(stated, position=anchors.position + s * offset) for s in (1, -1))
            K = (position(values, there)[0] - position(values, back)[0]) / 2e-6
            right += moved[j, i] ** 2 * np.outer(K, K)
    assert np.allclose(position(values)[1], right, rtol=1e-4, atol=1e-6 * np.trace(right))


def test_solve_and_inverse_equal_numpys_and_refuse_what_is_singular(rng):
    J = rng.normal(size=(500, 4, 3)) * 10.0 ** rng.uniform(-2, 2, (500, 1, 3))
    A = np.swapaxes(J, -1, -2) @ J
    g = rng.normal(size=(500, 3))
    x = np.linalg.solve(A, g[..., None])[..., 0]
    assert np.allclose(solve(A, g), x, rtol=1e-6, atol=1e-9 * np.abs(x).max())
    assert np.allclose(inverse(A) @ A, np.eye(3), atol=1e-5)
    u = rng.normal(size=(500, 3))
    u[:250] = [1, 0, 0] + 1e-2 * u[:250]
    u /= np.linalg.norm(u, axis=-1, keepdims=True)
    rank2 = np.eye(3) - u[:, :, None] * u[:, None, :]
    assert np.isnan(solve(rank2, g)).all()
    assert np.isnan(inverse(rank2)[:, 2, 2]).all()
