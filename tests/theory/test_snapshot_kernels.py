"""Kernels of the snapshot estimators: iterations that repeat themselves, and the anchors heard."""

import math
from dataclasses import replace

import numpy as np
import pytest

from aoabench.estimators import least_squares, maximum_likelihood
from aoabench.estimators.least_squares import by_kernel
from aoabench.estimators.lines import AnchorDiscarding, LineLeastSquares
from aoabench.estimators.vmf_likelihood import VmfLikelihood
from aoabench.maths.geometry import euler, to_azel
from aoabench.maths.places import at_places, numbers_of
from aoabench.types import Anchors, Batch, Outcome, Reason
from tests.contracts.test_geometry import engines, preset
from tests.helpers import Place
from tests.theory.rounding import equal_but_for_rounding, moved_by_rounding

UPDATES = 300
HEARD_ONLY = (
    "ls",
    "ml_arctan",
    "ml_atan2",
    "ml_kcorr",
    "ls_lines",
    "ls_anchor_discarding",
    "vmf_ml",
)


@pytest.fixture
def interpreted(monkeypatch):
    """The module of the kernel as plain Python, without numba."""
    from aoabench.kernels import angles, planes, small, snapshot
    from aoabench.kernels.compile import Kernel

    found = [(m, *item) for m in (angles, small, planes, snapshot) for item in vars(m).items()]
    for module, name, value in found:
        function = vars(value).get("_dispatcher", value) if isinstance(value, Kernel) else value
        if hasattr(function, "py_func"):
            monkeypatch.setattr(module, name, function.py_func)
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


@pytest.mark.parametrize("name", ["ls", "ml_arctan", "ml_atan2", "ml_kcorr"])
@pytest.mark.parametrize("heard", [False, True])
def test_numpy_solves_the_fixes_at_a_pole_and_no_others(name, heard, hall, monkeypatch):
    """These fixes equal those of the engine numpy bit by bit, the others those of the kernel."""
    batch = hall[heard]
    one, counts = preset(name), []
    before = one(batch, Place(hall[0].anchors), None)
    elevation = batch.elevation.copy()
    spots = [(0, 3, 90.0), (0, 7, -90.0), (2, 7, 90.0)]
    for i, k, degrees in spots:
        b = np.flatnonzero(np.isfinite(elevation[i, k]))[0]
        elevation[i, k, b] = np.radians(degrees)
    batch = replace(batch, elevation=elevation)
    whole = replace(one, engine="numpy")(batch, Place(hall[0].anchors), None)
    room = least_squares if name == "ls" else maximum_likelihood
    planes = room.planes
    monkeypatch.setattr(
        room, "planes", lambda b, *more: counts.append(b.azimuth.shape[:2]) or planes(b, *more)
    )
    found = one(batch, Place(hall[0].anchors), None)
    assert counts == [(1, len(spots))]
    at = np.zeros(elevation.shape[:2], dtype=bool)
    at[tuple(np.transpose([spot[:2] for spot in spots]))] = True
    for field in ("position", "covariance", "iterations", "outcome", "anchors_used", "reason"):
        if getattr(found, field) is not None:
            value = getattr(found, field)
            np.testing.assert_array_equal(value[at], getattr(whole, field)[at], field)
            np.testing.assert_array_equal(value[~at], getattr(before, field)[~at], field)


METHODS = {
    "ls_lines": LineLeastSquares(),
    "discarding": AnchorDiscarding(0.05),
    "discarding to two": AnchorDiscarding(1e-9, clip=False),
    "vmf on a plane": VmfLikelihood(1.0),
    "vmf": VmfLikelihood("free", clip=False),
}


