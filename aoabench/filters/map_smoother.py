"""Batch smoother: the most probable track (maximum a posteriori, MAP) given all measurements.

With the prior N(m, P) before the first step, the motion x_k = F x_{k-1} + w, w ~ N(0, Q), and
measurements y_k = h(x_k) + e, e ~ N(0, r), it minimises, over all steps at once,

    |x_1 - F m|^2_(F P F^T + Q) + sum_k |x_k - F x_{k-1}|^2_Q + sum_k |y_k - h(x_k)|^2_r

by Gauss-Newton iterations with Levenberg-Marquardt damping. Each iteration solves a linear system
whose matrix is block-tridiagonal, a block a step, by a Kalman filter and a backward pass [Bell
1994; Särkkä and Svensson 2020], in a time proportional to the number of steps. It needs no inverse
of Q: packets of one time (Q = 0) and motions with fewer noises than states are allowed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from aoabench.filters.belief import Belief
from aoabench.filters.divergence import ExtentBound, marked, sound
from aoabench.filters.kalman import EKF
from aoabench.filters.smoother import KERNELS, finite, smoothed
from aoabench.filters.track_model import Quadratic, TrackModel
from aoabench.kernels.loading import engine_param, prepare
from aoabench.maths.geometry import Array
from aoabench.params import param
from aoabench.roles import Filter, Measurement, Scenario
from aoabench.streams import Streams
from aoabench.types import Anchors, Batch, Estimates, Outcome, Reason

FIRST_DAMPING, LEAST_DAMPING = 1e-3, 1e-6  # relative to the information at the start
MORE, LESS = 10.0, 3.0  # factors of the damping after a step that is refused or taken
REWEIGHTED = 10  # iterations in which variances that depend on the state follow it


class Minimum(NamedTuple):
    """States x (R, T, n) and covariances P (R, T, n, n) at the minimum; of each replication the
    number (R,) of iterations and whether (R,) they reached their limit; score (R, T).
    """

    x: Array
    P: Array
    iterations: np.ndarray
    unfinished: np.ndarray
    score: Array


@dataclass(frozen=True)
class MAPSmoother(ExtentBound, Filter):
    """The most probable track; the iterations start from the RTS smoother of an EKF.

    Not causal: each fix uses the later measurements too. Covariances are those of the model
    linearised at the solution. A track whose iteration reaches its limit is OSCILLATED. The score
    is the root mean square of a step's residuals, each divided by its deviation.
    """

    measurement: Measurement = param(
        help="measurement model that the smoother assumes", kind=Measurement
    )
    _: KW_ONLY
    iterations: int = param(100, "most iterations", least=1, most=100_000)
    tolerance: float = param(
        1e-4,
        "the iteration ends when no component of a state moves by more than this share of its "
        "standard deviation",
        above=0,
        most=1,
    )
    engine: str = engine_param()
    causal = False
    by_replication = True
    heard_only = True

    @property
    def start(self) -> EKF:
        """The filter whose smoothed track is the start."""
        return EKF(self.measurement, engine=self.engine)

    def prepare(self, say: Callable[[str], None]) -> None:
        self.start.prepare(say)
        if self.engine == "auto":
            prepare(KERNELS, say)

    def __call__(self, batch: Batch, scenario: Scenario, streams: Streams) -> Estimates:
        """Most probable positions (R, T, 3) m with covariances (R, T, 3, 3) m^2."""
        filtered, belief = self.start.recursion(batch, scenario, whole=True)
        x, P = smoothed(filtered.position, filtered.covariance, belief, self.engine)
        with np.errstate(all="ignore"):  # a track that overflows becomes NaN, and counts as failed
            model = TrackModel.of(self.measurement, batch, belief, self.engine)
            least = self._minimum(model, x, P)
        return self._judged(least, batch.layout, belief)

    def _judged(self, least: Minimum, anchors: Anchors, belief: Belief) -> Estimates:
        """The estimates with their outcomes and reasons."""
        pair = least.x[..., :3], least.P[..., :3, :3]
        found = self.judged(sound(*map(np.ascontiguousarray, pair)), anchors, belief)
        unfinished, counts = (
            np.repeat(each[:, None], least.x.shape[1], axis=1)
            for each in (least.unfinished, least.iterations)
        )
        found = marked(found, unfinished, Reason.NO_CONVERGENCE)
        assert found.reason is not None
        found.outcome[found.reason == Reason.NO_CONVERGENCE] = Outcome.OSCILLATED
        return replace(found, iterations=counts.astype(float), score=least.score)

    def trace(self, batch: Batch, scenario: Scenario, streams: Streams) -> dict[str, Array]:
        """Innovations of the filter at the start."""
        return self.start.trace(batch, scenario, streams)

    def _minimum(self, model: TrackModel, x: Array, P: Array) -> Minimum:
        """The minimum found from the start x (R, T, n), whose covariances are P (R, T, n, n)."""
        deviations, x = _deviations(P), np.ascontiguousarray(x)
        known = finite(x, 1) & finite(deviations, 1)
        going = np.asarray(known.any(axis=1))
        which = every = np.arange(len(x))
        weights = model.weights(x, deviations)
        at = model.quadratic(x, weights, every, Quadratic.empty(x))
        cost = model.cost(x, at, known, every)
        damping, count = np.zeros(len(x)), np.zeros(len(x), dtype=int)
        for i in range(self.iterations):
            which = np.flatnonzero(going)
            new, _ = model.solve(x, at.damped(damping[:, None, None] / deviations**2), which)
            moved = np.where(known[..., None], np.abs(new - x) / deviations, 0.0).max((1, 2))
            there = model.quadratic(new, weights, which, Quadratic.empty(x))
            now = model.cost(new, there, known, which)
            better = going & (now <= cost)
            level = better & (cost - now <= self.tolerance)
            x, at = _chosen(better, new, x), Quadratic(*map(partial(_chosen, better), there, at))
            count += going
            going = np.asarray(going & ~(moved <= self.tolerance) & ~level)
            if not going.any():
                break
            damping = np.where(better, damping / LESS, np.maximum(MORE * damping, FIRST_DAMPING))
            damping[damping < LEAST_DAMPING] = 0.0
            if i < REWEIGHTED:
                renewed = _chosen(going, model.weights(x, deviations), weights)
                if not np.array_equal(renewed, weights):
                    weights, at = renewed, model.quadratic(x, renewed, every, at)
            cost = model.cost(x, at, known, every)
        score = np.sqrt(at.squares / (weights > 0).sum(axis=-1))  # NaN without any
        return Minimum(x, model.solve(x, at, every)[1], count, going, score)


def _deviations(P: Array) -> Array:
    """Standard deviations (R, T, n) of covariances (R, T, n, n)."""
    return np.sqrt(np.einsum("rtii->rti", P))


def _chosen(which: np.ndarray, first: Array, second: Array) -> Array:
    """The replications of `first` (R, ...) where `which` (R,), else those of `second`."""
    return np.where(which.reshape(-1, *(1,) * (first.ndim - 1)), first, second)
