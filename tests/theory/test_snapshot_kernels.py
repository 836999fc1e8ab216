"""Kernels of the snapshot estimators: iterations that repeat themselves, and the anchors heard."""

import math
from dataclasses import replace

import numpy as np
import pytest

from aoabench.estimators.least_squares import by_kernel
from aoabench.maths.geometry import to_azel
from aoabench.maths.places import at_places, numbers_of
from aoabench.types import Anchors, Batch, Outcome, Reason
from tests.contracts.test_geometry import engines, preset
from tests.helpers import Place

UPDATES = 300
HEARD_ONLY = ("ls", "ml_arctan", "ml_atan2", "ml_kcorr")


@pytest.fixture
def interpreted(monkeypatch):
    """The module of the kernel as plain Python, without numba."""
    from aoabench.kernels import angles, planes, small, snapshot

    for module in (angles, small, planes, snapshot):
        for name, value in vars(module).copy().items():
            if hasattr(value, "py_func"):
                monkeypatch.setattr(module, name, value.py_func)
    return snapshot


def wandering(fixes=40):
    """Fixes of anchors about the origin with 10 deg noise, near one anchor's pole, where iterations
    wander.
    """
    rng = np.random.default_rng(0)
    s = np.array([[-5.0, -4, 1], [5, -4, 1], [-5, 4, 1], [5, 4, 1], [0, 0, -4]])
    p = s[0] + rng.uniform(-1, 1, (fixes, 3)) - [0, 0, 2]
    turn = np.broadcast_to(np.eye(3), (5, 3, 3))
    azimuth, elevation = to_azel(*np.moveaxis(p[:, None] - s, -1, 0))
    noise = np.radians(10.0) * rng.standard_normal((2, fixes, 5))
    return Batch((azimuth + noise[0])[None], (elevation + noise[1])[None], Anchors(s, turn))


def test_an_iteration_that_repeats_itself_ends_as_the_whole_loop_does(interpreted):
    """Position, outcome and number of updates equal those of a loop without the comparison, whose
    updates are more.
    """
    batch = wandering()
    first, anchors = by_kernel(interpreted, batch, "invariant").position[0], batch.anchors
    s, R = anchors.position[0, 0].T, np.moveaxis(anchors.rotation[0, 0], 0, -1)
    one = np.ones(s.shape[1])
    calls, update = [], interpreted.update
    interpreted.update = lambda *given: calls.append(1) or update(*given)
    updates, outcomes = 0, set()
    for variant in ((0, 0), (1, 0), (2, 0)):
        found = by_kernel(interpreted, batch, "invariant", variant, 0.01, UPDATES)
        updates += found.iterations.sum()
        for n, given in enumerate(zip(batch.azimuth[0], batch.elevation[0])):
            x, outcome, count = plain(update, variant, first[n], *given, one, one, s, R)
            behind = found.reason[0, n] == Reason.BEHIND
            assert found.outcome[0, n] == (Outcome.DIVERGED if behind else outcome)
            assert found.iterations[0, n] == count
            assert np.array_equal(found.position[0, n], x if outcome == Outcome.OK else first[n])
            outcomes.add(outcome)
    assert outcomes == {Outcome.OK, Outcome.OSCILLATED, Outcome.DIVERGED}
    assert len(calls) < updates - 200


def plain(update, variant, x, *given):
    """All updates of one fix from the start x, without looking for a period."""
    for u in range(UPDATES):
        *step, sound, _, _ = update(*variant, *x, *given)
        x = tuple(a + d for a, d in zip(x, step))
        if not (sound and math.dist(x, (0, 0, 0)) <= 1e6 * 10):
            return x, Outcome.DIVERGED, u + 1
        if sum(d * d for d in step) < 0.01 * 0.01:
            return x, Outcome.OK, u + 1
    return x, Outcome.OSCILLATED, UPDATES


@pytest.fixture(scope="module")
def hall():
    """200 fixes of 30 anchors, of which each hears those within 9 m, with 2 deg noise: the batch of
    all anchors and that of the anchors heard.
    """
    rng = np.random.default_rng(8)
    s = rng.uniform([0, 0, 2], [60, 20, 5], (30, 3))
    p = rng.uniform([0, 0, 0], [60, 20, 2], (200, 3))
    turns = np.broadcast_to(np.eye(3), (30, 3, 3))
    azimuth, elevation = to_azel(*np.moveaxis(p[:, None] - s, -1, 0))
    heard = np.linalg.norm(p[:, None] - s, axis=-1) < 9.0
    noise = np.radians(2.0) * rng.standard_normal((2, 3, 200, 30))
    angles = [np.where(heard, a + n, np.nan) for a, n in zip((azimuth, elevation), noise)]
    sigma = rng.uniform(0.02, 0.05, (3, 200, 30))
    whole = Batch(*angles, Anchors(s, turns), azimuth_sigma=sigma, elevation_sigma=0.5 * sigma)
    return whole, of_heard(whole, numbers_of(heard)[None])


def of_heard(whole, numbers):
    """The batch of the anchors heard, at numbers (1, T, K)."""
    fields = ("azimuth", "elevation", "azimuth_sigma", "elevation_sigma")
    values = {
        f: at_places(getattr(whole, f)[..., None], np.repeat(numbers, 3, 0), np.nan)[..., 0]
        for f in fields
    }
    known = whole.anchors
    anchors = Anchors(
        at_places(known.position, numbers, 0.0), at_places(known.rotation, numbers, np.eye(3))
    )
    return replace(whole, **values, anchors=anchors, anchor_id=numbers)


@pytest.mark.parametrize("name", HEARD_ONLY)
def test_the_anchors_heard_give_the_fixes_of_all_anchors(name, hall):
    """Both engines, compiled where a kernel exists; origins differ, and with them rounding."""
    estimator = preset(name)
    assert estimator.heard_only
    whole, heard = hall
    assert (heard.anchor_id < 0).any()
    assert heard.azimuth.shape[-1] < 20
    place = Place(whole.anchors)
    for engine in engines(estimator):
        one = replace(estimator, engine=engine)
        assert engine == "numpy" or one.compiled(heard.anchors) is not None
        a, b = (one(batch, place, None) for batch in (whole, heard))
        assert np.mean(a.outcome == Outcome.OK) > 0.5
        assert np.mean(a.outcome == Outcome.FAILED) > 0.01
        same = a.outcome == b.outcome
        assert same.mean() > 0.99
        assert np.array_equal(a.anchors_used, b.anchors_used)
        settled = same & (a.outcome != Outcome.DIVERGED)
        assert np.array_equal(a.reason[settled], b.reason[settled])
        ok = same & (a.outcome == Outcome.OK)
        assert np.allclose(a.position[ok], b.position[ok], rtol=0, atol=1e-6)
        assert np.allclose(a.covariance[ok], b.covariance[ok], rtol=1e-6)
