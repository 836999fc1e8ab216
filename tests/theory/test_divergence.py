"""When a filter's fix is DIVERGED or FAILED, and why; normalised innovations of both engines; a
predicted mean on an anchor; equal outcomes of both engines.
"""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy import stats

from aoabench.config.compose import compose_cells
from aoabench.engine.draws import Draws
from aoabench.engine.tiles import estimate_tile
from aoabench.filters import divergence as rules
from aoabench.filters import roots
from aoabench.filters.access_nodes import PRINTED, AccessNodeEKF, expected
from aoabench.filters.belief import Belief, believed
from aoabench.filters.kalman import EKF, UKF
from aoabench.filters.particle import ParticleFilter
from aoabench.kernels.limits import NEAREST, ROUNDED
from aoabench.maths.geometry import LIGHT, wrap
from aoabench.models.azel import AzEl, AzElAdaptive
from aoabench.models.motion import RandomWalk
from aoabench.models.unit_vector import UnitVector
from aoabench.noise.angular import FlippedAngles
from aoabench.streams import Streams
from aoabench.types import Anchors, Batch, Outcome, Reason
from tests.helpers import Place

ENGINES = ("auto", "numpy")
CORNERS = np.array([[-1.0, 0, 2], [6, 0.5, 3], [5.5, 5, 2], [-1, 5, 2.5]])
MODELS = {
    "unit_vector": UnitVector(),
    "azel": AzEl(),
    "adaptive": AzElAdaptive(6.0, noise=FlippedAngles(6.0)),
}
MAKERS = {
    "ekf": EKF,
    "ukf": UKF,
    "ukf_centre": lambda h: UKF(h, form="centre"),
    "ukf_augmented": lambda h: UKF(h, form="augmented"),
}
KALMAN = {f"{n} {m}": make(h) for n, make in MAKERS.items() for m, h in MODELS.items()}
NODES = {"times and angles": AccessNodeEKF(), "angles": AccessNodeEKF(toa=False)}
EKFS = {n: f for n, f in {**KALMAN, **NODES}.items() if not isinstance(f, UKF)}


def level(places, sigma=None):
    """Anchors at places (B, 3) m whose frames are the global one."""
    places = np.atleast_2d(np.asarray(places, dtype=float))
    known = None if sigma is None else np.full((1, len(places), 3), sigma)
    return Anchors(places[None], np.tile(np.eye(3), (1, len(places), 1, 1)), known)


def track(anchors, truth, sigma=0.1, prior=1.0, mean=None, seed=1, q=0.5):
    """A batch of angles and times at true positions (R, T, 3) m and a scenario with its motion.

    sigma rad (and 3 sigma m) is the noise, prior m the standard deviation around `mean` (3,), which
    is the start by default.
    """
    rng, (R, T) = np.random.default_rng(seed), truth.shape[:2]
    h, _ = expected(truth.reshape(-1, 3), anchors)
    deviation = sigma * np.array([3.0, 1.0, 1.0])
    y = h.reshape(R, T, -1, 3) + deviation * rng.normal(size=(R, T, anchors.count, 3))
    start = truth[:, 0] + prior * rng.normal(size=(R, 3)) if mean is None else np.tile(mean, (R, 1))
    each = np.ones(y.shape[:3])
    batch = Batch(
        wrap(y[..., 1]), y[..., 2], anchors, delay=y[..., 0] / LIGHT, azimuth_sigma=sigma * each,
        elevation_sigma=sigma * each, delay_sigma=3 * sigma / LIGHT * each, prior_mean=start,
        prior_cov=prior**2 * np.eye(3),
    )  # fmt: skip
    return batch, Place(anchors, motion=RandomWalk(q, q), dt=0.25)


def walk(R, T, start=(2.0, 2.0, 0.5), q=0.25, seed=3):
    """Random walks (R, T, 3) m with deviation q per step, from `start` (3,)."""
    return np.array(start) + q * np.random.default_rng(seed).normal(size=(R, T, 3)).cumsum(axis=1)


def run(method, batch, scenario, engine="auto"):
    streams = Streams(1, "place", tuple(range(len(batch.azimuth))))
    return replace(method, engine=engine)(batch, scenario, streams)


