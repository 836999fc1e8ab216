"""The prior of a recorded track: exact positions, laws of geometry and of order, honest spread."""

from dataclasses import replace

import numpy as np
import pytest

from aoabench.engine.start import HEIGHT_SIGMA_M, LEAST_EXTENT_M, first_point, prior_of
from aoabench.maths.geometry import to_unit
from aoabench.models.azel import AzEl
from aoabench.models.motion import ConstantVelocity, RandomWalk
from aoabench.types import Anchors, Batch

CORNERS = np.array([[0.0, 0, 2.5], [10, 0, 2.5], [10, 8, 2.5], [0, 8, 2.5]])


def upright(yaw):
    c, s = np.cos(yaw), np.sin(yaw)
    rotation = np.zeros((len(yaw), 3, 3))
    rotation[:, 0, 0] = rotation[:, 1, 1] = c
    rotation[:, 0, 1], rotation[:, 1, 0], rotation[:, 2, 2] = s, -s, 1.0
    return rotation


ROOM = Anchors(CORNERS, upright(np.array([0.8, 2.4, -2.4, -0.8])))


def seen(x, anchors=ROOM, sigma=None, rng=None):
    """A batch of the angles (1, T, B) at positions x (T, 3)."""
    angles = AzEl(1.0).predict(x[None], anchors).reshape(1, len(x), -1, 2)
    if rng is not None:
        angles = angles + np.asarray(sigma) * rng.normal(size=angles.shape)
    each = np.ones_like(angles[..., 0])
    stated = (
        {}
        if sigma is None
        else {"azimuth_sigma": sigma[0] * each, "elevation_sigma": sigma[1] * each}
    )
    return Batch(angles[..., 0], angles[..., 1], anchors, **stated)


@pytest.mark.parametrize("elevations", [True, False])
@pytest.mark.parametrize("height", [None, 1.2])
def test_exact_angles_give_the_position(elevations, height, rng):
    x = np.column_stack([rng.uniform(1, 9, 20), rng.uniform(1, 7, 20), np.full(20, 1.2)])
    for place in x:
        batch = seen(place[None], sigma=(1e-4, 1e-4))
        if not elevations:
            batch = replace(batch, elevation=np.full_like(batch.elevation, np.nan))
        found = first_point(batch, height)
        assert np.allclose(found.mean[:2], place[:2], rtol=0, atol=1e-4)
        assert found.mean[2] == pytest.approx(1.2, abs=1e-3) or (height is None and not elevations)
        assert np.sqrt(found.covariance[0, 0]) < 0.01
        if height is None and not elevations:
            assert np.sqrt(found.covariance[2, 2]) > 3


def test_anchors_one_after_the_other_are_anchors_at_once():
    """Packets at times of their own: four steps of one anchor each, from a tag that stands still."""
    place = np.array([3.0, 5.0, 1.0])
    at_once, alone = seen(place[None]), seen(np.tile(place, (4, 1)))
    apart = {n: np.where(np.eye(4, dtype=bool), getattr(alone, n)[0], np.nan)[None]
             for n in ("azimuth", "elevation")}  # fmt: skip
    first, both = first_point(replace(alone, **apart), None), {n: apart[n].copy() for n in apart}
    assert np.allclose(first.mean[:2], place[:2], rtol=0, atol=0.3)
    for n in both:  # two anchors determine a position: the others do not count
        both[n] = np.where(np.arange(4) < 2, getattr(at_once, n), np.nan)
    expected = first_point(replace(at_once, **both), None)
    assert np.allclose(first.mean, expected.mean, rtol=1e-12, atol=1e-12)
    assert np.allclose(first.covariance, expected.covariance, rtol=1e-12, atol=1e-12)


def test_moved_turned_and_permuted(rng):
    batch = seen(np.array([[3.0, 5.0, 1.0]]), sigma=(0.1, 0.2), rng=rng)
    found = first_point(batch, None)
    turn, shift = upright(np.array([0.7]))[0], np.array([100.0, -40.0, 7.0])
    moved = Anchors(CORNERS @ turn.T + shift, ROOM.rotation[0, 0] @ turn.T)
    other = first_point(replace(batch, anchors=moved), None)
    assert np.allclose(other.mean, turn @ found.mean + shift, rtol=1e-10, atol=1e-10)
    assert np.allclose(other.covariance, turn @ found.covariance @ turn.T, rtol=1e-9, atol=1e-10)
    order = np.array([2, 0, 3, 1])
    mixed = {n: getattr(batch, n)[..., order]
             for n in ("azimuth", "elevation", "azimuth_sigma", "elevation_sigma")}  # fmt: skip
    same = first_point(replace(batch, anchors=ROOM.those(order), **mixed), None)
    assert np.allclose(same.mean, found.mean, rtol=1e-12, atol=1e-12)


