"""Roles of filters whose belief is a normal distribution: what smoothers and live positioning take,
and the base class of Kalman filters.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aoabench.filters.belief import Belief, believed
from aoabench.filters.divergence import Filtered, InnovationBound
from aoabench.filters.gaussian import Gaussian
from aoabench.filters.roots import covariance, moved, predicted, prior_root
from aoabench.filters.trace import innovations
from aoabench.maths.geometry import Array
from aoabench.params import param
from aoabench.roles import Estimator, Filter, Measurement, Scenario
from aoabench.streams import Streams
from aoabench.types import Anchors, Batch, Estimates

Recursion = tuple[Filtered, Belief]


@dataclass(frozen=True)
class GaussianFilter(InnovationBound, Estimator):
    """A filter whose belief is a normal distribution of the state."""

    engine = "auto"  # of the smoothers that take its results, see kernels.loading.engine_param

    def recursion(self, batch: Batch, scenario: Scenario, whole: bool = False) -> Recursion:
        """Positions, or whole states, with the prior and the motion that the filter assumed."""
        raise NotImplementedError

    def __call__(self, batch: Batch, scenario: Scenario, streams: Streams) -> Estimates:
        """Filtered positions (R, T, 3) m and covariances (R, T, 3, 3) m^2.

        A fix is DIVERGED, and keeps its position, for one of the reasons of `filters.divergence`.
        """
        filtered, belief = self.recursion(batch, scenario)
        return self.outcomes(filtered, None, batch.layout, belief)


@dataclass(frozen=True)
class KalmanFilter(GaussianFilter, Filter):
    """Base class of Kalman filters: a subclass defines `update`, the base class does the rest.

    It starts from the prior of the batch and predicts with the scenario's motion model over the
    time between the steps, whatever that is; a step without measurements is a prediction. All
    replications of a tile are filtered at once. A fix is DIVERGED by its distance from the anchors,
    its covariance and the innovations (`filters.divergence`), and FAILED where a number is not
    finite. Smoothers (`filters.smoother.RTSSmoother`) and live positioning take such a filter.
    """

    measurement: Measurement = param(
        help="measurement model that the filter assumes", kind=Measurement
    )
    by_replication = True
    heard_only = True

    def update(self, prior: Gaussian, y: Array, r: Array, anchors: Anchors) -> Gaussian:
        """Return the distribution of the state after the measurements y of one step.

        prior: the predicted state, with mean (R, n) and a lower Cholesky factor (R, n, n); y (R, m)
        as `measurement.observe` gives them, NaN where nothing was measured; r (R, m), their nominal
        variances; anchors of the step. `prior.given` makes the result from innovations and
        derivatives; an innovation set to NaN leaves the measurement out.
        """
        raise NotImplementedError

    def recursion(self, batch: Batch, scenario: Scenario, whole: bool = False) -> Recursion:
        belief = believed(batch, scenario)
        return self.filtered(batch, belief, belief.size if whole else 3), belief

    def filtered(self, batch: Batch, belief: Belief, size: int = 3) -> Filtered:
        """The state's first `size` components in each step of a batch."""
        return self._filtered(batch, belief, size)

    def _filtered(
        self, batch: Batch, belief: Belief, size: int = 3, seen: list[Array] | None = None
    ) -> Filtered:
        """`filtered` in NumPy; innovations (R, m) at the predicted mean are appended to `seen`."""
        h, x, root = self.measurement, np.asarray(belief.mean), prior_root(belief.covariance)
        state = Gaussian(x, np.broadcast_to(root, (*x.shape, x.shape[-1])))
        means, covariances, nis = [], [], []
        with np.errstate(all="ignore"):  # overflow becomes NaN and is counted as failed
            Y, quality = h.observe(batch)
            for k in range(Y.shape[1]):
                here, (F, Q) = batch.anchors.at(k), belief.at(k)
                state = Gaussian(moved(state.mean, F), predicted(state.root, F, Q))
                if seen is not None:
                    seen.append(h.residual(Y[:, k], h.predict(state.mean, here)))
                state = self.update(state, Y[:, k], quality[:, k], here)
                means.append(state.mean[:, :size])
                covariances.append(covariance(state.root[:, :size]))
                nis.append(np.broadcast_to(state.nis, len(x)))
        position, P, squares = (np.stack(each, axis=1) for each in (means, covariances, nis))
        return Filtered(position, P, squares, np.isfinite(Y).sum(axis=-1))

    def trace(self, batch: Batch, scenario: Scenario, streams: Streams) -> dict[str, Array]:
        """Innovations (R, T) at the predicted mean, by component."""
        seen: list[Array] = []
        self._filtered(batch, believed(batch, scenario), seen=seen)
        return innovations(np.stack(seen, axis=1), batch.azimuth.shape[2])
