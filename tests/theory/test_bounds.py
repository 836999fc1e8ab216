"""Fisher information, Cramér-Rao bound and dilution of precision against finite differences and
closed forms.
"""

import numpy as np
import pytest

from aoabench.bounds import azel_information, crb, direction_information, gdop
from aoabench.config.compose import compose_cells
from aoabench.maths.directional import vmf_log_peak, vmf_sample
from aoabench.maths.geometry import facing
from aoabench.models.azel import AzEl
from aoabench.types import Anchors


@pytest.fixture
def anchors(rng):
    return Anchors(rng.uniform(-5, 5, (1, 4, 3)), facing(rng.normal(size=(4, 3)))[None])


def test_information_is_that_of_the_measurement_by_finite_differences(anchors, rng):
    sa, se = rng.uniform(0.01, 0.2, (2, 4))
    for point in rng.uniform(-5, 5, (10, 3)):
        h, step = AzEl(1.0), 1e-6
        rows = [
            h.residual(
                h.predict((point + e)[None], anchors), h.predict((point - e)[None], anchors)
            )[0]
            / (2 * step)
            for e in step * np.eye(3)
        ]
        G = np.array(rows).T / np.stack([sa, se], axis=-1).ravel()[:, None]
        assert np.allclose(azel_information(point, anchors, sa, se), G.T @ G, rtol=1e-6)


def test_two_anchors_at_right_angles():
    """Both at distance d in the plane of the point: sigma^2 d^2 along each sight, half of it up,
    where both measure.
    """
    d, sigma = 7.0, 0.05
    anchors = Anchors(np.array([[[-d, 0, 0], [0, -d, 0.0]]]), np.tile(np.eye(3), (1, 2, 1, 1)))
    bound = crb(azel_information(np.zeros(3), anchors, sigma, sigma))
    assert np.allclose(bound, (sigma * d) ** 2 * np.diag([1, 1, 0.5]))
    assert gdop(np.zeros(3), anchors) == pytest.approx(d * np.sqrt(2.5))
    assert gdop(np.zeros(3), anchors, axes=(0, 1)) == pytest.approx(d * np.sqrt(2))


def test_closed_form_of_one_anchor_across_and_along():
    """Azimuth moves by sigma rho across, elevation by sigma r; the distance is not observed, so
    there is no bound.
    """
    one = Anchors(np.zeros((1, 1, 3)), np.eye(3)[None, None])
    J = azel_information(np.array([3.0, 0, 4]), one, 0.1, 0.2)
    across, up, along = np.array([0, 1.0, 0]), np.array([-0.8, 0, 0.6]), np.array([0.6, 0, 0.8])
    assert across @ J @ across == pytest.approx(1 / (0.1 * 3) ** 2)
    assert up @ J @ up == pytest.approx(1 / (0.2 * 5) ** 2)
    assert along @ J @ along == pytest.approx(0, abs=1e-12)
    assert np.all(np.isnan(crb(J)))


def test_singular_geometries_are_nan_and_leave_the_others_alone(anchors):
    twice = Anchors(np.zeros((1, 2, 3)), np.tile(np.eye(3), (1, 2, 1, 1)))
    assert np.isnan(gdop(np.ones(3), twice))
    points = np.stack([anchors.position[0, 0, 0], np.array([1.0, 2, 3])])  # on an anchor, and not
    assert np.isnan(gdop(points, anchors)).tolist() == [True, False]


def test_direction_information_is_the_mean_curvature_of_von_mises_fisher(anchors, rng):
    """Second differences of the log density, averaged over 4e5 draws of each anchor; within 1 %."""
    point, kappa, step = np.array([1.0, 2.0, -1.0]), 20.0, 1e-3
    offset = point - anchors.position[0, 0]
    u = [vmf_sample(rng, np.tile(o / np.linalg.norm(o), (400_000, 1)), kappa) for o in offset]

    def loglik(x):
        d = x - anchors.position[0, 0]
        d = d / np.linalg.norm(d, axis=-1, keepdims=True)
        return sum((vmf_log_peak(kappa) + kappa * (v @ e - 1)).mean() for v, e in zip(u, d))

    E = step * np.eye(3)
    H = [
        [
            loglik(point + a + b)
            - loglik(point + a - b)
            - loglik(point - a + b)
            + loglik(point - a - b)
            for b in E
        ]
        for a in E
    ]
    assert np.allclose(
        -np.array(H) / (4 * step**2),
        direction_information(point, anchors, kappa),
        rtol=0.01,
        atol=0.02,
    )


def test_azimuth_elevation_and_directions_agree_far_from_the_poles():
    """At elevation 0 and small noise both measure the same."""
    anchors = Anchors(np.array([[[-9.0, 0, 0], [0, -9.0, 0]]]), np.tile(np.eye(3), (1, 2, 1, 1)))
    J = azel_information(np.zeros(3), anchors, 0.01, 0.01)
    assert np.allclose(direction_information(np.zeros(3), anchors, 1e4), J, rtol=2e-4, atol=1e-6)


@pytest.mark.parametrize("noise", ["ae_normal", "vmf"])
@pytest.mark.parametrize("scenario", ["bs_grid", "square_track"])
def test_every_scenario_has_its_bound(scenario, noise):
    """By the noise's own information; with sigma = 1 deg the two kinds of noise allow the same
    within a third.
    """
    names = "estimator=[ls]" if scenario == "bs_grid" else "filter=[ekf_vmf]"
    cell = compose_cells([f"scenario={scenario}", f"noise={noise}", names, "noise.sigma_deg=1"])[0]
    points = cell.scenario.truth(np.random.default_rng(0))[:, :3]
    bound = crb(cell.noise.information(points, cell.scenario.true_anchors))
    sigma = np.deg2rad(1.0)
    away = np.isfinite(bound).all((-1, -2))
    assert away.mean() > (
        0.99 if scenario == "bs_grid" else 0.4
    )  # on the square's pole lines azimuth tells everything
    vmf = crb(direction_information(points, cell.scenario.true_anchors, 1 / sigma**2))
    if scenario == "bs_grid":
        ratio = np.sqrt(np.trace(bound, axis1=-2, axis2=-1) / np.trace(vmf, axis1=-2, axis2=-1))
        assert np.all((ratio > 0.66) & (ratio < 1.5))
