"""The base class of Kalman filters: a subclass that defines `update` alone is a whole filter."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

import aoabench
from aoabench import Gaussian, KalmanFilter, param
from aoabench.config.compose import compose_cells
from aoabench.engine.draws import Draws
from aoabench.filters.belief import believed
from aoabench.filters.smoother import RTSSmoother
from aoabench.maths.times import elapsed
from aoabench.store.reach import reach
from aoabench.types import Outcome


@dataclass(frozen=True)
class PlainEKF(KalmanFilter):
    """The EKF from public names."""

    def update(self, prior, y, r, anchors):
        h, x = self.measurement, prior.mean
        v = h.residual(y, h.predict(x, anchors))
        return prior.given(v, h.jacobian(x, anchors), h.covariance(x, anchors, r))


@dataclass(frozen=True)
class IteratedEKF(KalmanFilter):
    """The EKF whose derivatives are taken at the updated mean [Bell and Cathey 1993]."""

    iterations: int = param(4, "number of Gauss-Newton steps", least=1)

    def update(self, prior, y, r, anchors):
        h, found = self.measurement, prior
        for _ in range(self.iterations):
            x = found.mean
            H = h.jacobian(x, anchors)
            v = h.residual(y, h.predict(x, anchors)) - (H @ (prior.mean - x)[..., None])[..., 0]
            found = prior.given(v, H, h.covariance(x, anchors, r))
        return found


@pytest.fixture(scope="module")
def tile():
    """A cell with ekf_vmf, and five replications whose steps differ in length, with gaps."""
    cell = compose_cells(["noise=vmf", "noise.sigma_deg=4", "filter=[ekf_vmf]"])[0]
    draws = Draws(cell.scenario, cell.noise, 1)
    _, batch = draws.tile(0, 5)
    azimuth, elevation = batch.azimuth.copy(), batch.elevation.copy()
    azimuth[:, 10], elevation[:, 10] = np.nan, np.nan  # nobody measures
    azimuth[2, 20:30, 1], elevation[2, 20:30, 1] = np.nan, np.nan  # one anchor does not
    time = np.cumsum(np.tile([0.25, 0.1, 0.6, 0.25], 16))[None]
    return cell, replace(batch, azimuth=azimuth, elevation=elevation, time=time)


def test_an_ekf_from_public_names_is_the_shipped_one(tile):
    cell, batch = tile
    shipped = replace(cell.estimators["ekf_vmf"], engine="numpy")
    own = PlainEKF(shipped.measurement)
    a, b = (method(batch, cell.scenario, None) for method in (shipped, own))
    assert np.allclose(a.position, b.position, rtol=0, atol=1e-12)
    assert np.allclose(a.covariance, b.covariance, rtol=0, atol=1e-12)
    assert np.array_equal(a.outcome, b.outcome)
    assert (a.outcome == Outcome.OK).mean() > 0.9
    c, d = (RTSSmoother(method)(batch, cell.scenario, None) for method in (shipped, own))
    assert np.allclose(c.position, d.position, rtol=0, atol=1e-10)
    assert own.trace(batch, cell.scenario, None).keys() == shipped.trace(batch, cell.scenario, None).keys()  # fmt: skip


def slow_iterated(h, batch, scenario, iterations, i):
    """Means (T, 3) m of the iterated EKF of one replication in covariance form, step by step."""
    batch = batch.of(i)
    (m,), P = batch.prior_mean, batch.prior_cov
    Y, quality = (a[0] for a in h.observe(batch))
    means, dts = [], elapsed(batch.time, scenario.start_s)[0]
    for k, y in enumerate(Y):
        F, Q = scenario.motion.matrices(dts[k])
        m, P = F @ m, F @ P @ F.T + Q
        x, seen = m, np.isfinite(y)
        for _ in range(iterations if seen.any() else 0):
            H = h.jacobian(x[None], batch.anchors)[0][seen]
            R = np.diag(h.covariance(x[None], batch.anchors, quality[None, k])[0][seen])
            v = h.residual(y[None], h.predict(x[None], batch.anchors))[0][seen]
            S = H @ P @ H.T + R
            K = P @ H.T @ np.linalg.inv(S)
            x = m + K @ (v - H @ (m - x))
        if seen.any():
            P = (np.eye(3) - K @ H) @ P @ (np.eye(3) - K @ H).T + K @ R @ K.T
        m = x
        means.append(m)
    return np.array(means)


@pytest.mark.parametrize("iterations", [1, 4])
def test_an_iterated_ekf_equals_a_plain_loop(tile, iterations):
    cell, batch = tile
    h = cell.estimators["ekf_vmf"].measurement
    found = IteratedEKF(h, iterations)(batch, cell.scenario, None)
    for i in range(5):
        slow = slow_iterated(h, batch, cell.scenario, iterations, i)
        assert np.abs(found.position[i] - slow).max() < 1e-9


def test_more_iterations_move_the_fixes(tile):
    cell, batch = tile
    h = cell.estimators["ekf_vmf"].measurement
    one, four = (IteratedEKF(h, n)(batch, cell.scenario, None).position for n in (1, 4))
    assert np.abs(one - four).max() > 0.01


def test_a_gaussian_given_measurements(rng):
    """Against the conditional distribution of a joint normal one."""
    A, H = rng.normal(size=(4, 3, 3)), rng.normal(size=(4, 2, 3))
    mean, r, v = rng.normal(size=(4, 3)), np.array([[0.3, 2.0]] * 4), rng.normal(size=(4, 2))
    v[1, 0] = np.nan
    found = Gaussian(mean, np.linalg.cholesky(A @ A.swapaxes(1, 2))).given(v, H, r)
    for i in range(4):
        seen = np.isfinite(v[i])
        P, C = A[i] @ A[i].T, H[i][seen]
        S = C @ P @ C.T + np.diag(r[i][seen])
        K = P @ C.T @ np.linalg.inv(S)
        assert np.allclose(found.mean[i], mean[i] + K @ v[i][seen], rtol=1e-9, atol=0)
        assert np.allclose(found.covariance[i], P - K @ C @ P, rtol=1e-9, atol=1e-12)
        assert found.nis[i] == pytest.approx(v[i][seen] @ np.linalg.solve(S, v[i][seen]), rel=1e-9, abs=0)  # fmt: skip


def test_a_filter_without_update_says_so(tile):
    cell, batch = tile
    with pytest.raises(NotImplementedError):
        KalmanFilter(cell.estimators["ekf_vmf"].measurement)(batch, cell.scenario, None)


def test_results_depend_on_the_code_of_the_base_class():
    """The lazy name of the package leads to the module that defines it."""
    found = reach([("aoabench", "KalmanFilter")]).definitions
    assert ("aoabench.filters.recursion", "KalmanFilter") in found
    assert ("aoabench.filters.roots", "absorb") in found
    with pytest.raises(AttributeError, match="no attribute 'Kalman'"):
        _ = aoabench.Kalman


def test_a_belief_is_that_of_the_batch(tile):
    cell, batch = tile
    belief = believed(batch, cell.scenario)
    assert belief.Q.shape[1] == batch.azimuth.shape[1]  # the steps differ in length
