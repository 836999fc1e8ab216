"""Bootstrap particle filter for any measurement model with a likelihood: the readable reference in double precision.

Weights live as logarithms: kappa = 1e6 and many steps without resampling do not underflow [Nurminen 2018, Alg. 1]:

    x_k^i ~ N(F x_{k-1}^i, Q),   log w_k^i = log w_{k-1}^i + log p(y_k | x_k^i),   x_k = sum_i w_k^i x_k^i

and where 1 / sum_i (w_k^i)^2 < `resample_below` N, the particles are resampled systematically.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from aoabench.geometry import Array
from aoabench.streams import PARTICLES, Streams
from aoabench.types import BadValue, Batch, Estimates, Measurement, Outcome, check_number


@dataclass(frozen=True)
class ParticleFilter:
    """`particles` > 0 of them; resampled where the effective number falls below the fraction `resample_below`.

    Every draw depends on the replication alone, never on the weights: all particle filters of one replication move
    their particles by the same noise.
    """

    measurement: Measurement
    particles: int = 10_000
    resample_below: float = 0.1
    tile: ClassVar[int] = 1  # one replication at a time: the particles are the batch

    def __post_init__(self) -> None:
        check_number("particles", self.particles, least=1, most=10_000_000, integer=True)
        check_number("resample_below", self.resample_below, least=0, most=1)

    def __call__(self, batch: Batch, scenario: Any, streams: Streams) -> Estimates:
        """Posterior means (R, T, 3) m and covariances (R, T, 3, 3) m^2.

        A step whose likelihood is 0 (or NaN) at every particle tells nothing: the particles keep their weights, and the
        fix is `diverged`.
        """
        if scenario.motion is None or batch.prior_mean is None or batch.prior_cov is None:
            raise BadValue("filter", type(self).__name__, "a scenario with a motion model and a prior")
        Y, quality = self.measurement.observe(batch)
        R, T, _ = Y.shape
        position, covariance = np.full((R, T, 3), np.nan), np.full((R, T, 3, 3), np.nan)
        outcome = np.full((R, T), Outcome.OK, dtype=np.int8)
        F, Q = scenario.motion.matrices(scenario.dt)
        root_Q, root_P = np.linalg.cholesky(Q), np.linalg.cholesky(batch.prior_cov)
        N, n = self.particles, len(F)
        for i in range(R):
            rng = streams.estimator(i, PARTICLES)
            anchors = batch.anchors.of(i)
            x = batch.prior_mean[i] + rng.standard_normal((N, n)) @ root_P.T
            log_w = np.full(N, -np.log(N))
            for k in range(T):
                x = x @ F.T + rng.standard_normal((N, n)) @ root_Q.T
                loglik = self.measurement.loglik(x[None], anchors, Y[i : i + 1, k], quality[i : i + 1, k])[0]
                turn = rng.random()
                log_w, w, informed = reweigh(log_w, loglik)
                if not informed:
                    outcome[i, k] = Outcome.DIVERGED
                position[i, k] = w @ x[:, :3]
                d = x[:, :3] - position[i, k]
                covariance[i, k] = d.T @ (w[:, None] * d)
                if 1.0 / (w @ w) < self.resample_below * N:
                    x = x[systematic(w, turn)]
                    log_w = np.full(N, -np.log(N))
        outcome[~np.isfinite(position).all(-1)] = Outcome.FAILED
        return Estimates(position, covariance, None, outcome)


def reweigh(log_w: Array, loglik: Array) -> tuple[Array, Array, bool]:
    """Normalised log weights and weights (N,) after a likelihood (N,), and whether it told anything.

    A NaN likelihood counts as 0. Where no particle is left, the weights stay as they were.
    """
    new = log_w + np.where(np.isnan(loglik), -np.inf, loglik)
    top = new.max()
    informed = bool(np.isfinite(top))
    if not informed:
        new, top = log_w, log_w.max()
    w = np.exp(new - top)
    total = w.sum()
    return new - (top + np.log(total)), w / total, informed


def systematic(w: Array, turn: float) -> np.ndarray:
    """Ancestors (N,) by systematic resampling of weights w (N,), sum 1, with one uniform `turn` in [0, 1).

    Particle i gets floor(N w_i) or one more children, N w_i of them in the mean. O(N): how many of the points
    (j + turn) / N, j = 0 ... N-1, lie below each cumulative weight.
    """
    N = len(w)
    below = np.ceil(N * np.cumsum(w) - turn)
    below[-1] = N  # whatever the sum's last bits
    counts = np.diff(np.clip(below, 0, N), prepend=0.0)
    return np.repeat(np.arange(N), counts.astype(np.intp))
