"""EKF and UKF against the exact Kalman filter, against the printed algorithms (errata applied), and
missing data.
"""

from dataclasses import dataclass
from functools import partial

import numpy as np
import pytest

from aoabench.errors import BadValue
from aoabench.filters.gaussian import Gaussian
from aoabench.filters.kalman import EKF, UKF, sigma_points
from aoabench.filters.roots import covariance
from aoabench.maths.linalg import cholesky
from aoabench.models.azel import AzEl, AzElAdaptive
from aoabench.models.unit_vector import UnitVector
from aoabench.noise.angular import FlippedAngles
from aoabench.roles import Measurement, Motion, Scenario
from aoabench.streams import Streams
from aoabench.types import Anchors, Batch, Outcome


@dataclass(frozen=True)
class Linear(Measurement):
    """y = H x + e: a measurement model for which every Kalman filter is exact; azimuth and
    elevation carry y.
    """

    H: tuple
    r: tuple

    def observe(self, batch):
        y = np.concatenate([batch.azimuth, batch.elevation], axis=-1)
        return y, np.broadcast_to(self.r, y.shape)

    def predict(self, x, anchors):
        return x @ np.array(self.H).T

    def residual(self, y, expected):
        return y - expected

    def jacobian(self, x, anchors):
        return np.broadcast_to(np.array(self.H), (*x.shape[:-1], *np.shape(self.H)))

    def covariance(self, x, anchors, quality):
        return quality if x.ndim == 2 else quality[:, None]


@dataclass(frozen=True)
class ConstantVelocity(Motion):
    """A motion model with F != I, in six dimensions."""

    def matrices(self, dt):
        F = np.eye(6)
        F[:3, 3:] = dt * np.eye(3)
        return F, 0.01 * np.eye(6) + 0.02 * F @ F.T


@dataclass(frozen=True)
class Line(Scenario):
    name: str = "line"
    dt: float = 0.5
    motion: object = ConstantVelocity()


ANCHORS = Anchors(np.zeros((1, 1, 3)), np.eye(3)[None, None])


