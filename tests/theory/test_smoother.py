"""Smoothers against the dense Gaussian posterior, closed forms, and a general solver."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import optimize, stats
from scipy.linalg import block_diag

from aoabench.config.compose import compose_cells
from aoabench.config.presets import options
from aoabench.engine.draws import Draws
from aoabench.engine.tiles import estimate_tile
from aoabench.errors import BadValue
from aoabench.filters.access_nodes import AccessNodeEKF
from aoabench.filters.belief import Belief
from aoabench.filters.kalman import EKF, UKF
from aoabench.filters.map_smoother import MAPSmoother
from aoabench.filters.particle import ParticleFilter
from aoabench.filters.smoother import RTSSmoother, smoothed
from aoabench.filters.track_model import inverse_root
from aoabench.maths.geometry import to_unit
from aoabench.models.azel import AzEl, AzElAdaptive
from aoabench.models.motion import ConstantVelocity as FreeMotion
from aoabench.models.unit_vector import UnitVector
from aoabench.noise.angular import FlippedAngles
from aoabench.streams import Streams
from aoabench.types import Anchors, Batch, Outcome, Reason
from tests.helpers import Place
from tests.theory import test_laws_of_filters as laws
from tests.theory.test_kalman import ConstantVelocity, Line, linear_problem

R, T = 5, 12
STREAMS = Streams(1, "line", tuple(range(R)))
SMOOTHERS = {
    "ekf": lambda h, engine: RTSSmoother(EKF(h, engine=engine)),
    "ukf": lambda h, engine: RTSSmoother(UKF(h, engine=engine)),
    "map": lambda h, engine: MAPSmoother(h, engine=engine),
}


def dense_posterior(h, batch, y, i, motion, intervals=None):
    """Means (T, 3) and covariances (T, 3, 3) of the positions of replication i: all states are one
    normal vector, which is conditioned on all measurements at once. intervals (T,) s.
    """
    steps, n = y.shape[1], batch.prior_mean.shape[1]
    each = [motion.matrices(dt) for dt in np.full(steps, 0.5) if intervals is None]
    each = each or [motion.matrices(float(dt)) for dt in intervals]
    mean, cov = batch.prior_mean[i], batch.prior_cov
    means, A = [], np.zeros((steps * n, (steps + 1) * n))  # the states from x_0 and the noises
    for k, (F, _) in enumerate(each):
        mean = F @ mean
        means.append(mean)
        now, before = slice(k * n, (k + 1) * n), slice((k - 1) * n, k * n)
        A[now] = F @ A[before] if k else 0.0
        A[now, (k + 1) * n : (k + 2) * n] = np.eye(n)
        if k == 0:
            A[now, :n] = F
    W = block_diag(cov, *(Q for _, Q in each))
    prior, mu = A @ W @ A.T, np.concatenate(means)
    seen = ~np.isnan(y[i].ravel())
    H = np.kron(np.eye(steps), np.array(h.H))[seen]
    S = H @ prior @ H.T + np.diag(np.tile(h.r, steps)[seen])
    K = np.linalg.solve(S, H @ prior).T
    mu, P = mu + K @ (y[i].ravel()[seen] - H @ mu), prior - K @ S @ K.T
    blocks = P.reshape(steps, n, steps, n)[np.arange(steps), :, np.arange(steps)]
    return mu.reshape(steps, n)[:, :3], blocks[:, :3, :3]


@pytest.mark.parametrize("engine", ["auto", "numpy"])
@pytest.mark.parametrize("make", SMOOTHERS.values(), ids=SMOOTHERS)
@pytest.mark.parametrize("missing", [False, True])
def test_linear_model_equals_the_dense_posterior(make, missing, engine, rng):
    h, batch, y = linear_problem(rng, R, T)
    if missing:
        y[rng.random(y.shape) < 0.3] = np.nan
        y[2, 4:7] = np.nan  # a gap
        y[1, -2:] = np.nan
        batch = replace(batch, azimuth=y[..., :4], elevation=y[..., 4:])
    estimates = make(h, engine)(batch, Line(), STREAMS)
    for i in range(R):
        mean, covariance = dense_posterior(h, batch, y, i, ConstantVelocity())
        assert np.abs(estimates.position[i] - mean).max() < 1e-10
        assert np.abs(estimates.covariance[i] - covariance).max() < 1e-10
    assert np.all(estimates.outcome == Outcome.OK)


TIMES = {
    "one for all": np.array([[0.0, 0.2, 0.2, 0.9, 1.0, 1.1, 4.0, 4.1, 4.1, 5.0, 5.5, 6.0]]),
    "own": np.cumsum(np.random.default_rng(2).choice([0.0, 0.1, 0.5, 3.0], (R, T)), axis=1),
}


@pytest.mark.parametrize("engine", ["auto", "numpy"])
@pytest.mark.parametrize("make", SMOOTHERS.values(), ids=SMOOTHERS)
@pytest.mark.parametrize("time", TIMES.values(), ids=TIMES)
def test_steps_of_any_length_equal_the_dense_posterior(make, time, engine, rng):
    """Several steps of one time, long ones, and unknown times, which count as the step before."""
    h, batch, y = linear_problem(rng, R, T)
    time = time.copy()
    time[:, 3] = np.nan
    found = make(h, engine)(replace(batch, time=time), Line(motion=FreeMotion()), STREAMS)
    filled = np.where(np.isnan(time), time[:, [2] * T], time)
    for i in range(R):
        intervals = np.diff(filled[i % len(filled)], prepend=0.0)
        mean, covariance = dense_posterior(h, batch, y, i, FreeMotion(), intervals)
        assert np.abs(found.position[i] - mean).max() < 1e-10
        assert np.abs(found.covariance[i] - covariance).max() < 1e-10


class Noiseless:
    """Constant velocity without noise: Q is 0 and its inverse does not exist."""

    def matrices(self, dt):
        return ConstantVelocity().matrices(dt)[0], np.zeros((6, 6))


class Jerky:
    """Constant velocity whose noise has fewer dimensions than the state."""

    def matrices(self, dt):
        G = np.concatenate([dt**2 / 2 * np.eye(3), dt * np.eye(3)])
        return ConstantVelocity().matrices(dt)[0], 0.3 * G @ G.T


@pytest.mark.parametrize("engine", ["auto", "numpy"])
@pytest.mark.parametrize("make", SMOOTHERS.values(), ids=SMOOTHERS)
@pytest.mark.parametrize("motion", [Noiseless(), Jerky()], ids=["no noise", "singular"])
def test_the_motion_needs_no_invertible_noise(make, motion, engine, rng):
    h, batch, y = linear_problem(rng, R, T)
    estimates = make(h, engine)(batch, Line(motion=motion), STREAMS)
    for i in range(R):
        mean, covariance = dense_posterior(h, batch, y, i, motion)
        assert np.abs(estimates.position[i] - mean).max() < 1e-9
        assert np.abs(estimates.covariance[i] - covariance).max() < 1e-9


class Walk:
    """A random walk of the position, and of the velocity for six dimensions; q m^2 per step."""

    def __init__(self, q=0.04, n=3):
        self.q, self.n = q, n

    def matrices(self, dt):
        F = np.eye(self.n)
        F[:3, 3:] = dt * np.eye(3)[:, : self.n - 3]
        return F, self.q * np.eye(self.n)


PLACES = np.array([[-3.0, -2, 3], [8, -1, 4], [9, 8, 1], [-2, 9, -3], [3, 2, 8]])
MODELS = {
    "unit_vector": UnitVector(),
    "azel": AzEl(),
    "azel_adaptive": AzElAdaptive(4.0, noise=FlippedAngles(4.0)),
}


def walks(rng, reps=6, steps=40, n=3, sigma=0.05, missing=0.0, own=False):
    """Random walks from the filters' own model, and measurements of five anchors in any
    orientation, tangent to the direction and normal with the deviation sigma rad.
    """
    turns = np.linalg.qr(rng.normal(size=(reps if own else 1, 5, 3, 3)))[0]
    anchors = Anchors(
        np.broadcast_to(PLACES, (len(turns), 5, 3)), turns, np.zeros((1, 5, 3)) + 1e-3
    )
    scenario = Place(anchors, motion=Walk(n=n), dt=0.5)
    F, Q = scenario.motion.matrices(0.5)
    mean, P = np.zeros((reps, n)) + [3, 3, 0.5, *[0.0] * (n - 3)], 0.09 * np.eye(n)
    x = mean + rng.normal(size=mean.shape) * 0.3
    truth = []
    for _ in range(steps):
        x = x @ F.T + rng.normal(size=x.shape) * np.sqrt(0.04)
        truth.append(x)
    truth = np.stack(truth, axis=1)
    d = truth[:, :, None, :3] - PLACES
    u = d / np.linalg.norm(d, axis=-1, keepdims=True) + sigma * rng.normal(size=d.shape)
    u = np.einsum("rbij,rtbj->rtbi", np.broadcast_to(turns, (reps, 5, 3, 3)), u)
    azimuth = np.arctan2(u[..., 1], u[..., 0])
    azimuth[rng.random(azimuth.shape) < missing] = np.nan
    each = np.full(azimuth.shape, sigma)
    batch = Batch(
        azimuth, np.arctan2(u[..., 2], np.hypot(u[..., 0], u[..., 1])), anchors,
        azimuth_sigma=each, elevation_sigma=each, prior_mean=mean, prior_cov=P,
    )  # fmt: skip
    return truth, batch, scenario


@pytest.mark.parametrize("h", MODELS.values(), ids=MODELS)
@pytest.mark.parametrize("n", [3, 6])
@pytest.mark.parametrize("make", SMOOTHERS.values(), ids=SMOOTHERS)
@pytest.mark.parametrize("own", [False, True])
def test_kernels_equal_numpy(make, n, h, own, rng):
    _, batch, scenario = walks(rng, n=n, missing=0.2, own=own)
    fast, slow = (make(h, engine)(batch, scenario, STREAMS) for engine in ("auto", "numpy"))
    assert np.abs(fast.position - slow.position).max() < 1e-8
    assert np.abs(fast.covariance - slow.covariance).max() < 1e-8
    assert np.array_equal(fast.outcome, slow.outcome)
    assert np.mean(fast.outcome == Outcome.OK) > 0.8


@pytest.mark.parametrize("engine", ["auto", "numpy"])
@pytest.mark.parametrize("n", [3, 6])
def test_the_access_node_filter_has_a_smoother(n, engine, rng):
    """The last step is the filter's; earlier ones have smaller covariances."""
    _, batch, scenario = walks(rng, n=n)
    before = AccessNodeEKF(toa=False, engine=engine)(batch, scenario, STREAMS)
    after = RTSSmoother(AccessNodeEKF(toa=False, engine=engine))(batch, scenario, STREAMS)
    assert np.allclose(after.position[:, -1], before.position[:, -1], atol=1e-12)
    assert np.allclose(after.covariance[:, -1], before.covariance[:, -1], atol=1e-12)
    less = np.linalg.eigvalsh(before.covariance[:, :-1] - after.covariance[:, :-1])
    assert np.all(less > 0)


