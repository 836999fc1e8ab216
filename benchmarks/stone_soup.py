"""One lap of the square track in Stone Soup: EKF, UKF and particle filter, each in the faster way.

The Kalman filters process all anchors as one combined measurement; the particle filter processes
the anchors one after the other and resamples after the last.
"""

from __future__ import annotations

from datetime import datetime, timedelta
from typing import Any

import numpy as np
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

from aoabench.filters.belief import believed
from aoabench.maths.geometry import Array
from aoabench.roles import Scenario
from aoabench.types import Batch

START = datetime(2018, 1, 1)


class StoneSoup:
    """The filters for one replication's measurements (1, T, B) with a deviation in rad."""

    def __init__(self, scenario: Scenario, batch: Batch, sigma: float, particles: int) -> None:
        belief = believed(batch, scenario)
        self.batch, self.particles = batch, particles
        self.mean, self.cov = belief.mean[0], np.asarray(belief.covariance)
        self.steps, self.anchors = batch.azimuth.shape[1:]
        anchors = zip(*(part[0] for part in batch.anchors.frames))
        self.models = [_seen_from(s, R, sigma) for s, R in anchors]
        self.together = CombinedReversibleGaussianMeasurementModel(self.models)
        walks = [RandomWalk(q) for q in np.diag(belief.at(0)[1]) / scenario.dt]
        self.motion = CombinedLinearGaussianTransitionModel(walks)
        self.times = [START + timedelta(seconds=(k + 1) * scenario.dt) for k in range(self.steps)]

    def ekf(self) -> Array:
        """Positions (T, 3) m of the extended Kalman filter."""
        return self._kalman(ExtendedKalmanPredictor(self.motion), ExtendedKalmanUpdater())

    def ukf(self) -> Array:
        """Positions (T, 3) m of the unscented Kalman filter."""
        return self._kalman(UnscentedKalmanPredictor(self.motion), UnscentedKalmanUpdater())

    def particle_filter(self) -> Array:
        """Positions (T, 3) m of the particle filter."""
        rng, n = np.random.default_rng(0), self.particles
        points = StateVectors(rng.multivariate_normal(self.mean, self.cov, n).T)
        state = ParticleState(points, weight=np.full(n, 1 / n), timestamp=START)
        predictor, found = ParticlePredictor(self.motion), []
        for k, time in enumerate(self.times):
            state = predictor.predict(state, timestamp=time)
            for j, model in enumerate(self.models):
                last = j == self.anchors - 1
                resampler = ESSResampler(threshold=0.1 * n) if last else None
                angles = StateVector(self._angles(k, j))
                detection = Detection(angles, timestamp=time, measurement_model=model)
                updater = ParticleUpdater(model, resampler=resampler)
                state = updater.update(SingleHypothesis(state, detection))
            found.append(np.asarray(state.mean, dtype=float).ravel())
        return np.array(found)

    def _kalman(self, predictor: Any, updater: Any) -> Array:
        state, found = GaussianState(self.mean[:, None], self.cov, timestamp=START), []
        for k, time in enumerate(self.times):
            angles = [angle for j in range(self.anchors) for angle in self._angles(k, j)]
            measured = StateVector(angles)
            detection = Detection(measured, timestamp=time, measurement_model=self.together)
            predicted = predictor.predict(state, timestamp=time)
            state = updater.update(SingleHypothesis(predicted, detection))
            found.append(np.asarray(state.mean, dtype=float).ravel())
        return np.array(found)

    def _angles(self, k: int, j: int) -> list[Any]:
        """Step k's angles from anchor j."""
        return [Elevation(self.batch.elevation[0, k, j]), Bearing(self.batch.azimuth[0, k, j])]


def _seen_from(position: Array, rotation: Array, sigma: float) -> Any:
    """The measurement model of an anchor at a position (3,) m; rotation (3, 3) from the global to
    the anchor's frame.
    """
    frame = {"rotation_matrix": property(lambda self: rotation)}
    model = type("InFrame", (CartesianToElevationBearing,), frame)
    return model(3, (0, 1, 2), sigma**2 * np.eye(2), translation_offset=StateVector(position))
