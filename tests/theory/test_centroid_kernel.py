"""The weighted centroid's kernel equals NumPy, fix by fix."""

from dataclasses import replace

import numpy as np
import pytest

from aoabench.estimators.centroid import WeightedCentroid
from aoabench.filters.heard import heard_alone
from aoabench.maths.geometry import LIGHT, to_azel
from aoabench.types import Anchors, Batch, Outcome, Reason

R, T, B = 3, 70, 5  # two full tiles of steps and one that is not


def rotations(rng, shape):
    """Rotations (*shape, 3, 3), uniform."""
    return np.linalg.qr(rng.normal(size=(*shape, 3, 3)))[0]


def batch_of(rng, of_replication, of_step, sure=False):
    """Measurements of points among anchors that differ by replication and by step, or not."""
    shape = (R if of_replication else 1, T if of_step else 1, B)
    position, rotation = rng.uniform(-10, 10, (*shape, 3)), rotations(rng, shape)
    sigma = None if sure else rng.uniform(0.1, 1.0, (*shape, 3))
    points = rng.uniform(-5, 5, (R, T, 1, 3))
    local = (rotation @ (points - position)[..., None])[..., 0]
    azimuth, elevation = to_azel(*np.moveaxis(local, -1, 0))
    noise = rng.normal(size=(3, R, T, B))
    azimuth[2, :30, 1] += np.pi  # a ray that points away
    distance = np.linalg.norm(local, axis=-1)
    sigmas = rng.uniform(0.5, 2.0, (3, R, T, B)) * np.array([0.05, 0.05, 1e-8])[:, None, None, None]
    return Batch(
        azimuth + 0.05 * noise[0],
        elevation + 0.05 * noise[1],
        Anchors(position, rotation, sigma),
        delay=(distance + noise[2]) / LIGHT,
        azimuth_sigma=sigmas[0],
        elevation_sigma=sigmas[1],
        delay_sigma=sigmas[2],
    )


def with_gaps(batch, rng):
    """Values and deviations that are missing or unusable; steps 5 and 40 measure nothing."""
    arrays = {
        name: getattr(batch, name).copy()
        for name in ("azimuth", "elevation", "delay", "azimuth_sigma", "elevation_sigma", "delay_sigma")
    }  # fmt: skip
    for name, array in arrays.items():
        bad = [0.0, np.inf, -1.0, np.nan] if "sigma" in name else [np.nan, np.inf]
        where = rng.random(array.shape) < 0.1
        array[where] = rng.choice(bad, where.sum())
    arrays["azimuth"][:, [5, 40]] = np.nan
    arrays["delay_sigma"][1, 6] = np.nan  # all have azimuths, none a time
    return replace(batch, **arrays)


def same(fast, slow):
    """Assert that all is equal, positions and covariances up to the rounding of sines."""
    for name in ("outcome", "reason", "anchors_used"):
        assert np.array_equal(getattr(fast, name), getattr(slow, name)), name
    assert np.allclose(fast.position, slow.position, rtol=0, atol=1e-12, equal_nan=True)
    if slow.covariance is None:
        assert fast.covariance is None
    else:
        scale = np.nanmax(np.abs(slow.covariance), axis=(-1, -2), keepdims=True, initial=1e-30)
        apart = np.abs(fast.covariance - slow.covariance) / scale
        assert np.nanmax(apart) < 1e-13
        assert np.array_equal(np.isnan(fast.covariance), np.isnan(slow.covariance))


def both(batch, **options):
    return [WeightedCentroid(engine=e, **options)(batch, None, None) for e in ("auto", "numpy")]


@pytest.mark.parametrize("as_printed", [False, True])
@pytest.mark.parametrize("of_step", [False, True])
@pytest.mark.parametrize("of_replication", [False, True])
def test_the_kernel_equals_numpy(of_replication, of_step, as_printed, rng):
    batch = with_gaps(batch_of(rng, of_replication, of_step), rng)
    fast, slow = both(batch, as_printed=as_printed)
    same(fast, slow)
    assert set(np.unique(fast.reason)) == {Reason.NONE, Reason.NO_MEASUREMENT, Reason.BEHIND}
    assert (fast.outcome[:, 5] == Outcome.FAILED).all()
    for i in range(R):
        alone = WeightedCentroid(as_printed=as_printed)(batch.of(i), None, None)
        assert np.array_equal(alone.position[0], fast.position[i], equal_nan=True)
        assert np.array_equal(alone.covariance[0], fast.covariance[i], equal_nan=True)


def test_of_what_is_not_stated(rng):
    """Exact anchors; no deviations of angles, and so no covariance; anchors at unknown places."""
    batch = with_gaps(batch_of(rng, True, False, sure=True), rng)
    same(*both(batch))
    for names in (["azimuth_sigma"], ["elevation_sigma"], ["azimuth_sigma", "elevation_sigma"]):
        same(*both(replace(batch, **dict.fromkeys(names))))
    position = batch.anchors.position.copy()
    position[0, 0, 2] = np.nan
    lost = replace(batch, anchors=replace(batch.anchors, position=position))
    fast, slow = both(lost)
    same(fast, slow)
    assert (fast.reason[0] == Reason.UNDETERMINED).any()
    assert (fast.outcome[1] != Outcome.FAILED).any()


def test_batches_of_heard_anchors_give_the_bits_of_those_of_all(rng):
    batch = with_gaps(batch_of(rng, True, False), rng)
    heard = np.stack([np.isin(np.arange(B), rng.choice(B, 1 + k % 3, False)) for k in range(T)])
    arrays = {
        n: np.where(heard, getattr(batch, n), np.nan) for n in ("azimuth", "elevation", "delay")
    }
    whole = replace(batch, **arrays)
    few = heard_alone(whole)
    assert few.azimuth.shape[2] == 3
    for engine in ("auto", "numpy"):
        a, b = (WeightedCentroid(engine=engine)(given, None, None) for given in (few, whole))
        assert np.array_equal(a.position, b.position, equal_nan=True)
        assert np.array_equal(a.covariance, b.covariance, equal_nan=True)
        assert np.array_equal(a.anchors_used, b.anchors_used)
        assert np.array_equal(a.reason, b.reason)
