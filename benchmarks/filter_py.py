"""One lap of the square track in FilterPy: EKF and UKF as in its book, and a particle filter around
its systematic resampling.
"""

from __future__ import annotations

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter, JulierSigmaPoints, UnscentedKalmanFilter
from filterpy.monte_carlo import systematic_resample

from aoabench.filters.belief import believed
from aoabench.maths.geometry import Array, in_frames, to_azel, wrap
from aoabench.models.azel import AzEl
from aoabench.roles import Scenario
from aoabench.types import Batch


class FilterPy:
    """The filters for one replication's measurements (1, T, B) with a deviation in rad.

    A measurement is azimuth and elevation of each anchor in turn (2 B,).
    """

    def __init__(self, scenario: Scenario, batch: Batch, sigma: float, particles: int) -> None:
        belief = believed(batch, scenario)
        T, B = batch.azimuth.shape[1:]
        self.F, self.Q = belief.at(0)
        self.measured = np.stack([batch.azimuth[0], batch.elevation[0]], axis=-1).reshape(T, 2 * B)
        self.dt, self.sigma, self.R = scenario.dt, sigma, sigma**2 * np.eye(2 * B)
        self.mean, self.cov = belief.mean[0], np.asarray(belief.covariance)
        self.model, self.anchors, self.particles = AzEl(np.rad2deg(sigma)), batch.anchors, particles

    def ekf(self) -> Array:
        """Positions (T, 3) m of the extended Kalman filter."""
        kf = ExtendedKalmanFilter(dim_x=3, dim_z=len(self.R))
        kf.x, kf.P, kf.F, kf.Q, kf.R = self.mean.copy(), self.cov.copy(), self.F, self.Q, self.R
        found = []
        for y in self.measured:
            kf.predict()
            kf.update(y, self._jacobian, self._predict, residual=_residual)
            found.append(kf.x.copy())
        return np.array(found)

    def ukf(self) -> Array:
        """Positions (T, 3) m of the unscented Kalman filter."""
        kf = UnscentedKalmanFilter(
            dim_x=3,
            dim_z=len(self.R),
            dt=self.dt,
            hx=self._predict,
            fx=lambda x, dt: self.F @ x,
            points=JulierSigmaPoints(n=3, kappa=0.5),
            z_mean_fn=_mean_angles,
            residual_z=_residual,
        )
        kf.x, kf.P, kf.Q, kf.R = self.mean.copy(), self.cov.copy(), self.Q, self.R
        found = []
        for y in self.measured:
            kf.predict()
            kf.update(y)
            found.append(kf.x.copy())
        return np.array(found)

    def particle_filter(self) -> Array:
        """Positions (T, 3) m of the particle filter."""
        rng, n = np.random.default_rng(0), self.particles
        position, rotation = self.anchors.position, self.anchors.rotation
        x, w = rng.multivariate_normal(self.mean, self.cov, n), np.full(n, 1 / n)
        root, found = np.sqrt(np.diag(self.Q)), []
        for y in self.measured:
            x = x + root * rng.standard_normal(x.shape)
            azimuth, elevation = to_azel(*in_frames(x[None], position, rotation))
            square = wrap(y[::2] - azimuth[0]) ** 2 + (y[1::2] - elevation[0]) ** 2
            loglik = -0.5 * (square / self.sigma**2).sum(axis=-1)
            w = w * np.exp(loglik - loglik.max())
            w = w / w.sum()
            found.append(w @ x)
            if 1 / (w @ w) < 0.1 * n:
                x, w = x[systematic_resample(w)], np.full(n, 1 / n)
        return np.array(found)

    def _predict(self, x: Array) -> Array:
        """The measurement (2 B,) rad at a position (3,) m."""
        seen = in_frames(np.ravel(x)[None], self.anchors.position, self.anchors.rotation)
        return np.stack(to_azel(*seen), axis=-1).reshape(len(self.R))

    def _jacobian(self, x: Array) -> Array:
        return self.model.jacobian(x[None], self.anchors)[0]


def _residual(a: Array, b: Array) -> Array:
    """A measurement minus another one, azimuths wrapped."""
    d = np.subtract(a, b)
    d[::2] = wrap(d[::2])
    return d


def _mean_angles(points: Array, weights: Array) -> Array:
    """Weighted mean of measurements (N, 2 B) about the first, azimuths wrapped."""
    d = points - points[0]
    d[:, ::2] = wrap(d[:, ::2])
    return points[0] + weights @ d
