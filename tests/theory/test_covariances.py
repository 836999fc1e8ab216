"""Covariances of the Kalman filters: symmetric to the bit and positive definite in exact arithmetic,
however exact the measurements, long the walk, vague the prior or few the anchors; and the right ones.
"""

from dataclasses import replace
from fractions import Fraction

import mpmath
import numpy as np
import pytest

from aoabench.filters import access_nodes as an
from aoabench.filters.kalman import EKF, UKF, sigma_points
from aoabench.filters.roots import EPS, prior_root
from aoabench.maths.geometry import LIGHT, facing, wrap
from aoabench.models.azel import AzEl, AzElAdaptive
from aoabench.models.motion import ConstantAcceleration, RandomWalk
from aoabench.models.unit_vector import UnitVector
from aoabench.noise.angular import FlippedAngles
from aoabench.types import Anchors, Batch, Outcome, Reason
from tests.helpers import Place

ENGINES = ("auto", "numpy")
CORNERS = np.array([[-1.0, 0, 2], [6, 0.5, 3], [5.5, 5, 2], [-1, 5, 2.5]])


def positive(P):
    """Whether P (N, 3, 3) are positive definite: in exact arithmetic wherever rounding could decide.

    All leading minors are positive. An eigenvalue of a correlation matrix above 1e-12 needs no more:
    it is computed to some 1e-15.
    """
    d = np.sqrt(np.diagonal(P, axis1=-2, axis2=-1))
    sure = np.linalg.eigvalsh(P / (d[:, :, None] * d[:, None, :]))[:, 0] > 1e-12

    def exactly(A):
        (a, b, c), (_, d, e), (_, _, f) = [[Fraction(float(v)) for v in row] for row in A]
        return (
            a > 0 and a * d > b * b and a * (d * f - e * e) + 2 * b * c * e > b * b * f + c * c * d
        )

    return np.array([s or exactly(A) for s, A in zip(sure, P)])


def check(estimates):
    """Every fix has a position, and its covariance is symmetric, positive definite and of use to
    others, also where innovations say that linearisation is not as exact as the measurements.
    """
    assert not np.any(estimates.outcome == Outcome.FAILED)
    assert not np.any(estimates.reason == Reason.COVARIANCE)
    P = estimates.covariance.reshape(-1, 3, 3)
    assert np.array_equal(P, np.swapaxes(P, -1, -2))
    assert positive(P).all()
    np.linalg.cholesky(P)  # raises where it finds none


def test_positive_is_exact():
    """A singular matrix, one step of a double above it and one below it."""
    P = np.array([[1.0, 1, 0], [1, 1, 0], [0, 0, 1]])
    above, below = P.copy(), P.copy()
    above[1, 1], below[1, 1] = np.nextafter(1, 2), np.nextafter(1, 0)
    assert positive(np.array([P, above, below])).tolist() == [False, True, False]


class Velocity:
    """Position and velocity, of which the measurements see the position alone."""

    def __init__(self, q):
        self.q = q

    def matrices(self, dt):
        F, Q = np.array([[1, dt], [0, 1]]), np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
        return np.kron(F, np.eye(3)), self.q * np.kron(Q, np.eye(3))


MOTIONS = {
    "walk": RandomWalk(0.5, 0.1),
    "still": RandomWalk(1e-6, 1e-6),
    "velocity": Velocity(1e-3),
}
MODELS = {  # of a deviation in radians, as small as the model takes it
    "azel": lambda sigma: AzEl(np.rad2deg(sigma)),
    "unit_vector": lambda sigma: UnitVector(min(1 / sigma**2, 1e15)),
    "adaptive": lambda sigma: AzElAdaptive(noise=FlippedAngles(max(np.rad2deg(sigma), 1e-5))),
}
FILTERS = {
    "ekf": EKF,
    "ukf": UKF,
    "ukf_centre": lambda h: UKF(h, form="centre"),
    "ukf_augmented": lambda h: UKF(h, form="augmented"),
}


def walk(rng, motion, sigma, anchors, prior, R, T):
    """A random walk near the middle of the anchors, seen with angles of deviation sigma (rad)."""
    F, Q = motion.matrices(0.25)
    n = len(F)
    x = np.tile([2.5, 2.0, 0.5], (R, T, 1)) + 0.02 * rng.normal(size=(R, T, 3)).cumsum(axis=1) % 1
    h = AzEl(1.0).predict(x.reshape(1, -1, 3), anchors).reshape(R, T, -1, 2)
    y = h + sigma * rng.normal(size=h.shape)
    mean = np.zeros((R, n))
    mean[:, :3] = x[:, 0] + min(prior, 1.0) * rng.normal(size=(R, 3))
    batch = Batch(
        wrap(y[..., 0]), y[..., 1], anchors, prior_mean=mean, prior_cov=prior**2 * np.eye(n)
    )
    return batch, Place(anchors, motion=motion, dt=0.25)