# --- the rules ------------------------------------------------------------------------------------


def far_by_definition(x, places, mean, P, factor):
    """The definition for one position (3,), in plain Python."""
    centre = sum(places) / len(places)
    spread = max(np.linalg.norm(s - centre) for s in places)
    extent = max(spread, np.linalg.norm(mean - centre) + np.sqrt(P[0, 0] + P[1, 1] + P[2, 2]))
    return extent > 0 and np.linalg.norm(x - centre) > factor * extent


@pytest.mark.parametrize("B", [1, 4])
@pytest.mark.parametrize("moving", [False, True])
def test_too_far_is_its_definition_for_moving_anchors_and_one(B, moving, rng):
    """Shift, rotation and change of the unit of length leave it as it is."""
    R, T = 6, 40
    places = 5 * rng.normal(size=(R if moving else 1, T if moving else 1, B, 3))
    A = rng.normal(size=(3, 3))
    belief = Belief(rng.normal(size=(R, 3)), A @ A.T, np.eye(3), np.eye(3))
    x = 30 * rng.normal(size=(R, T, 3)) ** 3
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]

    def judged(scale=1.0, shift=0.0):
        at = scale * places @ turn + shift if scale != 1 or np.any(shift) else places
        anchors = Anchors(at, np.tile(np.eye(3), (1, 1, B, 1, 1)))
        if at is places:
            return rules.too_far(x, anchors, belief, 10.0)
        mean, P = scale * belief.mean @ turn + shift, scale**2 * turn.T @ belief.covariance @ turn
        known = belief._replace(mean=mean, covariance=P)
        return rules.too_far(scale * x @ turn + shift, anchors, known, 10.0)

    found = judged()
    wide = np.broadcast_to(places, (R, T, B, 3))
    wanted = [
        [far_by_definition(x[r, k], wide[r, k], belief.mean[r], A @ A.T, 10.0) for k in range(T)]
        for r in range(R)
    ]
    assert np.array_equal(found, wanted)
    assert 0.05 < found.mean() < 0.95
    assert np.array_equal(judged(0.001, np.array([500.0, 5000.0, 0.1])), found)


def test_places_that_are_not_known_have_no_part_in_the_extent():
    places = np.array([[0.0, 0, 0], [2, 0, 0], [np.nan] * 3])
    belief = Belief(np.array([[1.0, 0, 0]]), np.zeros((3, 3)), np.eye(3), np.eye(3))
    x = np.array([[[10.9, 0, 0], [11.1, 0, 0], [np.nan] * 3]])
    assert rules.too_far(x, level(places), belief, 10.0).tolist() == [[False, True, False]]
    assert not rules.too_far(x, level(places[2:]), belief, 10.0).any()
    alone = level([[1.0, 0, 0]])  # the prior is exact and on the anchor: no length is known
    assert not rules.too_far(x, alone, belief, 10.0).any()


def test_a_run_of_innovations_by_counting(rng):
    """The fifth and later measured steps of a run, unmeasured ones left out, against a plain loop."""
    measured = rng.integers(0, 4, (200, 60))
    nis = rng.choice([0.0, 40.0, 60.0, np.nan], (200, 60), p=[0.1, 0.1, 0.75, 0.05])
    found = rules.inconsistent(nis, measured, 1e-9, 5)
    wanted = np.zeros_like(found)
    for r, k in np.ndindex(nis.shape):
        if k == 0:
            run_ = 0
        if measured[r, k]:
            run_ = run_ + 1 if nis[r, k] > stats.chi2.isf(1e-9, measured[r, k]) else 0
            wanted[r, k] = run_ >= 5
    assert np.array_equal(found, wanted)
    assert 0.02 < found.mean() < 0.9


def test_the_limit_is_the_quantile():
    for dof in (1, 2, 3, 12, 321):
        at = stats.chi2.isf(1e-9, dof)
        given = np.array([[at * (1 - 1e-9)], [at * (1 + 1e-9)]])
        found = rules.inconsistent(given, np.full((2, 1), dof), 1e-9, 1)
        assert found.tolist() == [[False], [True]]