@pytest.mark.parametrize("make", SMOOTHERS.values(), ids=SMOOTHERS)
def test_a_random_walk_is_interpolated_through_a_gap(make, rng):
    """Between two measured steps, the posterior mean of a random walk is a straight line at constant
    speed, and its variance is the line's plus that of a Brownian bridge.
    """
    _, batch, scenario = walks(rng)
    azimuth, elevation = batch.azimuth.copy(), batch.elevation.copy()
    azimuth[:, 11:20] = elevation[:, 11:20] = np.nan
    batch = replace(batch, azimuth=azimuth, elevation=elevation)
    found = make(UnitVector(), "auto")(batch, scenario, STREAMS)
    share = np.linspace(0, 1, 11)[:, None]
    a, b = found.position[:, 10], found.position[:, 20]
    line = a[:, None] * (1 - share) + b[:, None] * share
    assert np.allclose(found.position[:, 10:21], line, atol=1e-9)
    mixed = found.covariance[:, 15] - 0.04 * 10 / 4 * np.eye(3)  # that of the mean of both ends
    ends = 0.5 * (found.covariance[:, 10] + found.covariance[:, 20])
    assert np.all(np.linalg.eigvalsh(mixed) > 0)
    assert np.all(np.linalg.eigvalsh(ends - mixed) > 0)


