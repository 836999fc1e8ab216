"""The compiled Kalman filters against those in NumPy, which are tested against the exact ones."""

import re
from dataclasses import replace

import numpy as np
import pytest

from aoabench.filters.compiled import KINDS
from aoabench.filters.kalman import EKF, UKF
from aoabench.kernels.loading import load
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


def test_angles_to_the_last_bits():
    @numba.njit
    def over(y, x, out):
        for i in range(len(y)):
            out[i] = K_angle(y[i], x[i], np.sqrt(x[i] * x[i] + y[i] * y[i]))

    K_angle = load("kernels.angles").angle
    rng = np.random.default_rng(1)
    turn = np.concatenate([np.linspace(-np.pi, np.pi, 200_001), np.pi / 4 * np.arange(-4, 5)])
    size = 10 ** rng.uniform(-8, 8, len(turn))
    x, y, out = size * np.cos(turn), size * np.sin(turn), np.empty(len(turn))
    over(y, x, out)
    exact = np.arctan2(y, x)
    assert np.all(np.abs(out - exact) <= 1e-15 * np.abs(exact))
    zero = np.zeros(1)
    over(zero, zero, out[:1])
    assert out[0] == 0


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
@pytest.mark.parametrize(
    "make", [EKF, UKF, lambda h: UKF(h, 0.7, "centre")], ids=["ekf", "ukf", "ukf_centre"]
)
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


def test_the_augmented_form_and_other_models_run_in_numpy():
    assert UKF(AzEl(10.0), form="augmented").kind() is None

    class Own(AzEl):
        pass

    assert EKF(Own(10.0)).kind() is None


@pytest.mark.parametrize(("module", "least"), [("kalman", 0.8), ("access_nodes", 2.0)])
def test_the_machine_code_is_vectorised(module, least, tmp_path):
    """Loops over replications work on whole vector registers and call no mathematical library."""
    text = assembly([f"{module}.ekf"], tmp_path)["ekf"]
    arithmetic = r"\bv(?:f?n?m(?:add|sub)\w*|add|sub|mul|div|sqrt)"
    packed = len(re.findall(arithmetic + r"pd\s.*%[yz]mm", text))
    assert packed >= least * len(re.findall(arithmetic + r"sd\s", text)) > 0
    assert not re.search(r"\$(?:atan2?|sqrt|rint|sin|cos|exp)\b", text)