def measured(rng, B, stated, fixes=300):
    """Fixes of B turned anchors around a room with 5 deg noise; a tenth of the angles is missing,
    and of some anchors the elevation alone.
    """
    anchors = Anchors(
        rng.uniform([-1, -1, 2], [11, 9, 4], (B, 3)), euler_turns(rng.uniform(-0.5, 0.5, (B, 3)))
    )
    p = rng.uniform([0, 0, 0.5], [10, 8, 1.5], (fixes, 3))
    local = np.einsum("bij,tbj->ibt", anchors.rotation[0, 0], p[:, None] - anchors.position[0, 0])
    angles = np.stack(to_azel(*local)).swapaxes(1, 2)
    sigma = np.radians(rng.uniform(2, 8, (2, 1, fixes, B)))
    angles = angles[:, None] + sigma * rng.standard_normal(sigma.shape)
    angles[:, rng.random(sigma.shape[1:]) < 0.1] = np.nan
    angles[1, rng.random(sigma.shape[1:]) < 0.1] = np.nan
    sigma[:, rng.random(sigma.shape[1:]) < 0.02] = 0.0  # no deviation: not measured
    return Batch(
        *angles,
        anchors,
        azimuth_sigma=sigma[0] if stated > 0 else None,
        elevation_sigma=sigma[1] if stated > 1 else None,
    )


def euler_turns(angles):
    return np.array([euler(turn).T for turn in angles])


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.parametrize("stated", [0, 1, 2])
@pytest.mark.parametrize("B", [2, 3, 5, 8])
def test_the_kernel_equals_numpy(name, stated, B, rng):
    """In every field, but for fixes that rounding itself moves."""
    batch = measured(rng, B, stated)
    place = Place(batch.anchors, bounds_m=[[0, 0], [10, 8]])
    fast, slow = (replace(METHODS[name], engine=e) for e in ("auto", "numpy"))
    moved = moved_by_rounding(lambda b: slow(b, place, None), batch)
    fast, slow = (method(batch, place, None) for method in (fast, slow))
    steady = moved.max(axis=0) < 1e-3
    assert steady.mean() > 0.9
    same = (fast.outcome == slow.outcome) & (fast.reason == slow.reason)
    assert same[steady].mean() > 0.999
    equal_but_for_rounding(fast, slow, moved, steady & same)
    assert np.quantile(moved[0], 0.9) < 1e-6
    assert np.array_equal(fast.anchors_used, slow.anchors_used)
    assert np.allclose(fast.score[steady], slow.score[steady], rtol=0, atol=1e-6, equal_nan=True)
    if slow.iterations is not None:
        assert np.mean(fast.iterations == slow.iterations) > 0.97


@pytest.mark.parametrize("name", METHODS)
def test_the_kernel_equals_numpy_where_nothing_is_determined(name):
    """Parallel lines, one place, one anchor and none, azimuths alone, verticals, and exact data;
    the target in an anchor's place.
    """
    s = np.array([[0.0, 0, 3], [4, 0, 3], [0, 4, 3], [4, 4, 3]])
    down, gone = -np.pi / 2, np.nan
    rows = {
        "parallel": ([0.5] * 4, [-0.3] * 4),
        "none": ([gone] * 4, [gone] * 4),
        "one": ([0.3, gone, gone, gone], [-0.5, gone, gone, gone]),
        "azimuths": ([0.8, 2.3, -0.8, -2.3], [gone] * 4),
        "two azimuths": ([0.8, gone, gone, -2.3], [gone] * 4),
        "elevations": ([gone] * 4, [-0.5] * 4),
        "verticals": ([0.0] * 4, [down] * 4),
        "up": ([0.2, 2.0, -1.0, -2.5], [0.5] * 4),
        "centre": ([0.25 * np.pi, 0.75 * np.pi, -0.25 * np.pi, -0.75 * np.pi], [-0.6] * 4),
    }
    azimuth, elevation = np.array(list(rows.values())).swapaxes(0, 1)
    batch = Batch(azimuth[None], elevation[None], Anchors(s, np.broadcast_to(np.eye(3), (4, 3, 3))))
    crowd = replace(batch, anchors=Anchors(0 * s + s[0], batch.anchors.rotation))
    for one in (batch, crowd):
        fast, slow = (
            replace(METHODS[name], engine=e)(one, Place(one.anchors), None)
            for e in ("auto", "numpy")
        )
        assert np.array_equal(fast.outcome, slow.outcome)
        assert np.array_equal(fast.reason, slow.reason)
        assert np.array_equal(fast.anchors_used, slow.anchors_used)
        ok = slow.outcome == Outcome.OK
        close = {"rtol": 1e-6, "atol": 1e-6, "equal_nan": True}
        assert np.allclose(fast.position[ok], slow.position[ok], **close)
        assert np.allclose(fast.covariance[ok], slow.covariance[ok], **close)