@pytest.mark.parametrize("h", MODELS.values(), ids=MODELS)
@pytest.mark.parametrize("n", [3, 6])
def test_map_is_the_minimum_that_a_general_solver_finds(h, n, rng):
    """scipy.optimize.least_squares over the whole track, with its own derivatives."""
    truth, batch, scenario = walks(rng, reps=2, steps=8, n=n, missing=0.1)
    found = MAPSmoother(h, tolerance=1e-9)(batch, scenario, STREAMS)
    F, Q = scenario.motion.matrices(0.5)
    y, quality = h.observe(batch)
    first = inverse_root(F @ batch.prior_cov @ F.T + Q)
    later, anchors = inverse_root(Q), batch.anchors
    for i in range(2):
        weights = np.ones_like(y[i])
        if h is MODELS["azel_adaptive"]:
            r = [
                h.covariance(found.position[i, k][None], anchors, quality[i, k][None])[0]
                for k in range(8)
            ]
        else:
            r = quality[i]
        weights = np.where(np.isfinite(y[i]), 1 / np.sqrt(r), 0.0)

        def terms(flat, i=i, weights=weights):
            x = flat.reshape(8, n)
            v = np.stack(
                [h.residual(y[i, k][None], h.predict(x[k][None], anchors))[0] for k in range(8)]
            )
            before = np.concatenate([batch.prior_mean[i][None], x[:-1]])
            w = x - before @ F.T
            return np.concatenate(
                [first @ w[0], (w[1:] @ later.T).ravel(), (np.nan_to_num(v) * weights).ravel()]
            )

        best = optimize.least_squares(terms, truth[i].ravel(), xtol=1e-14, ftol=1e-14, gtol=1e-12)
        assert np.abs(best.x.reshape(8, n)[:, :3] - found.position[i]).max() < 2e-6
        inverse = np.linalg.inv(best.jac.T @ best.jac).reshape(8, n, 8, n)
        blocks = inverse[np.arange(8), :3, np.arange(8), :3]
        assert np.allclose(blocks, found.covariance[i], rtol=2e-3, atol=1e-8)