def test_degenerate_covariances(rng):
    """Zero, of rank 1 and 2, indefinite; not a slim one, nor one in another unit."""
    A = rng.normal(size=(3, 3))
    slim = np.diag([1.0, 1e-14, 1e-8])
    sound = [A @ A.T, 1e-30 * A @ A.T, slim, 1e12 * np.eye(3)]
    bad = [0 * slim, np.diag([1.0, 0, 1]), np.diag([1.0, 1, -1e-9]), -np.eye(3)]
    bad += [np.array([[1.0, 2, 0], [2, 1, 0], [0, 0, 1]])]
    assert not rules.degenerate(np.array(sound)).any()
    assert rules.degenerate(np.array(bad)).all()
    flat = [A[:, :k] @ A[:, :k].T for k in (1, 2)]
    single = np.array([*flat, *sound]).astype(np.float32).astype(float)
    assert rules.degenerate(single, rules.SINGULAR).tolist() == 2 * [True] + 4 * [False]
    assert not rules.degenerate(np.full((2, 3, 3), np.nan)).any()


def test_numbers_that_are_not_finite():
    x, P = np.zeros((1, 3, 3)), np.tile(np.eye(3), (1, 3, 1, 1))
    x[0, 1, 2], P[0, 2, 1, 1] = np.nan, np.inf
    found = rules.sound(x, P)
    assert found.outcome.tolist() == [[Outcome.OK, Outcome.FAILED, Outcome.FAILED]]
    assert found.reason.tolist() == [[Reason.NONE, Reason.NOT_A_NUMBER, Reason.UNDETERMINED]]
    assert np.isnan(found.position[0, 1:]).all()


# --- normalised innovations -----------------------------------------------------------------------


@pytest.mark.parametrize("sigma", [0.1, 1e-3])
@pytest.mark.parametrize("B", [1, 4])
@pytest.mark.parametrize("name", KALMAN)
def test_innovations_of_both_engines(name, B, sigma):
    """v^T S^-1 v with S = f^T f + R; rounding is ROUNDED times the sum of v^2 / r, and as much of
    the result is left out.
    """
    method, anchors = KALMAN[name], level(CORNERS[:B])
    batch, scenario = track(anchors, walk(70, 1), sigma, prior=0.5)
    batch.azimuth[5, 0, B - 1] = np.nan
    belief, (Y, quality) = believed(batch, scenario), method.measurement.observe(batch)
    root = np.tile(roots.prior_root(belief.covariance), (70, 1, 1))
    F, Q = belief.at(0)
    L = roots.predicted(root, F, Q)
    given = belief.mean @ F.T, L, Y[:, 0], quality[:, 0], anchors
    _, f, v, r = method.innovation(*given)
    own = method.measurement.covariance(given[0], anchors, quality[:, 0])  # with the noise in f
    for engine in ENGINES:
        found = replace(method, engine=engine).filtered(batch, belief).nis[:, 0]
        for i in range(70):
            seen = np.isfinite(v[i])
            S = f[i][:, seen].T @ f[i][:, seen] + np.diag(r[i, seen])
            e = v[i, seen]
            exact = e @ np.linalg.solve(S, e)
            rounded = 1e-15 * np.linalg.cond(S) * exact
            weight = (e**2 / own[i, seen]).sum()
            assert abs(found[i] - exact) <= 2 * ROUNDED * weight + 1e-12 * exact + rounded


@pytest.mark.parametrize("printed", [(), ("shared",), ("shared", "cross"), ("cross", "wrap")])
@pytest.mark.parametrize("name", NODES)
def test_innovations_at_access_nodes(name, printed):
    """v^T S^-1 v with S = H P H^T + R, R with the nodes' own or with one common error."""
    anchors, sigma = level(CORNERS, 0.4), 0.05
    batch, scenario = track(anchors, walk(9, 1), sigma, prior=0.5)
    batch.delay[3, 0, 1] = batch.azimuth[3, 0, 2] = np.nan
    method = replace(NODES[name], as_printed=printed)
    belief, measured = believed(batch, scenario), method.measured(batch)
    F, Q = belief.at(0)
    P = F @ belief.covariance @ F.T + Q
    h, H = expected(belief.mean, anchors)
    v = measured[0][:, 0] - h
    v[..., 1] = wrap(v[..., 1])
    for engine in ENGINES:
        found = replace(method, engine=engine).filtered(batch, belief).nis[:, 0]
        for i in range(9):
            rows = [(b, c) for b, c in np.ndindex(4, 3) if np.isfinite(v[i, b, c])]
            G = np.array([H[i, b, c] for b, c in rows])
            S = G @ P @ G.T + np.diag([measured[1][i, 0, b, c] for b, c in rows])
            for (m, (a, c)), (n, (b, d)) in product(enumerate(rows), enumerate(rows)):
                together = ("shared" in printed or a == b) and not (
                    "cross" in printed and (c == 0) != (d == 0)
                )
                S[m, n] += 0.16 * G[m] @ G[n] if together else 0.0
            e = np.array([v[i, b, c] for b, c in rows])
            assert found[i] == pytest.approx(e @ np.linalg.solve(S, e), rel=1e-8, abs=0)
    assert set(printed) <= set(PRINTED)