def facing_in(B):
    return Anchors(CORNERS[None, :B], facing([2.5, 2.5, 0] - CORNERS[:B])[None])


@pytest.mark.parametrize("B", [1, 2, 4])
@pytest.mark.parametrize("sigma", [0.1, 1e-6, 1e-9])
@pytest.mark.parametrize(("motion", "prior"), [("walk", 1.0), ("still", 1e3), ("velocity", 1e6)])
@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("name", FILTERS)
def test_covariances_are_positive_definite(name, model, motion, prior, sigma, B, rng):
    """One anchor leaves the distance open: the ratio of its variances reaches 1e24."""
    batch, scenario = walk(rng, MOTIONS[motion], sigma, facing_in(B), prior, 4, 25)
    for engine in ENGINES:
        check(replace(FILTERS[name](MODELS[model](sigma)), engine=engine)(batch, scenario, None))


@pytest.mark.parametrize(("engine", "T"), [("auto", 5000), ("numpy", 1000)])
@pytest.mark.parametrize("B", [1, 4])
@pytest.mark.parametrize("name", ["ekf", "ukf"])
def test_on_long_walks_too(name, B, engine, T, rng):
    batch, scenario = walk(rng, RandomWalk(1e-3, 1e-4), 1e-6, facing_in(B), 1.0, 1, T)
    check(replace(FILTERS[name](AzEl(np.rad2deg(1e-6))), engine=engine)(batch, scenario, None))


def at_access_nodes(rng, sigma, B, prior, known, R, T, dt=0.1, q=1e-3):
    """A straight walk and its times and angles at B access nodes; sigma in rad and 10 m."""
    F, _ = ConstantAcceleration(q).matrices(dt)
    x = np.zeros((R, T, 9))
    x[:, 0, :3], x[:, 0, 3:5] = rng.uniform(-3, 3, (R, 3)) * [1, 1, 0.1], 10 / (dt * T)
    for k in range(1, T):
        x[:, k] = x[:, k - 1] @ F.T
    position = np.concatenate([rng.uniform(-10, 10, (1, B, 2)), rng.uniform(2, 3, (1, B, 1))], -1)
    anchors = Anchors(
        position, facing(np.array([[0.0, 0, 1]] * B))[None], np.full((1, B, 3), known)
    )
    h, _ = an.expected(x[..., :3].reshape(-1, 3), anchors)
    deviation = sigma * np.array([10.0, 1, 1])
    y = h.reshape(R, T, B, 3) + deviation * rng.normal(size=(R, T, B, 3))
    each = np.ones((R, T, B))
    batch = Batch(
        wrap(y[..., 1]), y[..., 2], anchors, delay=y[..., 0] / LIGHT,
        azimuth_sigma=each * deviation[1], elevation_sigma=each * deviation[2],
        delay_sigma=each * deviation[0] / LIGHT,
        prior_mean=x[:, 0] + min(prior, 1.0) * rng.normal(size=(R, 9)),
        prior_cov=prior**2 * np.diag([1, 1, 0.01] + [0.1] * 6),
    )  # fmt: skip
    return batch, Place(anchors, motion=ConstantAcceleration(q), dt=dt)


@pytest.mark.parametrize("toa", [True, False])
@pytest.mark.parametrize("printed", [(), ("shared",), ("shared", "cross"), ("jacobian", "cross")])
@pytest.mark.parametrize("known", [0.0, 0.5])
@pytest.mark.parametrize("prior", [1.0, 1e6])
@pytest.mark.parametrize("sigma", [0.01, 1e-6, 1e-9])
def test_covariances_at_access_nodes(sigma, prior, known, printed, toa, rng):
    for B in (1, 2, 7):
        batch, scenario = at_access_nodes(rng, sigma, B, prior, known, 4, 15)
        for engine in ENGINES:
            check(an.AccessNodeEKF(toa, printed, engine=engine)(batch, scenario, None))


