"""The compiled Kalman filters against those in NumPy, which are tested against the exact ones."""

import re
from dataclasses import replace

import numpy as np
import pytest

from aoabench.filters.belief import believed
from aoabench.filters.compiled import KINDS
from aoabench.filters.kalman import EKF, UKF
from aoabench.kernels.loading import load
from aoabench.maths.places import at_places, numbers_of
from aoabench.models.azel import AzEl, AzElAdaptive
from aoabench.models.unit_vector import UnitVector
from aoabench.noise.angular import FlippedAngles
from aoabench.roles import Scenario
from aoabench.streams import Streams
from aoabench.types import Anchors, Batch, Outcome
from tests.theory.assembly import assembly
from tests.theory.rounding import equal_but_for_rounding, moved_by_rounding

numba = pytest.importorskip("numba")
MODELS = [UnitVector(30.0), AzEl(12.0), AzElAdaptive(12.0, noise=FlippedAngles(12.0))]
STATED = [UnitVector(), AzEl(), MODELS[2]]
KALMAN = [EKF, UKF, lambda h: UKF(h, 0.7, "centre"), lambda h: UKF(h, 0.7, "augmented")]
FORMS = ["ekf", "ukf", "ukf_centre", "ukf_augmented"]


def test_angles_to_the_last_bits():
    angles = load("kernels.angles")
    K_angle, K_direction = angles.angle, angles.direction_angle

    @numba.njit
    def over(y, x, out):
        for i in range(len(y)):
            out[0, i] = K_angle(y[i], x[i], np.sqrt(x[i] * x[i] + y[i] * y[i]))
            out[1, i] = K_direction(y[i], x[i])

    rng = np.random.default_rng(1)
    eighths = np.pi / 8 * np.arange(-8, 9)
    turn = np.concatenate([np.linspace(-np.pi, np.pi, 200_001), eighths, eighths + 1e-15])
    size = 10 ** rng.uniform(-8, 8, len(turn))
    x, y, out = size * np.cos(turn), size * np.sin(turn), np.empty((2, len(turn)))
    over(y, x, out)
    exact = np.arctan2(y, x)
    assert np.all(np.abs(out - exact) <= 1e-15 * np.abs(exact))
    over(np.array([0.0, np.nan, 1.0]), np.array([0.0, 1.0, np.nan]), out)
    assert np.all(out[:, 0] == 0)
    assert np.isnan(out[:, 1:3]).all()


class Moving(Scenario):
    """A state of three or six dimensions in free motion."""

    name, dt = "moving", 0.5

    def __init__(self, n):
        F, Q = np.eye(n), 0.1 * np.eye(n) + 0.02
        F[:3, 3:] = self.dt * np.eye(3)[:, : n - 3]

        class motion:
            @staticmethod
            def matrices(dt):
                return F, Q

        self.motion = motion


@pytest.fixture
def batch_of(rng):
    def make(R, B, n, own_anchors, missing):
        A = R if own_anchors else 1
        anchors = Anchors(
            rng.uniform(-5, 5, (A, B, 3)), np.linalg.qr(rng.normal(size=(A, B, 3, 3)))[0]
        )
        angles = AzEl(1.0).predict(rng.normal(size=(R, 7, 3)), anchors).reshape(R, 7, B, 2)
        angles = angles + 0.1 * rng.normal(size=angles.shape)
        if missing:
            angles[rng.random(angles.shape) < 0.3] = np.nan
        return Batch(
            angles[..., 0],
            angles[..., 1],
            anchors,
            prior_mean=rng.normal(size=(R, n)),
            prior_cov=np.eye(n) + 0.3,
        )

    return make


@pytest.mark.parametrize("h", MODELS, ids=KINDS)
@pytest.mark.parametrize("make", KALMAN, ids=FORMS)
@pytest.mark.parametrize(
    ("R", "B", "n", "own_anchors", "missing"),
    [
        (1, 1, 3, False, False),
        (5, 4, 3, True, True),
        (64, 2, 6, False, True),
        (130, 5, 3, False, False),
        (70, 3, 6, True, False),
    ],
)
def test_equal_those_in_numpy(h, make, R, B, n, own_anchors, missing, batch_of):
    """Any number of replications, anchors and state dimensions."""
    batch, f = batch_of(R, B, n, own_anchors, missing), make(h)
    streams = Streams(1, "moving", tuple(range(R)))
    fast, slow = (
        replace(f, engine=engine)(batch, Moving(n), streams) for engine in ("auto", "numpy")
    )
    assert f.kind() is not None
    equal_but_for_rounding(fast, slow, moved_by_rounding(lambda b: f(b, Moving(n), streams), batch))
    assert np.array_equal(fast.outcome, slow.outcome)