def linear_problem(rng, R=5, T=12, m=8):
    H, r = rng.normal(size=(m, 6)), rng.uniform(0.1, 2.0, m)
    y = rng.normal(size=(R, T, m))
    mean, A = rng.normal(size=(R, 6)), rng.normal(size=(6, 6))
    batch = Batch(
        y[..., : m // 2], y[..., m // 2 :], ANCHORS, prior_mean=mean, prior_cov=A @ A.T + np.eye(6)
    )
    return Linear(tuple(map(tuple, H)), tuple(r)), batch, y


def exact_kalman(h, batch, y, i):
    """The textbook's filter for replication i, in plain loops; missing components are dropped from
    y.
    """
    F, Q = ConstantVelocity().matrices(0.5)
    H, r = np.array(h.H), np.array(h.r)
    x, P = batch.prior_mean[i], batch.prior_cov
    means, covariances = [], []
    for k in range(y.shape[1]):
        x, P = F @ x, F @ P @ F.T + Q
        seen = ~np.isnan(y[i, k])
        Hs = H[seen]
        S = Hs @ P @ Hs.T + np.diag(r[seen])
        K = P @ Hs.T @ np.linalg.inv(S)
        x, P = x + K @ (y[i, k, seen] - Hs @ x), P - K @ S @ K.T
        means.append(x[:3])
        covariances.append(P[:3, :3])
    return np.array(means), np.array(covariances)


FILTERS = [
    EKF,
    UKF,
    lambda h: UKF(h, lambda_=0.0),
    lambda h: UKF(h, form="centre"),
    lambda h: UKF(h, form="augmented"),
]


@pytest.mark.parametrize(
    "make", FILTERS, ids=["ekf", "ukf", "ukf lambda 0", "ukf centre", "ukf augmented"]
)
@pytest.mark.parametrize("missing", [False, True])
def test_linear_model_equals_exact_kalman_filter(make, missing, rng):
    """A P A^T + Q with A != I (erratum N1), S = C P C^T + R (N3), residual u - c (N4); tolerance
    1e-9 relative.
    """
    h, batch, y = linear_problem(rng)
    if missing:
        y[rng.random(y.shape) < 0.3] = np.nan
        y[2, 4] = np.nan  # nothing at all
        batch = Batch(
            y[..., :4], y[..., 4:], ANCHORS, prior_mean=batch.prior_mean, prior_cov=batch.prior_cov
        )
    estimates = make(h)(batch, Line(), Streams(1, "line", tuple(range(5))))
    for i in range(5):
        mean, covariance = exact_kalman(h, batch, y, i)
        assert np.allclose(estimates.position[i], mean, rtol=1e-9, atol=1e-9)
        assert np.allclose(estimates.covariance[i], covariance, rtol=1e-9, atol=1e-9)
    assert np.all(estimates.outcome == Outcome.OK)


def test_printed_covariance_prediction_is_no_covariance():
    """Erratum N1: A^T P A^T, as Algorithms 2 and 3 print it, is not even symmetric when A != I."""
    F, _ = ConstantVelocity().matrices(0.5)
    P = np.diag(np.arange(1.0, 7.0))
    printed, right = F.T @ P @ F.T, F @ P @ F.T
    assert np.allclose(right, right.T)
    assert not np.allclose(printed, printed.T)


def corrected_algorithm_2(h, x, P, y, r, anchors):
    """One EKF update as the paper prints it, with errata N3 and N4 applied, for one replication."""
    C, S = h.jacobian(x[None], anchors)[0], None
    S = C @ P @ C.T + np.diag(r)
    K = P @ C.T @ np.linalg.inv(S)
    return x + K @ h.residual(y, h.predict(x[None], anchors)[0]), P - K @ S @ K.T


def corrected_algorithm_3(h, x, P, y, r, anchors, lambda_=0.5):
    """One UKF update as the paper prints it, with errata N3 to N7 applied, for one replication."""
    n = len(x)
    root = np.linalg.cholesky(P)
    chi = [x] + [x + np.sqrt(n + lambda_) * root[:, i] for i in range(n)]
    chi += [x - np.sqrt(n + lambda_) * root[:, i] for i in range(n)]
    w = [lambda_ / (n + lambda_)] + 2 * n * [0.5 / (n + lambda_)]
    v = [h.predict(c[None], anchors)[0] for c in chi]
    mu = v[0] + sum(wi * h.residual(vi, v[0]) for wi, vi in zip(w, v))
    d = [h.residual(vi, mu) for vi in v]
    S = np.diag(r) + sum(wi * np.outer(di, di) for wi, di in zip(w, d))
    D = sum(wi * np.outer(ci - x, di) for wi, ci, di in zip(w, chi, d))
    K = D @ np.linalg.inv(S)
    return x + K @ h.residual(y, mu), P - K @ S @ K.T


@pytest.mark.parametrize(
    ("make", "slow"),
    [
        (EKF, corrected_algorithm_2),
        (UKF, corrected_algorithm_3),
        (lambda h: UKF(h, lambda_=2.0), partial(corrected_algorithm_3, lambda_=2.0)),
    ],
    ids=["ekf", "ukf", "ukf lambda 2"],
)
@pytest.mark.parametrize(
    "h", [AzEl(sigma_deg=5.0), UnitVector(kappa=100.0)], ids=["azel", "unit vector"]
)
def test_updates_equal_the_printed_algorithms_with_errata(make, slow, h, rng):
    """The small-space form against the printed gain form, tolerance 1e-9."""
    anchors = Anchors(rng.uniform(-5, 5, (1, 4, 3)), np.broadcast_to(np.eye(3), (1, 4, 3, 3)))
    R = 20
    x = rng.uniform(-1, 1, (R, 3)) + [
        8,
        0,
        3,
    ]  # off every pole, where deviations about mu and about v_0 are the same
    A = 0.3 * rng.normal(size=(R, 3, 3))
    P = A @ np.swapaxes(A, 1, 2) + 0.05 * np.eye(3)
    y = h.predict(x + 0.1 * rng.normal(size=(R, 3)), anchors)
    r = np.full(y.shape, np.deg2rad(5) ** 2)
    mean, root, _ = make(h).update(Gaussian(x, cholesky(P)), y, r, anchors)
    for i in range(R):
        m, C = slow(h, x[i], P[i], y[i], r[i], anchors)
        assert np.allclose(mean[i], m, atol=1e-9)
        assert np.allclose(covariance(root[i]), C, atol=1e-9)


@pytest.mark.parametrize("lambda_", [0.0, 0.5, 2.0])
def test_sigma_points_reproduce_mean_and_covariance(lambda_, rng):
    """Errata N5 to N7: 2 n + 1 points around x_{k|k-1}; as printed, chi_2i overwrites points and
    the sum stops early. At lambda = 1/2 all weights are equal, elsewhere the centre has its own.
    """
    A = rng.normal(size=(7, 4, 4))
    P, x = A @ np.swapaxes(A, 1, 2) + np.eye(4), rng.normal(size=(7, 4))
    points, w = sigma_points(x, cholesky(P), lambda_)
    assert points.shape == (7, 9, 4)
    assert w.sum() == pytest.approx(1)
    assert w[0] == pytest.approx(lambda_ / (4 + lambda_), rel=1e-12, abs=0)
    assert np.allclose(w @ points, x, atol=1e-12)
    d = points - x[:, None]
    assert np.allclose(np.swapaxes(d, 1, 2) @ (w[:, None] * d), P, atol=1e-11)
    assert np.allclose(sigma_points(x[:, :3], cholesky(P[:, :3, :3]), 0.5)[1], 1 / 7), (
        "lambda 0.5: equal weights"
    )


def test_printed_sigma_points_lose_mean_and_covariance(rng):
    """Errata N6, N7: chi_{2i} collides with chi_i for even indices, and mu_k over i = 0..2 n_s
    misses points.
    """
    n, lambda_ = 3, 0.5
    spread = np.sqrt(n + lambda_) * np.eye(n)
    chi = {0: np.zeros(n)}
    for i in range(1, n + 1):
        chi[i] = spread[i - 1]
        chi[2 * i] = -spread[i - 1]
    assert len(chi) < 2 * n + 1
    w = 0.5 / (n + lambda_)
    assert not np.allclose(sum(w * np.outer(c, c) for c in chi.values()), np.eye(n))


def test_cholesky_equals_numpys_and_marks_the_rest(rng):
    A = rng.normal(size=(50, 5, 5))
    P = A @ np.swapaxes(A, 1, 2) + 0.1 * np.eye(5)
    assert np.allclose(cholesky(P), np.linalg.cholesky(P), atol=1e-12)
    P[3] = -np.eye(5)
    P[4, 2, 2] = np.nan
    L = cholesky(P)
    assert np.isnan(L[3]).any()
    assert np.isnan(L[4]).any()
    assert np.isfinite(L[[0, 1, 2, 5, 6]]).all()


def test_augmented_and_averaged_forms_agree_where_deviations_are_constant(rng):
    """Both then match moments of the same additive noise; off the poles they agree to third order
    of the spread.
    """
    anchors = Anchors(
        np.array([[[0.0, 0, 0], [9, 0, 0], [0, 9, 0]]]), np.broadcast_to(np.eye(3), (1, 3, 3, 3))
    )
    h = AzEl(sigma_deg=3.0)
    x, P = np.array([[4.0, 5.0, 2.0]]), 1e-4 * np.eye(3)[None]
    y = h.predict(x + 0.01, anchors)
    r = np.full(y.shape, np.deg2rad(3) ** 2)
    a, b = (
        UKF(h, form=form).update(Gaussian(x, cholesky(P)), y, r, anchors)
        for form in ("averaged", "augmented")
    )
    assert np.allclose(a[0], b[0], atol=1e-6)
    assert np.allclose(covariance(a[1]), covariance(b[1]), atol=1e-8)


def test_forms_of_the_adaptive_ukf_differ_near_a_pole():
    h = AzElAdaptive(noise=FlippedAngles(10.0))
    anchors = Anchors(np.zeros((1, 1, 3)), np.eye(3)[None, None])
    x, P = np.array([[0.3, -0.3, -2.0]]), 0.5 * np.eye(3)[None]
    y = np.array([[-np.pi, -9 * np.pi / 20]])
    means = [
        UKF(h, form=form).update(Gaussian(x, cholesky(P)), y, np.ones((1, 2)), anchors).mean
        for form in ("averaged", "centre", "augmented")
    ]
    assert not np.allclose(means[0], means[1], atol=1e-3)
    assert not np.allclose(means[0], means[2], atol=1e-3)


def test_a_replication_that_breaks_down_is_an_outcome_and_leaves_the_others_alone(rng):
    h, batch, y = linear_problem(rng)
    broken = Batch(
        batch.azimuth, batch.elevation, ANCHORS, prior_cov=batch.prior_cov,
        prior_mean=np.where(np.arange(5)[:, None] == 1, np.inf, batch.prior_mean),
    )  # fmt: skip
    for make in FILTERS:
        estimates = make(h)(broken, Line(), Streams(1, "line", tuple(range(5))))
        assert np.all(estimates.outcome[1] == Outcome.FAILED)
        assert np.isnan(estimates.position[1]).all()
        assert np.all(estimates.outcome[[0, 2, 3, 4]] == Outcome.OK)


def test_a_filter_needs_motion_and_prior(rng):
    h, batch, _ = linear_problem(rng)
    with pytest.raises(BadValue, match="motion"):
        EKF(h)(batch, Line(motion=None), Streams(1, "line", (0,)))


@pytest.mark.parametrize(
    ("key", "value"), [("lambda_", -0.1), ("lambda_", float("nan")), ("form", "mean")]
)
def test_bad_parameters_are_named(key, value):
    with pytest.raises(BadValue, match=key):
        UKF(AzEl(), **{key: value})