@pytest.mark.parametrize(("engine", "T"), [("auto", 5000), ("numpy", 1000)])
@pytest.mark.parametrize("B", [1, 7])
def test_long_walks_past_exact_access_nodes(B, engine, T, rng):
    """Anchors exact, measurements nearly so: where the difference of two covariances was negative."""
    batch, scenario = at_access_nodes(rng, 1e-6, B, 1.0, 0.0, 1, T, q=1e-6)
    check(an.AccessNodeEKF(engine=engine)(batch, scenario, None))


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("which", ["ekf", "access nodes"])
def test_rounding_is_no_information(which, engine, rng):
    """Nearly exact angles at one anchor, where sums of 1e18 round by hundreds, leave the distance open."""
    if which == "ekf":
        batch, scenario = walk(rng, MOTIONS["walk"], 1e-9, facing_in(1), 1.0, 16, 1)
        found = EKF(AzEl(np.rad2deg(1e-9)), engine=engine)(batch, scenario, None)
    else:
        batch, scenario = at_access_nodes(rng, 1e-9, 1, 1.0, 0.0, 16, 1)
        found = an.AccessNodeEKF(toa=False, engine=engine)(batch, scenario, None)
    F, Q = scenario.motion.matrices(scenario.dt)
    prior = (F @ batch.prior_cov @ F.T + Q)[:3, :3]
    ray = (batch.prior_mean @ F.T)[:, :3] - batch.anchors.position[0, 0, 0]
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    open_ = 1 / np.einsum("ri,ij,rj->r", ray, np.linalg.inv(prior), ray)
    assert np.allclose(
        np.einsum("ri,rij,rj->r", ray, found.covariance[:, 0], ray), open_, rtol=1e-6
    )


@pytest.mark.parametrize("B", [1, 2, 3, 4])
@pytest.mark.parametrize("sigma", [1e-6, 2e-6, 1e-8, 1e-10])
def test_the_ukf_is_as_exact_as_its_angles(sigma, B, rng):
    """Its kernel sums squares of the angles and must leave to NumPy what such sums cannot hold."""
    batch, scenario = walk(rng, MOTIONS["walk"], sigma, facing_in(B), 1.0, 64, 1)
    a, b = (UKF(AzEl(np.rad2deg(sigma)), engine=e)(batch, scenario, None) for e in ENGINES)
    assert np.allclose(a.position, b.position, rtol=1e-3, atol=1e-3)
    assert np.allclose(a.covariance, b.covariance, rtol=1e-2, atol=1e-3)


# --- against 50 digits ----------------------------------------------------------------------------


def matrix(a):
    return mpmath.matrix(np.asarray(a, dtype=float).tolist())


def numbers(a):
    return np.array(a.tolist(), dtype=float)


def prediction(batch, F, Q, r):
    F, x, P = matrix(F), matrix(batch.prior_mean[r][:, None]), matrix(batch.prior_cov)
    return F * x, F * P * F.T + matrix(Q)


def posterior(x, P, D, Z, R, v):
    """Mean and covariance after y = h(x) + e, and how much more the measurement knows than the prior.

    D (n, m) and Z (m, m) are the covariances of state and h(x), and of h(x); R (m, m) that of e.
    """
    K = D * mpmath.inverse(Z + R)
    return (
        x + K * matrix(v[:, None]),
        P - K * D.T,
        1 + sum(Z[i, i] / R[i, i] for i in range(len(v))),
    )


def by_ekf(h, batch, F, Q, r):
    x, P = prediction(batch, F, Q, r)
    at = numbers(x).T
    y, quality = h.observe(batch)
    H = matrix(h.jacobian(at, batch.anchors)[0])
    R = mpmath.diag(h.covariance(at, batch.anchors, quality[r, :1])[0].tolist())
    v = h.residual(y[r, 0], h.predict(at, batch.anchors)[0])
    return posterior(x, P, P * H.T, H * P * H.T, R, v)


def by_ukf(h, batch, F, Q, r):
    x, P = prediction(batch, F, Q, r)
    y, quality = h.observe(batch)
    points, w = sigma_points(numbers(x).T, numbers(mpmath.cholesky(P))[None], 0.5)
    images = h.predict(points, batch.anchors)
    d = h.residual(images, images[:, :1])[0]
    R = w @ np.broadcast_to(h.covariance(points, batch.anchors, quality[r, :1]), images.shape)[0]
    X, Z, W = matrix(points[0] - numbers(x).T), matrix(d - w @ d), mpmath.diag(w.tolist())
    v = h.residual(y[r, 0], images[0, 0] + w @ d)
    return posterior(x, P, X.T * W * Z, Z.T * W * Z, mpmath.diag(R.tolist()), v)