@pytest.mark.parametrize("h", STATED, ids=KINDS)
@pytest.mark.parametrize("make", KALMAN, ids=FORMS)
@pytest.mark.parametrize("own", ["none", "positions", "both"])
def test_anchors_that_differ_from_step_to_step(h, make, own, batch_of, rng):
    """Positions alone or rotations too, the same or other ones in each replication; deviations that
    the measurements state, some of them senseless.
    """
    R, B, f = 70, 3, make(h)
    batch = batch_of(R, B, 3, False, True)
    s = batch.anchors.position + rng.normal(size=(R if own != "none" else 1, 7, B, 3))
    turns = np.linalg.qr(rng.normal(size=(R, 7, B, 3, 3)))[0]
    anchors = Anchors(s, turns if own == "both" else batch.anchors.rotation)
    sigma = rng.choice(
        [0.02, 0.1, 0.4, 0.0, np.inf, np.nan], (2, R, 7, B), p=[0.3, 0.3, 0.3, 0.04, 0.03, 0.03]
    )
    given = replace(batch, anchors=anchors, azimuth_sigma=sigma[0], elevation_sigma=sigma[1])
    streams = Streams(1, "moving", tuple(range(R)))
    assert anchors.moving
    assert f.compiled(anchors) is not None
    fast, slow = (replace(f, engine=e)(given, Moving(3), streams) for e in ("auto", "numpy"))
    moved = moved_by_rounding(lambda b: f(b, Moving(3), streams), given)
    equal_but_for_rounding(fast, slow, moved)
    assert np.array_equal(fast.outcome, slow.outcome)


@pytest.mark.parametrize("make", KALMAN[:3], ids=FORMS[:3])
@pytest.mark.parametrize("h", STATED, ids=KINDS)
def test_batches_of_the_anchors_heard(h, make, batch_of, rng):
    """The bits of the batch of all anchors, whichever tile a replication stands in."""
    R, B, f = 70, 6, make(h)
    batch = batch_of(R, B, 3, True, False)
    heard = rng.random((7, B)) < 0.4
    heard[0], heard[1] = False, np.arange(B) < 3
    numbers = numbers_of(heard)[None]
    hidden = {
        name: np.where(heard, getattr(batch, name), np.nan) for name in ("azimuth", "elevation")
    }
    sigma = rng.uniform(0.05, 0.2, (R, 7, B))
    whole = replace(batch, **hidden, azimuth_sigma=sigma, elevation_sigma=sigma)
    empty = {"position": np.zeros(3), "rotation": np.eye(3)}
    few = Anchors(**{
        name: at_places(array, numbers, empty[name]) for name, array in batch.anchors.arrays.items()
    })  # fmt: skip
    names = ("azimuth", "elevation", "azimuth_sigma", "elevation_sigma")
    places = {name: at_places(getattr(whole, name), numbers, np.nan) for name in names}
    compact = replace(whole, anchors=few, anchor_id=numbers, **places)
    assert f.heard_only
    belief = believed(whole, Moving(3))
    dense, found = f.filtered(whole, belief), f.filtered(compact, belief)
    part = f.filtered(compact.of(69), belief._replace(mean=belief.mean[69:]))
    for a, b, c in zip(dense, found, part):
        assert np.array_equal(a, b)
        assert np.array_equal(b[69:], c)
    assert np.array_equal(dense.measured[:, 0], np.zeros(R))
    assert not UKF(h, form="augmented").heard_only


@pytest.mark.parametrize("make", [EKF, UKF])
def test_a_replication_that_breaks_fails_alone(make, batch_of):
    batch = batch_of(70, 4, 3, False, False)
    prior = batch.prior_mean.copy()
    prior[3] = np.inf
    streams = Streams(1, "moving", tuple(range(70)))
    found, whole = (
        make(AzEl(10.0))(b, Moving(3), streams) for b in (replace(batch, prior_mean=prior), batch)
    )
    assert np.all(found.outcome[3] == Outcome.FAILED)
    others = np.arange(70) != 3
    assert np.array_equal(found.position[others], whole.position[others])


@pytest.mark.parametrize("make", [EKF, UKF])
@pytest.mark.parametrize("sigma_deg", [1e-4, 0.01, 100.0])
def test_covariances_stay_positive_for_any_noise(make, sigma_deg, batch_of):
    batch = batch_of(64, 4, 3, False, False)
    P = make(AzEl(sigma_deg))(batch, Moving(3), Streams(1, "moving", tuple(range(64)))).covariance
    assert np.all(np.linalg.eigvalsh(P[np.isfinite(P).all((-1, -2))]) > 0)


def test_other_models_run_in_numpy():
    class Own(AzEl):
        pass

    assert EKF(Own(10.0)).kind() is None


@pytest.mark.parametrize(
    ("name", "least"), [("kalman.ekf", 0.8), ("access_nodes.ekf", 2.0), ("centroid.centroid", 5.0)]
)
def test_the_machine_code_is_vectorised(name, least, tmp_path):
    """Loops over replications work on whole vector registers and call no mathematical library. No
    message is formed: numba compiles one, in seconds, with an assignment of array to array.
    """
    text = assembly([name], tmp_path)[name.split(".")[1]]
    arithmetic = r"\bv(?:f?n?m(?:add|sub)\w*|add|sub|mul|div|sqrt)"
    packed = len(re.findall(arithmetic + r"pd\s.*%[yz]mm", text))
    assert packed >= least * len(re.findall(arithmetic + r"sd\s", text)) > 0
    assert not re.search(r"\$(?:atan2?|sqrt|rint|sin|cos|exp)\b", text)
    assert "unicode" not in text
