"""Filters over steps of varying length: the exact filter, laws of time, kernels and NumPy."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from aoabench.filters.access_nodes import AccessNodeEKF
from aoabench.filters.belief import believed
from aoabench.filters.kalman import EKF, UKF
from aoabench.filters.particle import ParticleFilter
from aoabench.maths.geometry import LIGHT
from aoabench.maths.times import elapsed
from aoabench.models.azel import AzEl
from aoabench.models.motion import ConstantAcceleration, ConstantVelocity, RandomWalk, motion_of
from aoabench.models.unit_vector import UnitVector
from aoabench.streams import Streams
from aoabench.types import Anchors, Batch
from tests.helpers import Place
from tests.theory.rounding import equal_but_for_rounding, moved_by_rounding
from tests.theory.test_kalman import FILTERS, Linear

MOTIONS = [RandomWalk(0.7, 0.2), ConstantVelocity(0.4, 0.1), ConstantAcceleration(0.3)]
OF_MOTION = pytest.mark.parametrize("motion", MOTIONS, ids=["walk", "velocity", "acceleration"])
METHODS = {
    "ekf": lambda engine: EKF(AzEl(8.0), engine=engine),
    "ekf_vmf": lambda engine: EKF(UnitVector(60.0), engine=engine),
    "ukf": lambda engine: UKF(AzEl(8.0), engine=engine),
    "access_nodes": lambda engine: AccessNodeEKF(engine=engine),
}
T, B = 9, 4


class Track(Place):
    """A place whose prior is that of the first step."""

    start_s = None


@pytest.fixture
def anchors(rng):
    return Anchors(rng.uniform(-8, 8, (B, 3)), np.linalg.qr(rng.normal(size=(B, 3, 3)))[0])


def ragged(rng, R):
    """Increasing times (R, T), some equal, one unknown, one track shorter than the others."""
    step = rng.choice([0.0, 0.1, 0.35, 2.0], (R, T))
    time = 1.7e9 + np.cumsum(step, axis=1)
    time[0, 4] = np.nan
    time[-1, 6:] = np.nan
    return time


def batch_of(rng, anchors, R, n, time):
    x = rng.normal(size=(R, T, 3))
    angles = AzEl(1.0).predict(x, anchors).reshape(R, T, B, 2)
    angles += 0.1 * rng.normal(size=angles.shape)
    angles[rng.random((R, T, B)) < 0.3] = np.nan
    angles[np.isnan(time) & (np.arange(T) > 5)] = np.nan
    delay = np.linalg.norm(x[:, :, None] - anchors.position, axis=-1) / LIGHT
    each = np.ones((R, T, B))
    return Batch(
        angles[..., 0], angles[..., 1], anchors, delay=delay + 1e-9 * rng.normal(size=delay.shape),
        azimuth_sigma=0.1 * each, elevation_sigma=0.2 * each, delay_sigma=1e-9 * each,
        prior_mean=np.concatenate([x[:, 0], rng.normal(size=(R, n - 3))], axis=1),
        prior_cov=np.eye(n) + 0.3, time=time,
    )  # fmt: skip


def streams(R):
    return Streams(1, "place", tuple(range(R)))


@OF_MOTION
def test_two_steps_are_one_step_of_both_lengths(motion, rng):
    """F(a + b) = F(b) F(a), Q(a + b) = F(b) Q(a) F(b)^T + Q(b); no time changes nothing."""
    a, b = rng.uniform(0, 3, (2, 5, 1))
    (Fa, Qa), (Fb, Qb), (F, Q) = (motion.matrices(dt) for dt in (a, b, a + b))
    assert np.allclose(Fb @ Fa, F, rtol=1e-13, atol=1e-13)
    assert np.allclose(Fb @ Qa @ np.swapaxes(Fb, -1, -2) + Qb, Q, rtol=1e-12, atol=1e-12)
    F, Q = motion.matrices(np.zeros((2, 1)))
    assert np.array_equal(
        np.broadcast_to(F, Q.shape), np.broadcast_to(np.eye(Q.shape[-1]), Q.shape)
    )
    assert not Q.any()


@pytest.mark.parametrize("motion", MOTIONS[1:], ids=["velocity", "acceleration"])
def test_matrices_are_those_of_the_differential_equation(motion):
    """By Van Loan's block exponential of dx = A x dt + noise of density D in the last derivative."""
    dt, n = 0.7, 3 + len(motion.start())
    A, D = np.zeros((n, n)), np.zeros((n, n))
    A[:-3, 3:] = np.eye(n - 3)
    q = motion.q if n == 9 else [motion.q_xy**2, motion.q_xy**2, motion.q_z**2]
    D[-3:, -3:] = np.eye(3) * q
    M = expm(np.block([[-A, D], [np.zeros((n, n)), A.T]]) * dt)
    F, Q = motion.matrices(dt)
    assert np.allclose(F, M[n:, n:].T, rtol=1e-13, atol=1e-13)
    assert np.allclose(Q, F @ M[:n, n:], rtol=1e-12, atol=1e-14)