def at_nodes(toa, batch, F, Q, r):
    x, P = prediction(batch, F, Q, r)
    y, q = an.AccessNodeEKF(toa).measured(batch)
    h, H = (a[0] for a in an.expected(numbers(x)[:3].T, batch.anchors))
    v = y[r, 0] - h
    v[:, 1] = wrap(v[:, 1])
    rows = [(b, i) for b in range(len(h)) for i in range(0 if toa else 1, 3)]
    C = np.square(batch.anchors.position_sigma[0, 0])
    G, R = mpmath.zeros(len(rows), 9), mpmath.zeros(len(rows))
    for m, (a, i) in enumerate(rows):
        for p in range(3):
            G[m, p] = H[a, i, p]
        for n, (b, j) in enumerate(rows):
            if a == b:
                R[m, n] = sum(mpmath.mpf(H[a, i, p]) * C[a, p] * H[a, j, p] for p in range(3))
                R[m, n] += q[r, 0, a, i] if i == j else 0
    return posterior(x, P, P * G.T, G * P * G.T, R, np.array([v[a, i] for a, i in rows]))


def compare(filters, exact, batch, scenario):
    """Both engines against the exact update of each replication, in its own deviations.

    A Kalman filter in double precision loses the ratio of the prior's variances to the measurement's,
    times eps. The factor is twice the growth of the diagonals of the two covariances that it forms.
    """
    F, Q = scenario.motion.matrices(scenario.dt)
    n = len(F)
    with mpmath.workdps(50):
        for r in range(len(batch.prior_mean)):
            x, P, ratio = exact(batch, F, Q, r)
            inverse = mpmath.inverse(mpmath.cholesky(P[:3, :3]))
            tolerance = 4 * n * (3 * n + 1) * EPS * float(ratio)
            assert tolerance < 0.01
            for engine in ENGINES:
                found = replace(filters, engine=engine)(batch, scenario, None)
                off = inverse * (matrix(found.position[r, 0][:, None]) - x[:3, 0])
                assert mpmath.norm(off) < tolerance * (1 + mpmath.norm(inverse * x[:3, 0]))
                off = inverse * (matrix(found.covariance[r, 0]) - P[:3, :3]) * inverse.T
                assert mpmath.mnorm(off, "f") < tolerance


@pytest.mark.parametrize("B", [1, 4])
@pytest.mark.parametrize("sigma", [0.1, 1e-3, 1e-5])
@pytest.mark.parametrize("motion", ["walk", "velocity"])
@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize(("name", "exact"), [("ekf", by_ekf), ("ukf", by_ukf)])
def test_updates_are_the_exact_ones(name, exact, model, motion, sigma, B, rng):
    batch, scenario = walk(rng, MOTIONS[motion], sigma, facing_in(B), 0.3, 2, 1)
    A = rng.normal(size=batch.prior_cov.shape)
    batch, h = replace(batch, prior_cov=0.1 * A @ A.T), MODELS[model](sigma)
    compare(FILTERS[name](h), lambda *given: exact(h, *given), batch, scenario)


@pytest.mark.parametrize("toa", [True, False])
@pytest.mark.parametrize("known", [0.0, 0.5])
@pytest.mark.parametrize("B", [1, 5])
@pytest.mark.parametrize("sigma", [0.1, 1e-3, 1e-5])
def test_updates_at_access_nodes_are_the_exact_ones(sigma, B, known, toa, rng):
    batch, scenario = at_access_nodes(rng, sigma, B, 1.0, known, 2, 1)
    A = rng.normal(size=(9, 9))
    batch = replace(batch, prior_cov=0.1 * A @ A.T)
    compare(an.AccessNodeEKF(toa), lambda *given: at_nodes(toa, *given), batch, scenario)


def test_roots_of_priors(rng):
    """Of a full, a graded, a singular covariance; of what is none, or not finite, NaN."""
    A = rng.normal(size=(4, 4))
    graded = np.diag([1e6, 1.0, 1e-6, 1e-9])
    for P in (A @ A.T, graded @ (A @ A.T) @ graded, A[:, :2] @ A[:, :2].T, np.diag([1.0, 0, 2, 0])):
        B, d = prior_root(P), np.sqrt(np.diag(P))
        assert np.array_equal(B, np.tril(B))
        assert np.all(np.abs(B @ B.T - P) <= 32 * EPS * np.outer(d, d))
    for P in (-np.eye(3), np.array([[1.0, 2], [2, 1]]), np.diag([1.0, np.nan])):
        assert np.isnan(prior_root(P)).any()