@pytest.mark.parametrize("make", SMOOTHERS.values(), ids=SMOOTHERS)
@pytest.mark.parametrize("n", [3, 6])
def test_squared_errors_agree_with_the_covariances(make, n):
    """NEES on the filter's own model: the mean over independent tracks of one step is within the
    interval of a chi-square with 3 degrees of freedom a track, at 99.9 %.
    """
    reps = 400
    truth, batch, scenario = walks(np.random.default_rng(5), reps=reps, steps=15, n=n, sigma=0.03)
    found = make(UnitVector(), "auto")(batch, scenario, Streams(1, "place", tuple(range(reps))))
    e = (found.position - truth[..., :3])[..., None]
    nees = (e * np.linalg.solve(found.covariance, e)).sum((-1, -2))
    low, high = stats.chi2(3 * reps).ppf([0.0005, 0.9995]) / reps
    assert np.all(
        (nees[:, [0, 7, 14]].mean(axis=0) > low) & (nees[:, [0, 7, 14]].mean(axis=0) < high)
    )


EXACT = {"shift": 1e-6, "permuted": 1e-8, "rotation": 1e-8, "scale": 1e-8}  # m


@pytest.mark.parametrize("law", EXACT)
@pytest.mark.parametrize("h", MODELS.values(), ids=MODELS)
@pytest.mark.parametrize("n", [3, 6])
def test_a_moved_problem_gives_the_moved_track(law, h, n):
    given = laws.problem(n)
    for smoother in (RTSSmoother(EKF(h)), MAPSmoother(h, tolerance=1e-12)):
        before, after = laws.run(smoother, *given), laws.run(smoother, *laws.LAWS[law](*given))
        assert np.abs(laws.BACK[law](after.position) - before.position).max() < EXACT[law]


@pytest.mark.parametrize("engine", ["auto", "numpy"])
def test_steps_after_the_end_of_a_track_change_nothing(engine, rng):
    """NaN after the last step, as where tracks of different lengths are padded."""
    x, P = rng.normal(size=(2, 6, 3)), np.broadcast_to(np.eye(3), (2, 6, 3, 3)).copy()
    F, Q = (each[None, None] for each in Walk().matrices(1))
    belief = Belief(np.zeros((2, 3)), np.eye(3), F, Q)
    short = smoothed(x[:, :4].copy(), P[:, :4].copy(), belief, engine)
    x[0, 4:], P[0, 4:] = np.nan, np.nan
    whole = smoothed(x.copy(), P.copy(), belief, engine)
    assert np.array_equal(whole[0][0, :4], short[0][0])
    assert np.array_equal(whole[1][0, :4], short[1][0])
    assert np.isnan(whole[0][0, 4:]).all()


@pytest.mark.parametrize("make", SMOOTHERS.values(), ids=SMOOTHERS)
def test_replications_do_not_depend_on_each_other(make, rng):
    """Permuted replications give permuted bits."""
    _, batch, scenario = walks(rng, missing=0.3, own=True)
    order = np.array([3, 0, 5, 1, 4, 2])
    known = {n: a[order] for n, a in batch.arrays.items() if a is not None and len(a) == 6}
    anchors = Anchors(
        **{n: a[order] if len(a) == 6 else a for n, a in batch.anchors.arrays.items()}
    )
    one = make(UnitVector(), "auto")(batch, scenario, STREAMS)
    other = make(UnitVector(), "auto")(replace(batch, anchors=anchors, **known), scenario, STREAMS)
    assert np.array_equal(one.position[order], other.position)
    assert np.array_equal(one.covariance[order], other.covariance)


