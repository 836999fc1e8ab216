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


def upright(*positions):
    B = len(positions)
    return Anchors(np.array([positions], dtype=float), np.tile(np.eye(3), (1, B, 1, 1)))


def around(point, distance, count=721, axis=(0, 0, 1.0)):
    """Points on a circle around `point` across an axis."""
    turn = np.linspace(0, 2 * np.pi, count)
    plane = np.linalg.svd(np.array([axis]))[2][1:]
    return point + distance * (np.cos(turn)[:, None] * plane[0] + np.sin(turn)[:, None] * plane[1])


@pytest.mark.parametrize("height", [3.0, -2.0])
@pytest.mark.parametrize("distance", [0, 1e-12, 1e-8, 1e-6, 1e-4])
def test_gdop_beneath_a_single_anchor_is_its_height(height, distance):
    """At rho from the foot the closed form is rho^2 across and (rho^2 + z^2)^2 / z^2 along; beside
    the pole it is known up to rounding times the condition number (z / rho)^2.
    """
    one = upright([5, 5, height])
    found = gdop(around(np.array([5.0, 5, 0]), distance, 9), one, known_z=True)
    rounding = 4 * np.finfo(float).eps * (height / distance) ** 2 if distance == 1e-4 else 1e-11
    closed = np.sqrt(distance**2 + (distance**2 + height**2) ** 2 / height**2)
    assert np.allclose(found, closed, rtol=rounding, atol=0)
    assert np.isnan(gdop(np.array([5.0, 5, 0]), one)), "the distance is not observed"


@pytest.mark.parametrize("others", [[[9, 6, 3]], [[9, 6, 3], [1, 8, 2]], [[5, 5, -4], [9, 6, 3]]])
@pytest.mark.parametrize("known_z", [True, False])
def test_gdop_at_a_pole_is_the_largest_limit_from_all_sides(others, known_z):
    """The values at 1e-2, 5e-3, 2.5e-3 m, extrapolated (even and odd orders), in every direction."""
    foot, anchors = np.array([5.0, 5, 0]), upright([5, 5, 3], *others)
    d = [gdop(around(foot, 1e-2 / 2**k), anchors, known_z=known_z) for k in range(3)]
    limit = (d[0] - 6 * d[1] + 8 * d[2]) / 3
    found = gdop(foot, anchors, known_z=known_z)
    assert found == pytest.approx(limit.max(), rel=1e-5)
    assert limit.max() > 1.001 * limit.min(), "the limit depends on the direction"
    near = gdop(around(foot, 1e-6, 9), anchors, known_z=known_z)
    assert np.allclose(near, found, rtol=1e-5)


def test_gdop_at_a_pole_of_a_known_height_in_closed_form():
    """1 / (1 / r^2 + the smallest eigenvalue of the others' information in the plane)."""
    foot, others = np.array([5.0, 5, 0]), ([9, 6, 3], [1, 8, 2])
    J = azel_information(foot, upright(*others), 1.0, 1.0)[:2, :2]
    closed = 1 / np.sqrt(1 / 9 + np.linalg.eigvalsh(J)[0])
    found = gdop(foot, upright([5, 5, 3], *others), known_z=True)
    assert found == pytest.approx(closed, rel=1e-10)


def test_gdop_on_the_axis_of_a_tilted_anchor():
    """A horizontal axis at the target's height: azimuth tells nothing in the plane, beside the axis
    as on it; in space both tell.
    """
    axis = np.array([0.6, 0.8, 0])
    position = np.array([[[0, 0, 1], [8.0, 1, 3], [1, 7.0, 3]]])
    frames = np.concatenate([facing(axis[None]), np.tile(np.eye(3), (2, 1, 1))])
    anchors, point = Anchors(position, frames[None]), np.array([3.0, 4, 1])
    beside = gdop(point + 1e-3 * np.array([[-0.8, 0.6, 0], [0.8, -0.6, 0]]), anchors, known_z=True)
    assert gdop(point, anchors, known_z=True) == pytest.approx(beside.mean(), rel=1e-6)
    d = [gdop(around(point, 1e-2 / 2**k, axis=axis), anchors) for k in range(3)]
    limit = (d[0] - 6 * d[1] + 8 * d[2]) / 3
    assert gdop(point, anchors) == pytest.approx(limit.max(), rel=1e-5)


def test_information_at_a_pole_has_its_finite_entries():
    """Those of the height, by the values beside it; across the axis it is infinite."""
    foot, anchors = np.array([5.0, 5, 0]), upright([5, 5, 3], [9, 6, 3])
    J = azel_information(foot, anchors, 0.1, 0.2)
    near = azel_information(around(foot, 1e-7), anchors, 0.1, 0.2)
    assert np.allclose(near[:, 2], J[2], atol=1e-5)
    assert np.array_equal(J[:, 2], J[2])
    assert np.array_equal(np.isinf(J), np.diag([True, True, False]))
    assert np.isnan(J[0, 1])
    assert np.isnan(J[1, 0])


def test_a_map_of_a_room_has_no_hole_beneath_its_anchors():
    anchors = upright([2, 2, 3], [8, 2, 3], [8, 8, 3], [2, 8, 3])
    x, y = np.meshgrid(np.arange(0.0, 10.5, 0.5), np.arange(0.0, 10.5, 0.5))
    value = gdop(np.stack([x, y, 0 * x], axis=-1), anchors, known_z=True)
    assert value.shape == x.shape
    assert np.isfinite(value).all()
    beneath = value[(x % 6 == 2) & (y % 6 == 2)]
    assert len(beneath) == 4
    assert np.allclose(beneath, beneath[0], rtol=1e-9, atol=0), "by symmetry"


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