def test_motions_by_name():
    assert motion_of("random_walk") == RandomWalk()
    assert motion_of("constant_velocity") == ConstantVelocity()
    assert motion_of(None) is None
    assert motion_of(MOTIONS[2]) is MOTIONS[2]


def test_elapsed_time():
    time = np.array([[3.0, 3.5, np.nan, 4.5, np.nan], [np.nan, 1.0, 1.0, 3.0, 3.0]])
    assert elapsed(time, None).tolist() == [[0, 0.5, 0, 1, 0], [0, 0, 0, 2, 0]]
    assert elapsed(time)[:, 0].tolist() == [3.0, 0.0]
    assert elapsed(time)[1, 1] == 1.0
    with pytest.raises(ValueError, match=r"must not decrease: 2.0 s after 3.0 s"):
        elapsed(np.array([[3.0, np.nan, 2.0]]))


def test_steps_of_the_scenario_and_tracks_without_times(anchors, rng):
    place = Track(anchors, motion=MOTIONS[0], dt=0.25)
    nothing = np.full((2, 3, B), np.nan)
    batch = Batch(nothing, nothing, anchors, prior_mean=np.zeros((2, 3)), prior_cov=np.eye(3))
    Q = place.motion.matrices(0.25)[1]
    for time in (None, 0.25 * np.arange(1.0, 4)[None], np.full((2, 3), np.nan)):
        assert np.array_equal(believed(replace(batch, time=time), place).Q, Q[None, None])
    time = np.array([[np.nan] * 3, [1.0, 2.0, 4.0]])
    found = believed(replace(batch, time=time), place).Q[..., 0, 0] / Q[0, 0] * 0.25
    assert np.allclose(found, [[0.25] * 3, [0, 1, 2]], rtol=1e-14, atol=0)