def test_an_iteration_that_does_not_end_is_an_outcome(rng):
    _, batch, scenario = walks(rng)
    found = MAPSmoother(UnitVector(), iterations=1, tolerance=1e-12)(batch, scenario, STREAMS)
    assert np.all(found.outcome == Outcome.OSCILLATED)
    assert np.all(found.reason == Reason.NO_CONVERGENCE)
    assert np.isfinite(found.position).all()


def test_a_track_that_breaks_down_is_an_outcome_and_leaves_the_others_alone(rng):
    _, batch, scenario = walks(rng)
    mean = np.where(np.arange(6)[:, None] == 1, np.inf, batch.prior_mean)
    for make in SMOOTHERS.values():
        whole = make(UnitVector(), "auto")(batch, scenario, STREAMS)
        found = make(UnitVector(), "auto")(replace(batch, prior_mean=mean), scenario, STREAMS)
        assert np.all(found.outcome[1] == Outcome.FAILED)
        rest = [0, 2, 3, 4, 5]
        assert np.array_equal(found.position[rest], whole.position[rest])


def test_a_smoother_needs_a_kalman_filter():
    with pytest.raises(BadValue, match="a Kalman filter"):
        RTSSmoother(ParticleFilter(UnitVector()))


def test_smoothers_are_the_presets_that_are_not_causal():
    names = [n for n in options("filter") if "toa" not in n]
    cell = compose_cells(["noise=vmf", f"filter=[{','.join(names)}]"])[0]
    late = {name for name, estimator in cell.estimators.items() if not estimator.causal}
    assert late == {name for name in names if name.endswith("smoother")}
    kinds = {
        f"{k}_{m}_smoother"
        for k in ("ekf", "ukf")
        for m in ("ae_nominal", "ae_fitted", "ae_adaptive", "vmf")
    }
    assert kinds | {"map_smoother"} <= late


TRACKS = {  # pooled RMSE of the smoother relative to its filter's, at most
    ("square_track", "vmf"): (0.60, 0.55),
    ("square_track_upright", "vmf"): (0.60, 0.55),
    ("square_track_upright", "ae_nominal"): (0.60, 0.55),
    ("square_track_upright", "ae_fitted"): (0.60, 0.55),
    ("square_track_upright", "ae_adaptive"): (0.60, 0.55),
    ("square_track", "ae_nominal"): (0.85, 0.45),
    ("square_track", "ae_fitted"): (0.85, 0.45),
    ("square_track", "ae_adaptive"): (0.85, 0.55),
}


@pytest.mark.parametrize(("track", "model"), TRACKS)
def test_smoothing_on_the_square_track(track, model):
    """Paired: the same draws. RTS cuts the RMSE by more than 40 % where the EKF's linearisation
    holds; around poles in the sides of the square that takes the iterations of the batch smoother.
    """
    names = f"filter=[ekf_{model},ekf_{model}_smoother]"
    cell = compose_cells([f"scenario={track}", "noise=ae_flip", names])[0]
    draws = Draws(cell.scenario, cell.noise, 3)
    ekf, rts = cell.estimators.values()
    most, squares = TRACKS[track, model], []
    for estimator in (ekf, rts, MAPSmoother(ekf.measurement)):
        truth, found = estimate_tile(draws, estimator, 0)
        squares.append(((found.position - truth) ** 2).sum(axis=(1, 2)))
    ratio = [np.sqrt(one.mean() / squares[0].mean()) for one in squares[1:]]
    assert ratio[0] < most[0]
    assert ratio[1] < most[1]
    assert np.mean(squares[1] < squares[0]) > 0.9


def test_anchors_that_move_are_those_of_each_step(rng):
    """A turned anchor frame with angles measured in it, at each step another."""
    truth, batch, scenario = walks(rng)
    turns = np.linalg.qr(rng.normal(size=(1, 40, 5, 3, 3)))[0]
    u = to_unit(batch.azimuth, batch.elevation)
    u = np.einsum("rtbij,rtbj->rtbi", turns @ np.swapaxes(batch.anchors.rotation, -1, -2), u)
    moved = replace(
        batch, azimuth=np.arctan2(u[..., 1], u[..., 0]), elevation=np.arcsin(np.clip(u[..., 2], -1, 1)),
        anchors=replace(batch.anchors, rotation=turns),
    )  # fmt: skip
    for engine in ("auto", "numpy"):
        for make in SMOOTHERS.values():
            one, other = (make(UnitVector(), engine)(b, scenario, STREAMS) for b in (batch, moved))
            assert np.abs(one.position - other.position).max() < 1e-8