@pytest.mark.parametrize("name", ["ekf unit_vector", "ukf azel", "times and angles"])
def test_a_filter_that_matches_its_measurements_is_never_marked(name):
    """2000 replications of 40 steps far from anchors and poles, where the models are nearly linear.

    An innovation then exceeds its bound with a probability of 1e-9 at a step, and at five running
    with 1e-45. The false-alarm rate over 80 000 steps is 1e-40, and 1e-20 if nonlinearity raises
    the probability of a step to 1e-5.
    """
    method = {**KALMAN, **NODES}[name]
    truth = walk(2000, 40, start=(12.0, 12.0, 2.0))
    batch, scenario = track(level(5 * CORNERS), truth, 0.02, prior=0.1)
    found = run(method, batch, scenario)
    assert np.all(found.outcome == Outcome.OK)
    assert np.all(found.reason == Reason.NONE)
    tight = run(replace(method, innovation_tail=0.1, innovation_steps=1), batch, scenario)
    assert 0.001 < (tight.reason == Reason.INNOVATIONS).mean() < 0.2


def test_the_ukf_at_kappa_1e12_is_diverged():
    words = ["scenario=square_track", "noise=vmf", "noise.kappa=1e12", "filter=[ukf_ae_nominal]"]
    cell = compose_cells(words)[0]
    method = cell.estimators["ukf_ae_nominal"]
    truth, found = estimate_tile(Draws(cell.scenario, cell.noise, cell.seed), method, 0)
    error = np.linalg.norm(found.position - truth[..., :3], axis=-1)
    lost = error.max(axis=1) > 100
    assert lost.mean() > 0.05
    assert np.all(found.outcome[error > 100] == Outcome.DIVERGED)
    assert np.all((found.outcome == Outcome.DIVERGED).any(axis=1)[lost])
    assert set(np.unique(found.reason)) <= {Reason.NONE, Reason.TOO_FAR, Reason.INNOVATIONS}
    assert np.isfinite(found.position).all()


# --- particle filters -----------------------------------------------------------------------------


@pytest.mark.parametrize("engine", ["auto", "numpy", "double"])
def test_a_cloud_of_one_particle_is_diverged(engine):
    batch, scenario = track(level(CORNERS), walk(2, 6), 1e-5, prior=1.0)
    found = run(ParticleFilter(AzEl(), 50), batch, scenario, engine)
    assert (found.reason == Reason.COVARIANCE).mean() > 0.5
    assert np.isfinite(found.position).all()
    wide = run(ParticleFilter(AzEl(), 500), *track(level(CORNERS), walk(2, 6), 0.5), engine)
    assert np.all(wide.outcome == Outcome.OK)


@pytest.mark.parametrize("engine", ["auto", "numpy", "double"])
def test_particles_far_from_the_anchors_are_diverged(engine):
    batch, scenario = track(level(CORNERS), walk(2, 6), 0.5)
    found = run(ParticleFilter(AzEl(), 500, extent_factor=0.01), batch, scenario, engine)
    assert np.all(found.reason == Reason.TOO_FAR)