@pytest.mark.parametrize("make", FILTERS)
def test_a_linear_model_equals_the_exact_filter(make, rng):
    """Over irregular times that differ between replications; tolerance 1e-9."""
    R, m, motion = 4, 6, MOTIONS[1]
    H, r, y = rng.normal(size=(m, 6)), rng.uniform(0.1, 2.0, m), rng.normal(size=(R, T, m))
    at, time = Anchors(np.zeros((1, 3)), np.eye(3)[None]), ragged(rng, R)
    batch = Batch(y[..., :3], y[..., 3:], at, prior_mean=rng.normal(size=(R, 6)), time=time,
                  prior_cov=np.eye(6) + 0.2)  # fmt: skip
    found = make(Linear(tuple(map(tuple, H)), tuple(r)))(
        batch, Track(at, motion=motion), streams(R)
    )
    for i in range(R):
        x, P, before = batch.prior_mean[i], batch.prior_cov, time[i, 0]
        for k in range(T):
            dt, before = (0, before) if np.isnan(time[i, k]) else (time[i, k] - before, time[i, k])
            F, Q = motion.matrices(float(dt))
            x, P = F @ x, F @ P @ F.T + Q
            K = P @ H.T @ np.linalg.inv(H @ P @ H.T + np.diag(r))
            x, P = x + K @ (y[i, k] - H @ x), P - K @ H @ P
            assert np.allclose(found.position[i, k], x[:3], rtol=1e-9, atol=1e-9)
            assert np.allclose(found.covariance[i, k], P[:3, :3], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("make", FILTERS[:2])
def test_packets_of_one_time_are_one_step(make, rng):
    """A linear model: each packet as a step of its own, or all in one; those of a time last count."""
    R, m, motion = 2, 4, MOTIONS[1]
    H, r = rng.normal(size=(m, 6)), rng.uniform(0.1, 2.0, m)
    y, time = rng.normal(size=(R, T, m)), np.cumsum(rng.uniform(0.1, 1, (R, T)), axis=1)
    at = Anchors(np.zeros((1, 3)), np.eye(3)[None])
    method, place = make(Linear(tuple(map(tuple, H)), tuple(r))), Track(at, motion=motion)
    prior = {"prior_mean": rng.normal(size=(R, 6)), "prior_cov": np.eye(6) + 0.2}
    one = Batch(y[..., :2], y[..., 2:], at, time=time, **prior)
    each = np.where(np.eye(m, dtype=bool), y[:, :, None], np.nan).reshape(R, T * m, m)
    alone = Batch(each[..., :2], each[..., 2:], at, time=np.repeat(time, m, axis=1), **prior)
    once, apart = (method(b, place, streams(R)) for b in (one, alone))
    assert np.allclose(apart.position[:, m - 1 :: m], once.position, rtol=1e-9, atol=1e-10)
    assert np.allclose(apart.covariance[:, m - 1 :: m], once.covariance, rtol=1e-9, atol=1e-10)


def test_a_motion_that_takes_no_arrays_is_named(anchors):
    class Scalar(RandomWalk):
        def matrices(self, dt):
            return np.eye(3), np.ones((2, 3, 3)) * np.mean(dt)

    nothing = np.full((1, 3, B), np.nan)
    batch = Batch(nothing, nothing, anchors, prior_mean=np.zeros((1, 3)), prior_cov=np.eye(3),
                  time=np.array([[1.0, 2.0, 4.0]]))  # fmt: skip
    with pytest.raises(ValueError, match=r"Scalar.matrices must return F and Q \(\.\.\., 3, 3\)"):
        believed(batch, Track(anchors, motion=Scalar()))


@OF_MOTION
@pytest.mark.parametrize("name", METHODS)
@pytest.mark.parametrize("R", [1, 3, 70])
def test_the_kernel_equals_numpy(motion, name, R, anchors, rng):
    """One track, whose steps differ alone, and several, each with steps of its own."""
    n = 3 + len(motion.start())
    batch = batch_of(rng, anchors, R, n, ragged(rng, R))
    place = Track(anchors, motion=motion)
    fast, slow = (METHODS[name](e)(batch, place, streams(R)) for e in ("auto", "numpy"))
    moved = moved_by_rounding(lambda b: METHODS[name]("auto")(b, place, streams(R)), batch, 3)
    equal_but_for_rounding(fast, slow, moved)
    assert np.array_equal(fast.outcome, slow.outcome)


@OF_MOTION
@pytest.mark.parametrize("name", METHODS)
def test_equal_steps_given_as_times_are_those_of_the_scenario(motion, name, anchors, rng):
    n, R = 3 + len(motion.start()), 5
    batch = batch_of(rng, anchors, R, n, np.zeros((R, T)))
    method, place = METHODS[name]("auto"), Place(anchors, motion=motion, dt=0.3)
    shift = 1e-12 * np.arange(R)[:, None]
    regular = method(replace(batch, time=None), place, streams(R))
    given = method(replace(batch, time=0.3 * np.arange(1, T + 1) + shift), place, streams(R))
    assert np.allclose(given.position, regular.position, rtol=1e-8, atol=1e-8)
    assert np.allclose(given.covariance, regular.covariance, rtol=1e-8, atol=1e-8)


@OF_MOTION
@pytest.mark.parametrize("name", METHODS)
def test_a_step_without_measurements_changes_nothing_after_it(motion, name, anchors, rng):
    """Split one step of 2 s in two: the later estimates are the same, for each replication."""
    n, R = 3 + len(motion.start()), 3
    time = np.cumsum(rng.choice([0.5, 2.0], (R, T)), axis=1)
    batch, empty = batch_of(rng, anchors, R, n, time), np.full((R, 1, B), np.nan)
    between = time[:, 3:4] + 0.3 * (time[:, 4:5] - time[:, 3:4])
    each = {k: np.concatenate([getattr(batch, k)[:, :4], v, getattr(batch, k)[:, 4:]], axis=1)
            for k, v in {"azimuth": empty, "elevation": empty, "delay": empty, "time": between,
                         "azimuth_sigma": empty, "elevation_sigma": empty, "delay_sigma": empty}.items()}  # fmt: skip
    method, place = METHODS[name]("auto"), Track(anchors, motion=motion)
    one, two = (method(b, place, streams(R)) for b in (batch, replace(batch, **each)))
    later = np.delete(np.arange(T + 1), 4)
    assert np.allclose(two.position[:, later], one.position, rtol=1e-8, atol=1e-8)
    assert np.allclose(two.covariance[:, later], one.covariance, rtol=1e-8, atol=1e-8)
    assert np.trace(two.covariance[:, 4] - two.covariance[:, 3], axis1=-2, axis2=-1).min() > 0


@pytest.mark.parametrize("engine", ["auto", "numpy"])
@OF_MOTION
@pytest.mark.parametrize("name", METHODS)
def test_a_track_is_the_same_alone_and_beside_others(name, motion, engine, anchors, rng):
    """To the last bits of the matrix products; its padding does not matter either."""
    n, R = 3 + len(motion.start()), 3
    batch, place = batch_of(rng, anchors, R, n, ragged(rng, R)), Track(anchors, motion=motion)
    method = METHODS[name](engine)
    together = method(batch, place, streams(R))
    for r in range(R):
        alone = method(batch.of(r), place, streams(1))
        assert np.allclose(alone.position[0], together.position[r], rtol=1e-9, atol=1e-10)
        assert np.allclose(alone.covariance[0], together.covariance[r], rtol=1e-9, atol=1e-10)


@pytest.mark.parametrize("engine", ["auto", "numpy", "double"])
@OF_MOTION
def test_particles_follow_the_times(motion, engine, anchors, rng):
    """Without measurements the cloud spreads as Q says; in no time it does not move."""
    n, N = 3 + len(motion.start()), 20_000
    if n > 3 and engine == "double":
        pytest.skip("needs a kernel, which has positions alone")
    time = np.array([[0, 0, 1.0, 1.0, 6.0], [5.0, 5.5, 5.5, 5.5, np.nan]])
    nothing = np.full((2, 5, B), np.nan)
    cov = np.diag([0.01] * n)
    batch = Batch(nothing, nothing, anchors, prior_mean=np.zeros((2, n)), prior_cov=cov, time=time)
    place, method = Track(anchors, motion=motion), ParticleFilter(AzEl(8.0), N, engine=engine)
    found = np.stack([
        method(batch.of(r), place, Streams(1, "place", (r,))).covariance[0] for r in range(2)
    ])  # fmt: skip
    for r, dt in enumerate(elapsed(time, None)):
        P = cov
        for k in range(5):
            F, Q = motion.matrices(float(dt[k]))
            P = F @ P @ F.T + Q
            assert np.allclose(np.diag(found[r, k]), np.diag(P)[:3], rtol=6 * np.sqrt(2 / N))
            if dt[k] == 0 and k:
                assert np.allclose(found[r, k], found[r, k - 1], rtol=1e-4, atol=1e-8)


def test_particles_on_two_tracks_at_once_are_those_of_each_alone(anchors, rng):
    R = 2
    time = np.cumsum(rng.choice([0.0, 0.4, 1.0], (R, T)), axis=1)
    batch, place = batch_of(rng, anchors, R, 3, time), Track(anchors, motion=MOTIONS[0])
    method = ParticleFilter(UnitVector(60.0), 512)
    both = method(batch, place, streams(R))
    for r in range(R):
        alone = method(batch.of(r), place, Streams(1, "place", (r,)))
        assert np.array_equal(alone.position[0], both.position[r])