def test_one_anchor_leaves_the_distance_open():
    """Its ray and half an extent on it; across the ray as uncertain as the angle, along it widely."""
    one, place = ROOM.those(np.array([0])), np.array([[4.0, 3.0, 1.0]])
    batch = seen(place, one, sigma=(0.1, 0.1))
    found = first_point(batch, None)
    ray = (one.rotation[0, 0, 0].T @ to_unit(batch.azimuth[0, 0, 0], batch.elevation[0, 0, 0]))[:3]
    across = np.array([-ray[1], ray[0], 0]) / np.hypot(*ray[:2])
    off = found.mean - one.position[0, 0, 0]
    assert off @ ray == pytest.approx(0.5 * LEAST_EXTENT_M, rel=1e-6)
    assert np.allclose(off - (off @ ray) * ray, 0, atol=1e-6)
    assert ray @ found.covariance @ ray == pytest.approx(LEAST_EXTENT_M**2, rel=1e-6)
    assert np.sqrt(across @ found.covariance @ across) < 0.3
    known = first_point(seen(place, one, sigma=(0.01, 0.01)), 1.0)  # height and elevation: distance
    assert np.allclose(known.mean, place[0], rtol=0, atol=0.1)
    assert np.sqrt(np.trace(known.covariance)) < 0.4


def test_no_measurement_is_anywhere_among_the_anchors():
    nothing = np.full((1, 3, 4), np.nan)
    mean, P = prior_of(Batch(nothing, nothing, ROOM), ConstantVelocity(), 1.0, 1.5)
    extent2 = 10.0**2 + 8.0**2
    assert np.allclose(mean, [5, 4, 1.5, 0, 0, 0], rtol=1e-12, atol=1e-12)
    variances = [1 + extent2] * 2 + [HEIGHT_SIGMA_M**2, 1, 1, 0.01]
    assert np.allclose(np.diag(P), variances, rtol=1e-12, atol=0)


def test_rays_that_meet_behind_the_anchors_wait_for_others():
    """A mirrored first step determines nothing; the second one does."""
    place = np.tile([3.0, 5.0, 1.0], (2, 1))
    batch = seen(place)
    turned = batch.azimuth.copy()
    turned[0, 0] += np.pi
    lone = {"azimuth": turned, "elevation": batch.elevation}
    found = first_point(replace(batch, **lone), None)
    first = first_point(Batch(turned[:, :1], batch.elevation[:, :1], ROOM), None)
    assert np.array_equal(found.mean, first.mean)  # contradictions are not resolved
    turned[0, 0, 2:] = np.nan
    elevation = np.where(np.isnan(turned), np.nan, batch.elevation)
    turned[0, 0] = np.nan
    later = first_point(Batch(turned, elevation, ROOM), None)
    assert np.allclose(later.mean, place[0], rtol=0, atol=0.2)


def test_the_spread_covers_the_error(rng):
    """Mean normalised squared error of start and of prior over noisy fixes: within chi-square of 3."""
    squares, wide, sigma = [], [], (0.1, 0.15)
    for _ in range(300):
        place = np.array([*rng.uniform(2, 6, 2), 1.0])
        batch = seen(place[None], sigma=sigma, rng=rng)
        found = first_point(batch, None)
        e = found.mean - place
        squares.append(e @ np.linalg.solve(found.covariance, e))
        mean, P = prior_of(batch, RandomWalk(), 1.0)
        wide.append((mean - place) @ np.linalg.solve(P, mean - place))
    assert np.mean(squares) == pytest.approx(3.0, abs=0.6)
    assert np.mean(wide) < 1.5


def test_moving_anchors_and_deviations_without_a_number():
    """Anchors of each step; deviations that are NaN or 0 are assumed."""
    place = np.tile([3.0, 5.0, 1.0], (2, 1))
    moving = Anchors(
        np.stack([CORNERS + 1, CORNERS])[None], np.tile(ROOM.rotation, (1, 2, 1, 1, 1))
    )
    y = [AzEl(1.0).predict(place[None, k], moving.at(k)).reshape(4, 2) for k in range(2)]
    angles = np.stack(y)[None]
    batch = Batch(angles[..., 0], angles[..., 1], moving, azimuth_sigma=np.full((1, 2, 4), np.nan),
                  elevation_sigma=np.zeros((1, 2, 4)))  # fmt: skip
    found = first_point(batch, None)
    assert np.allclose(found.mean, place[0], rtol=0, atol=0.2)
    plain = first_point(Batch(angles[..., 0], angles[..., 1], moving), None)
    assert np.array_equal(plain.mean, found.mean)