# --- a predicted mean on an anchor ----------------------------------------------------------------


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("off", [0.0, 1e-12, 1e-5])
@pytest.mark.parametrize("name", EKFS)
def test_a_start_on_an_anchor_leaves_out_that_anchor(name, off, engine):
    """The first step equals that of the other anchors alone, and the track recovers."""
    truth = walk(3, 30, start=(1.0, 1.0, 1.5), q=0.05)
    mean = CORNERS[0] + [0, off, 0]
    batch, scenario = track(level(CORNERS), truth, 0.05, prior=2.0, mean=mean, q=0.1)
    found = run(EKFS[name], batch, scenario, engine)
    without = {n: getattr(batch, n).copy() for n in ("azimuth", "elevation", "delay")}
    for value in without.values():
        value[:, 0, 0] = np.nan
    other = run(EKFS[name], replace(batch, **without), scenario, engine)
    assert np.allclose(found.position, other.position, rtol=0, atol=1e-9)
    assert np.allclose(found.covariance, other.covariance, rtol=0, atol=1e-9)
    assert np.all(found.outcome == Outcome.OK)
    assert np.linalg.norm((found.position - truth)[:, -1], axis=-1).max() < 1.0
    assert np.linalg.eigvalsh(found.covariance).min() > 0


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("name", EKFS)
def test_the_only_anchor_on_the_start_gives_the_prior(name, engine):
    batch, scenario = track(level(CORNERS[:1]), walk(3, 4), prior=2.0, mean=CORNERS[0])
    found = run(EKFS[name], batch, scenario, engine)
    F, Q = scenario.motion.matrices(scenario.dt)
    assert np.allclose(found.position, CORNERS[0], rtol=0, atol=1e-12)
    for k in range(4):
        assert np.allclose(
            found.covariance[:, k], batch.prior_cov + (k + 1) * Q, rtol=1e-12, atol=0
        )


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("name", EKFS)
def test_an_anchor_just_outside_the_limit_is_used(name, engine):
    """The limit is NEAREST standard deviations, which the root of the trace defines."""
    _, scenario = track(level(CORNERS), walk(1, 1))
    deviation = np.sqrt(np.trace(4 * np.eye(3) + scenario.motion.matrices(scenario.dt)[1]))
    for share, used in ((0.999, False), (1.001, True)):
        mean = CORNERS[0] + [0, share * NEAREST * deviation, 0]
        batch, scenario = track(level(CORNERS[:1]), walk(1, 1), prior=2.0, mean=mean)
        found = run(EKFS[name], batch, scenario, engine)
        assert (np.linalg.norm(found.position[0, 0] - mean) > 1e-6) == used


@pytest.mark.parametrize("engine", [*ENGINES, "double"])
@pytest.mark.parametrize("model", MODELS)
def test_other_filters_need_no_rule_on_an_anchor(model, engine):
    """Sigma points and particles lie around the anchor: finite numbers, and the track recovers."""
    truth = walk(3, 30, start=(1.0, 1.0, 1.5), q=0.05)
    batch, scenario = track(level(CORNERS), truth, 0.1, prior=2.0, mean=CORNERS[0], q=0.1)
    methods = [ParticleFilter(MODELS[model], 2000)]
    methods += [] if engine == "double" else [make(MODELS[model]) for make in MAKERS.values()][1:]
    for method in methods:
        found = run(method, batch, scenario, engine)
        assert np.all(found.outcome[:, 5:] == Outcome.OK)
        assert np.linalg.norm((found.position - truth)[:, -1], axis=-1).max() < 1.5


# --- equal outcomes of both engines ---------------------------------------------------------------


