"""The same work in other libraries: one lap of the square track, azimuth-elevation model, all
anchors at once.

Each function returns the estimated positions (T, 3) m, so that it can be seen that it does the same
work. Whoever knows a faster way to write one of these: it belongs here.
"""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime, timedelta
from typing import Any

import numpy as np

from aoabench.maths.geometry import Array, in_frames, to_azel, wrap
from aoabench.types import Batch

Lap = Callable[[], Array]


def available() -> dict[str, Callable[[Any, Batch, float, int], dict[str, Lap]]]:
    """The libraries that are installed."""
    found: dict[str, Callable[[Any, Batch, float, int], dict[str, Lap]]] = {}
    try:
        import stonesoup

        found[f"Stone Soup {stonesoup.__version__}"] = stone_soup
    except ImportError:
        pass
    try:
        import filterpy

        found[f"FilterPy {filterpy.__version__}"] = filter_py
    except ImportError:
        pass
    return found


def stone_soup(scenario: Any, batch: Batch, sigma: float, particles: int) -> dict[str, Lap]:
    """EKF, UKF and particle filter, each in the way that is faster.

    The Kalman filters take all anchors in one combined measurement, the particle filter takes one
    after the other and resamples after the last.
    """
    from stonesoup.models.measurement.nonlinear import (
        CartesianToElevationBearing,
        CombinedReversibleGaussianMeasurementModel,
    )
    from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel, RandomWalk
    from stonesoup.predictor.kalman import ExtendedKalmanPredictor, UnscentedKalmanPredictor
    from stonesoup.predictor.particle import ParticlePredictor
    from stonesoup.resampler.particle import ESSResampler
    from stonesoup.types.angle import Bearing, Elevation
    from stonesoup.types.array import StateVector, StateVectors
    from stonesoup.types.detection import Detection
    from stonesoup.types.hypothesis import SingleHypothesis
    from stonesoup.types.state import GaussianState, ParticleState
    from stonesoup.updater.kalman import ExtendedKalmanUpdater, UnscentedKalmanUpdater
    from stonesoup.updater.particle import ParticleUpdater

    def seen_from(position: Array, rotation: Array) -> Any:
        frame = {"rotation_matrix": property(lambda self: rotation)}
        model = type("InFrame", (CartesianToElevationBearing,), frame)
        return model(3, (0, 1, 2), sigma**2 * np.eye(2), translation_offset=StateVector(position))

    anchors = list(zip(batch.anchors.position[0], batch.anchors.rotation[0]))
    models = [seen_from(s, R) for s, R in anchors]
    together = CombinedReversibleGaussianMeasurementModel(models)
    _, Q = scenario.motion.matrices(scenario.dt)
    motion = CombinedLinearGaussianTransitionModel(
        [RandomWalk(q) for q in np.diag(Q) / scenario.dt]
    )
    start = datetime(2018, 1, 1)
    T, B = batch.azimuth.shape[1:]

    def angles(k: int, j: int) -> list[Any]:
        return [Elevation(batch.elevation[0, k, j]), Bearing(batch.azimuth[0, k, j])]

    def kalman(predictor: Any, updater: Any) -> Array:
        state, found = GaussianState(mean[:, None], cov, timestamp=start), []
        for k in range(T):
            time = start + timedelta(seconds=(k + 1) * scenario.dt)
            measured = StateVector([angle for j in range(B) for angle in angles(k, j)])
            detection = Detection(measured, timestamp=time, measurement_model=together)
            state = updater.update(
                SingleHypothesis(predictor.predict(state, timestamp=time), detection)
            )
            found.append(np.asarray(state.mean, dtype=float).ravel())
        return np.array(found)

    def particle() -> Array:
        points = np.random.default_rng(0).multivariate_normal(mean, cov, particles).T
        state = ParticleState(
            StateVectors(points), weight=np.full(particles, 1 / particles), timestamp=start
        )
        predictor, found = ParticlePredictor(motion), []
        for k in range(T):
            time = start + timedelta(seconds=(k + 1) * scenario.dt)
            state = predictor.predict(state, timestamp=time)
            for j, model in enumerate(models):
                resampler = ESSResampler(threshold=0.1 * particles) if j == B - 1 else None
                detection = Detection(
                    StateVector(angles(k, j)), timestamp=time, measurement_model=model
                )
                state = ParticleUpdater(model, resampler=resampler).update(
                    SingleHypothesis(state, detection)
                )
            found.append(np.asarray(state.mean, dtype=float).ravel())
        return np.array(found)

    assert batch.prior_mean is not None
    mean, cov = batch.prior_mean[0], np.asarray(batch.prior_cov)

    return {
        "EKF": lambda: kalman(ExtendedKalmanPredictor(motion), ExtendedKalmanUpdater()),
        "UKF": lambda: kalman(UnscentedKalmanPredictor(motion), UnscentedKalmanUpdater()),
        "PF": particle,
    }


