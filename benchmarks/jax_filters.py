"""One lap of the square track in JAX: EKF, UKF and particle filter, each one compiled scan.

The Kalman filters run in double precision over 128 copies of the lap at once (vmap), the particle
filter in single precision. XLA gets one thread.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

os.environ.setdefault(
    "XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
)
os.environ.setdefault("JAX_PLATFORMS", "cpu")

import jax
import jax.numpy as jnp
import numpy as np

from aoabench.filters.belief import believed
from aoabench.maths.geometry import Array
from aoabench.roles import Scenario
from aoabench.types import Batch

jax.config.update("jax_enable_x64", True)
COPIES = 128
Value = Any  # an array of JAX


class Jax:
    """The filters for one replication's measurements (1, T, B) with a deviation in rad.

    A measurement is azimuth and elevation of each anchor in turn (2 B,).
    """

    laps = COPIES  # that a Kalman filter computes in one call

    def __init__(self, scenario: Scenario, batch: Batch, sigma: float, particles: int) -> None:
        belief = believed(batch, scenario)
        T, B = batch.azimuth.shape[1:]
        y = np.stack([batch.azimuth[0], batch.elevation[0]], axis=-1).reshape(T, 2 * B)
        place, turn = (jnp.asarray(a[0]) for a in batch.anchors.frames)
        mean, cov, F, Q = (
            jnp.asarray(a) for a in (belief.mean[0], belief.covariance, *belief.at(0))
        )

        def seen(x: Value) -> Value:
            u, v, w = jnp.einsum("bij,bj->ib", turn, x - place)
            return jnp.stack([jnp.arctan2(v, u), jnp.arctan2(w, jnp.hypot(u, v))], -1).ravel()

        given = (seen, mean, cov, F, Q, sigma**2)
        self.copies = jnp.tile(jnp.asarray(y), (COPIES, 1, 1))
        self._ekf = jax.jit(jax.vmap(_kalman(_linearised, *given)))
        self._ukf = jax.jit(jax.vmap(_kalman(_unscented, *given)))
        place, turn, mean, cov, Q = (
            jnp.asarray(a, jnp.float32) for a in (place, turn, mean, cov, Q)
        )
        self._pf = jax.jit(_particle_filter(place, turn, mean, cov, Q, float(sigma), particles))
        self.single, self.key = jnp.asarray(y, jnp.float32), jax.random.key(0)

    def ekf(self) -> Array:
        """Positions (T, 3) m of the extended Kalman filter."""
        return np.asarray(self._ekf(self.copies))[0]

    def ukf(self) -> Array:
        """Positions (T, 3) m of the unscented Kalman filter."""
        return np.asarray(self._ukf(self.copies))[0]

    def particle_filter(self) -> Array:
        """Positions (T, 3) m of the particle filter."""
        return np.asarray(self._pf(self.single, self.key))


def _wrapped(d: Value) -> Value:
    """Differences (..., 2 B) with azimuths wrapped."""
    turns = jnp.round(d[..., ::2] / (2 * jnp.pi))
    return d.at[..., ::2].add(-2 * jnp.pi * turns)


def _kalman(
    moments: Callable[..., Any], seen: Value, mean: Value, cov: Value, F: Value, Q: Value, r: float
) -> Callable[[Value], Value]:
    """A filter of measurements (T, 2 B): positions (T, 3)."""

    def step(state: Value, y: Value) -> Value:
        x, P = F @ state[0], F @ state[1] @ F.T + Q
        v, S, C = moments(seen, x, P, y)
        K = jnp.linalg.solve(S + r * jnp.eye(len(y)), C.T).T
        x, P = x + K @ v, P - K @ C.T
        return (x, P), x

    return lambda y: jax.lax.scan(step, (mean, cov), y)[1]


def _linearised(seen: Value, x: Value, P: Value, y: Value) -> Value:
    """Innovation, its covariance without noise, and its covariance with the state."""
    H = jax.jacfwd(seen)(x)
    C = P @ H.T
    return _wrapped(y - seen(x)), H @ C, C


def _unscented(seen: Value, x: Value, P: Value, y: Value) -> Value:
    """The same by sigma points, Julier's with kappa 0.5."""
    n, kappa = len(x), 0.5
    root = jnp.linalg.cholesky((n + kappa) * P).T
    points = jnp.concatenate([x[None], x + root, x - root])
    w = jnp.full(2 * n + 1, 0.5 / (n + kappa)).at[0].set(kappa / (n + kappa))
    h = jax.vmap(seen)(points)
    d = _wrapped(h - h[0])
    centre = w @ d
    d = d - centre
    return _wrapped(y - h[0] - centre), (w * d.T) @ d, (w * (points - x).T) @ d


def _particle_filter(
    place: Value, turn: Value, mean: Value, cov: Value, Q: Value, sigma: float, n: int
) -> Callable[[Value, Value], Value]:
    """A particle filter of measurements (T, 2 B): positions (T, 3)."""
    root = jnp.sqrt(jnp.diag(Q))

    def loglik(x: Value, y: Value) -> Value:
        u, v, w = jnp.einsum("bij,bjn->ibn", turn, x[None] - place[:, :, None])
        d = jnp.stack([jnp.arctan2(v, u), jnp.arctan2(w, jnp.hypot(u, v))], -1)
        d = y.reshape(-1, 1, 2) - d
        turns = jnp.round(d[..., 0] / (2 * jnp.pi))
        square = (d[..., 0] - 2 * jnp.pi * turns) ** 2 + d[..., 1] ** 2
        return -0.5 / sigma**2 * square.sum(axis=0)

    def resampled(x: Value, w: Value, u: Value) -> Value:
        at = jnp.searchsorted(jnp.cumsum(w), (jnp.arange(n) + u) / n)
        return x[:, jnp.minimum(at, n - 1)], jnp.full(n, 1 / n, jnp.float32)

    def step(state: Value, given: Value) -> Value:
        x, w, key = state
        y = given
        key, walk, draw = jax.random.split(key, 3)
        x = x + root[:, None] * jax.random.normal(walk, x.shape, jnp.float32)
        found = loglik(x, y)
        w = w * jnp.exp(found - found.max())
        w = w / w.sum()
        u = jax.random.uniform(draw, (), jnp.float32)
        estimate = x @ w
        few = 1 / (w @ w) < 0.1 * n
        x, w = jax.lax.cond(few, resampled, lambda x, w, u: (x, w), x, w, u)
        return (x, w, key), estimate

    def run(y: Value, key: Value) -> Value:
        key, first = jax.random.split(key)
        normals = jax.random.normal(first, (3, n), jnp.float32)
        x = mean[:, None] + jnp.linalg.cholesky(cov) @ normals
        return jax.lax.scan(step, (x, jnp.full(n, 1 / n, jnp.float32), key), y)[1]

    return run