def nasty():
    """Tracks by name: batch and scenario."""
    line = level([[x, 0.0, 0.0] for x in (-4.0, 0.0, 3.0, 7.0)])
    still, near_by = np.tile([1.0, 0, 0], (3, 12, 1)), walk(3, 12)
    rows = {
        "on the line of all anchors": track(line, still, mean=[1.5, 0, 0]),
        "on that line, exactly": track(line, still, 1e-8, mean=[1.5, 0, 0]),
        "on the end of that line": track(line, still + [6.0, 0, 0], mean=[7.0, 0, 0]),
        "one anchor": track(level(CORNERS[:1]), near_by),
        "one anchor, exactly": track(level(CORNERS[:1]), near_by, 1e-9),
        "two anchors in one place": track(level(CORNERS[[0, 0]]), near_by),
        "all anchors in one place": track(level(CORNERS[[1, 1, 1, 1]]), near_by, 1e-6),
        "beneath an anchor": track(level([[1.0, 0, 3], *CORNERS]), still, mean=[1.0, 0, 0]),
        "start on an anchor": track(level(CORNERS), near_by, prior=3.0, mean=CORNERS[2]),
        "far from a sure start": track(level(CORNERS), near_by, 0.01, prior=0.01, mean=[9, 9, 9]),
        "a start a kilometre away": track(level(CORNERS), near_by, 0.05, 1e3, [600.0, 700, 300]),
        "exact": track(level(CORNERS), near_by, 1e-10),
        "vague": track(level(CORNERS), near_by, 1e3),
        "a start that is not finite": track(level(CORNERS), near_by, mean=[np.inf, 0, 0]),
        "a start that is not a number": track(level(CORNERS), near_by, mean=[0, np.nan, 0]),
    }
    batch, scenario = track(level(CORNERS), near_by)
    for name, wrong in (("an indefinite", np.diag([-9.0, 1, 1])), ("an infinite", np.inf)):
        rows[f"{name} prior"] = replace(batch, prior_cov=wrong * np.ones((3, 3))), scenario
    nothing = {n: np.full_like(batch.azimuth, np.nan) for n in ("azimuth", "elevation", "delay")}
    rows["no measurement at all"] = replace(batch, **nothing), scenario
    rows["azimuths alone"] = replace(batch, elevation=nothing["azimuth"]), scenario
    for name, sigma in (
        ("tiny", 1e-12), ("huge", 1e9), ("zero", 0.0), ("infinite", np.inf), ("senseless", 1e-160),
    ):  # fmt: skip
        one = batch.azimuth_sigma.copy()
        one[:, ::2, 1] = sigma
        stated = {"azimuth_sigma": one, "elevation_sigma": one}
        rows[f"{name} variances among others"] = replace(batch, **stated), scenario
        each = np.full_like(one, sigma)
        stated = {"azimuth_sigma": each, "elevation_sigma": each}
        rows[f"{name} variances alone"] = replace(batch, **stated), scenario
    return rows


NASTY = nasty()
OUTCOMES = {  # what any filter must say
    "a start that is not finite": (Outcome.FAILED, Reason.NOT_A_NUMBER),
    "a start that is not a number": (Outcome.FAILED, Reason.NOT_A_NUMBER),
    "no measurement at all": (Outcome.OK, Reason.NONE),
}


@pytest.mark.parametrize("case", NASTY)
def test_both_engines_say_the_same_of_nasty_tracks(case):
    batch, scenario = NASTY[case]
    for name, method in {**KALMAN, **NODES}.items():
        fast, slow = (run(method, batch, scenario, engine) for engine in ENGINES)
        assert np.array_equal(fast.outcome, slow.outcome), name
        assert np.array_equal(fast.reason, slow.reason), name
        if case in OUTCOMES:
            assert np.all(fast.outcome == OUTCOMES[case][0]), name
            assert np.all(fast.reason == OUTCOMES[case][1]), name


@pytest.mark.parametrize("case", [c for c in NASTY if not c.endswith("prior")])  # is none
def test_particle_filters_say_the_same_in_either_precision(case):
    batch, scenario = NASTY[case]
    for model, h in MODELS.items():
        method = ParticleFilter(h, 300)
        fast, slow = (run(method, batch, scenario, engine) for engine in ("auto", "double"))
        assert np.array_equal(fast.outcome, slow.outcome), model
        assert np.array_equal(fast.reason, slow.reason), model


def test_a_wrong_stated_precision_is_told_by_innovations():
    """Stated 100 times too exact: NIS is some 1e4 times too large from the first step on."""
    batch, scenario = track(level(CORNERS), walk(4, 12), 0.1)
    small = dict.fromkeys(("azimuth_sigma", "elevation_sigma"), batch.azimuth_sigma / 100)
    for name in ("ekf unit_vector", "ekf azel", "ukf azel", "angles"):
        found = run({**KALMAN, **NODES}[name], replace(batch, **small), scenario)
        assert np.all(found.reason[:, 4:] == Reason.INNOVATIONS), name
        assert np.all(found.outcome[:, :4] == Outcome.OK), name