def filter_py(scenario: Any, batch: Batch, sigma: float, particles: int) -> dict[str, Lap]:
    """EKF and UKF as its book has them; the particle filter around its systematic resampling, in
    NumPy.
    """
    from filterpy.kalman import ExtendedKalmanFilter, JulierSigmaPoints, UnscentedKalmanFilter
    from filterpy.monte_carlo import systematic_resample

    from aoabench.models.azel import AzEl

    F, Q = scenario.motion.matrices(scenario.dt)
    T, B = batch.azimuth.shape[1:]
    Y = np.stack([batch.azimuth[0], batch.elevation[0]], axis=-1).reshape(T, 2 * B)
    R = sigma**2 * np.eye(2 * B)
    position, rotation = batch.anchors.position, batch.anchors.rotation
    assert batch.prior_mean is not None
    mean, cov = batch.prior_mean[0], np.asarray(batch.prior_cov)
    model, anchors = AzEl(np.rad2deg(sigma)), batch.anchors

    def h(x: Array) -> Array:
        angles = to_azel(*in_frames(np.ravel(x)[None], position, rotation))
        return np.stack(angles, axis=-1).reshape(2 * B)

    def residual(a: Array, b: Array) -> Array:
        d = np.subtract(a, b)
        d[::2] = wrap(d[::2])
        return d

    def mean_angles(points: Array, weights: Array) -> Array:
        d = points - points[0]
        d[:, ::2] = wrap(d[:, ::2])
        return points[0] + weights @ d

    def ekf() -> Array:
        kf = ExtendedKalmanFilter(dim_x=3, dim_z=2 * B)
        kf.x, kf.P, kf.F, kf.Q, kf.R = mean.copy(), cov.copy(), F, Q, R
        found = []
        for y in Y:
            kf.predict()
            kf.update(y, lambda x: model.jacobian(x[None], anchors)[0], h, residual=residual)
            found.append(kf.x.copy())
        return np.array(found)

    def ukf() -> Array:
        points = JulierSigmaPoints(n=3, kappa=0.5)
        kf = UnscentedKalmanFilter(
            dim_x=3,
            dim_z=2 * B,
            dt=scenario.dt,
            hx=h,
            fx=lambda x, dt: F @ x,
            points=points,
            z_mean_fn=mean_angles,
            residual_z=residual,
        )
        kf.x, kf.P, kf.Q, kf.R = mean.copy(), cov.copy(), Q, R
        found = []
        for y in Y:
            kf.predict()
            kf.update(y)
            found.append(kf.x.copy())
        return np.array(found)

    def pf() -> Array:
        rng = np.random.default_rng(0)
        x = rng.multivariate_normal(mean, cov, particles)
        w = np.full(particles, 1 / particles)
        root, found = np.sqrt(np.diag(Q)), []
        for y in Y:
            x = x + root * rng.standard_normal(x.shape)
            azimuth, elevation = to_azel(*in_frames(x[None], position, rotation))
            loglik = -0.5 * (
                (wrap(y[::2] - azimuth[0]) ** 2 + (y[1::2] - elevation[0]) ** 2) / sigma**2
            ).sum(axis=-1)
            w = w * np.exp(loglik - loglik.max())
            w = w / w.sum()
            found.append(w @ x)
            if 1 / (w @ w) < 0.1 * particles:
                x, w = x[systematic_resample(w)], np.full(particles, 1 / particles)
        return np.array(found)

    return {"EKF": ekf, "UKF": ukf, "PF": pf}
