"""Bootstrap particle filter for any measurement model with a likelihood.

Weights live as logarithms: kappa = 1e6 and many steps without resampling do not underflow [Nurminen
2018, Alg. 1]:

    x_k^i ~ N(F x_{k-1}^i, Q),   log w_k^i = log w_{k-1}^i + log p(y_k | x_k^i),
    x_k = sum_i w_k^i x_k^i

and where 1 / sum_i (w_k^i)^2 < `resample_below` N, the particles are resampled systematically.

`ParticleFilter` has it twice: as the readable reference in NumPy and double precision, and as a
compiled kernel in single precision (`particle_kernels.py`) for the measurement models that name
one.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from types import ModuleType
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from aoabench import kernels
from aoabench.filters.kernels import KINDS, innovations, kind_of, variances
from aoabench.geometry import Array
from aoabench.streams import PARTICLES, Streams
from aoabench.types import Anchors, BadValue, Batch, Estimates, Measurement, Outcome, check_number

if TYPE_CHECKING:  # loaded by name; results depend on it, and store.source_hash must see that
    from aoabench.filters import particle_kernels  # noqa: F401

KERNELS = "filters.particle_kernels"
SHARED_BYTES = (
    2**26
)  # the normals of one replication are kept for the next filter if they fit into this


@dataclass(frozen=True)
class ParticleFilter:
    """`particles` > 0 of them; resampled where the effective number falls below the fraction
    `resample_below`.

    Every draw depends on the replication alone, never on the weights: all particle filters of one
    replication move their particles by the same noise. `engine`: `auto` takes the compiled kernel
    where there is one for the measurement model and the state is the position; `numpy` never does,
    and has draws of its own; `double` is `numpy` along the kernel's draws, to see what single
    precision does.
    """

    measurement: Measurement
    particles: int = 10_000
    resample_below: float = 0.1
    engine: str = "auto"
    tile: ClassVar[int] = 1  # one replication at a time: the particles are the batch

    def __post_init__(self) -> None:
        check_number("particles", self.particles, least=1, most=10_000_000, integer=True)
        check_number("resample_below", self.resample_below, least=0, most=1)
        kernels.check_engine(self.engine, ("double",))

    def prepare(self, say: Callable[[str], None]) -> None:
        """Compile what is needed, before others work in parallel."""
        if kind_of(self.measurement, self.engine) is not None:
            kernels.prepare(KERNELS, say)

    def __call__(self, batch: Batch, scenario: Any, streams: Streams) -> Estimates:
        """Posterior means (R, T, 3) m and covariances (R, T, 3, 3) m^2.

        A step whose likelihood is 0 (or NaN) at every particle tells nothing: the particles keep
        their weights, and the fix is `diverged`.
        """
        if scenario.motion is None or batch.prior_mean is None or batch.prior_cov is None:
            raise BadValue(
                "filter", type(self).__name__, "a scenario with a motion model and a prior"
            )
        found = self._each(batch, scenario, streams)
        position, outcome = np.stack([one[0] for one in found]), np.stack([one[2] for one in found])
        outcome[~np.isfinite(position).all(-1)] = Outcome.FAILED
        return Estimates(position, np.stack([one[1] for one in found]), None, outcome)

    def trace(self, batch: Batch, scenario: Any, streams: Streams) -> dict[str, Array]:
        """Effective numbers of particles `ess` (R, T) and innovations (R, T) at the predicted mean,
        by component.
        """
        found = self._each(batch, scenario, streams)
        columns = {"ess": np.stack([one[3] for one in found])}
        F, _ = scenario.motion.matrices(scenario.dt)
        if len(F) == 3:  # elsewhere the mean of the whole state is not kept
            h, means = self.measurement, np.stack([one[0] for one in found])
            Y, _ = h.observe(batch)
            x = np.concatenate([np.asarray(batch.prior_mean)[:, None], means[:, :-1]], axis=1) @ F.T
            seen = [
                h.residual(Y[:, k], h.predict(x[:, k], batch.anchors)) for k in range(Y.shape[1])
            ]
            columns |= innovations(np.stack(seen, axis=1), batch.azimuth.shape[2])
        return columns

    def _each(
        self, batch: Batch, scenario: Any, streams: Streams
    ) -> list[tuple[Array, Array, np.ndarray, Array]]:
        """Per replication means (T, 3), covariances (T, 3, 3), outcomes (T,), effective numbers
        (T,).
        """
        Y, quality = self.measurement.observe(batch)
        F, Q = scenario.motion.matrices(scenario.dt)
        kind = kind_of(self.measurement, self.engine) if len(F) == 3 else None
        compiled = None if kind is None else kernels.load(KERNELS)
        found = []
        for i in range(len(Y)):
            given = batch, i, F, Q, Y[i], quality[i]
            if self.engine == "double":
                found.append(self._along_the_kernel(*given, streams))
            elif kind is None or compiled is None:
                found.append(self._replication(*given, streams.estimator(i, PARTICLES)))
            else:
                found.append(self._compiled(compiled, kind, *given, streams))
        return found

    def _replication(
        self,
        batch: Batch,
        i: int,
        F: Array,
        Q: Array,
        Y: Array,
        quality: Array,
        rng: Any,
        chosen: np.ndarray | None = None,
    ) -> tuple[Array, Array, np.ndarray, Array]:
        """One replication in NumPy: what `_each` says of it, from Y, quality (T, m).

        `chosen` (T, 2, N): parents that somebody else chose by weights q, -1 where nobody did;
        children keep w / q.
        """
        assert batch.prior_mean is not None
        assert batch.prior_cov is not None
        (T, _), N, n = Y.shape, self.particles, len(F)
        position, covariance, outcome = (
            np.empty((T, 3)),
            np.empty((T, 3, 3)),
            np.full(T, Outcome.OK, dtype=np.int8),
        )
        effective = np.empty(T)
        root_Q, root_P = np.linalg.cholesky(Q), np.linalg.cholesky(batch.prior_cov)
        anchors = batch.anchors.of(i)
        x = batch.prior_mean[i] + rng.standard_normal((N, n)) @ root_P.T
        log_w = np.full(N, -np.log(N))
        for k in range(T):
            x = x @ F.T + rng.standard_normal((N, n)) @ root_Q.T
            loglik = self.measurement.loglik(x[None], anchors, Y[None, k], quality[None, k])[0]
            turn = rng.random()
            log_w, w, informed = reweigh(log_w, loglik)
            if not informed:
                outcome[k] = Outcome.DIVERGED
            position[k] = w @ x[:, :3]
            effective[k] = 1.0 / (w @ w)
            d = x[:, :3] - position[k]
            covariance[k] = d.T @ (w[:, None] * d)
            if chosen is not None:
                if chosen[k, 0, 0] >= 0:
                    parents = chosen[k, 0].astype(np.intp)
                    x, log_w = x[parents], np.log(w[parents] / chosen[k, 1, parents])
            elif effective[k] < self.resample_below * N:
                x = x[systematic(w, turn)]
                log_w = np.full(N, -np.log(N))
        return position, covariance, outcome, effective

    def _compiled(
        self,
        compiled: ModuleType,
        kind: int,
        batch: Batch,
        i: int,
        F: Array,
        Q: Array,
        Y: Array,
        quality: Array,
        streams: Streams,
        chosen: np.ndarray | None = None,
    ) -> tuple[Array, Array, np.ndarray, Array]:
        """The same by the kernel, relative to the prior's mean; `chosen` as above, filled in."""
        assert batch.prior_mean is not None
        assert batch.prior_cov is not None
        T, origin = len(Y), batch.prior_mean[i]
        key, replication = streams.philox_key(PARTICLES), streams.replications[i]
        noise = shared_normals(compiled, key, replication, T + 1, self.particles)
        out = np.empty((T, 13))
        compiled.lap(
            kind,
            self.particles,
            noise,
            replication,
            *key,
            F,
            F @ origin - origin,
            np.linalg.cholesky(Q),
            np.linalg.cholesky(batch.prior_cov),
            terms(kind, Y, quality, batch.anchors.of(i), origin),
            weights_table(self.measurement),
            self.resample_below,
            out,
            np.empty((0, 2, self.particles), dtype=np.float32) if chosen is None else chosen,
        )
        outcome = np.full(T, Outcome.OK, dtype=np.int8)
        return out[:, :3] + origin, out[:, 3:12].reshape(T, 3, 3), outcome, out[:, 12]

    def _along_the_kernel(
        self, batch: Batch, i: int, F: Array, Q: Array, Y: Array, quality: Array, streams: Streams
    ) -> tuple[Array, Array, np.ndarray, Array]:
        """The replication in double precision with the kernel's draws and the parents that the
        kernel chose.

        Resampled particles carry the ratio of the weights in double and in single precision, so
        this is a particle filter in its own right; what differs from the kernel is rounding alone.
        Left to itself it would choose another parent at the first tie of last bits, and drift apart
        by as much as two filters with different seeds.
        """
        kind = kind_of(self.measurement) if len(F) == 3 else None
        compiled = None if kind is None else kernels.load(KERNELS)
        if kind is None or compiled is None:
            raise BadValue(
                "engine", "double", "auto or numpy where there is no kernel, or no numba"
            )
        chosen = np.full((len(Y), 2, self.particles), -1.0, dtype=np.float32)
        self._compiled(compiled, kind, batch, i, F, Q, Y, quality, streams, chosen)
        draws = _KernelDraws(compiled, streams.philox_key(PARTICLES), streams.replications[i])
        return self._replication(batch, i, F, Q, Y, quality, draws, chosen)


class _Shared(threading.local):
    """The normals that this thread drew last; the filters of one replication ask for the same ones
    in turn.
    """

    key: tuple[Any, ...] = ()
    memory = np.empty(0, dtype=np.float32)


_shared = _Shared()


def shared_normals(
    compiled: ModuleType, key: tuple[int, int], replication: int, planes: int, particles: int
) -> Any:
    """Standard normals (planes, 3, M), float32, of one replication, M = `particles` rounded up to
    whole tiles.

    Where they would take too much memory, (1, 3, M) for the kernel to draw them into, step by step.
    """
    M = -(-particles // compiled.TILE) * compiled.TILE
    kept = 12 * planes * M <= SHARED_BYTES
    shape = (planes if kept else 1, 3, M)
    size = shape[0] * 3 * M
    if len(_shared.memory) < size:
        _shared.memory, _shared.key = np.empty(size, dtype=np.float32), ()
    noise = _shared.memory[:size].reshape(shape)
    wanted = (key, replication, shape)
    if kept and _shared.key != wanted:
        _shared.key = ()
        for plane in range(planes):
            compiled.normals(noise[plane], plane, replication, *key)
        _shared.key = wanted
    elif not kept:
        _shared.key = ()
    return noise


@dataclass
class _KernelDraws:
    """The kernel's draws in the order in which the reference asks for them."""

    compiled: ModuleType
    key: tuple[int, int]
    replication: int
    normals: int = 0
    turns: int = 0

    def standard_normal(self, shape: tuple[int, int]) -> Array:
        """The next plane of normals, (N, 3)."""
        plane = np.empty(
            (3, -(-shape[0] // self.compiled.TILE) * self.compiled.TILE), dtype=np.float32
        )
        self.compiled.normals(plane, self.normals, self.replication, *self.key)
        self.normals += 1
        return plane[:, : shape[0]].T.astype(float)

    def random(self) -> float:
        """The next step's uniform number."""
        self.turns += 1
        return self.compiled.turn(self.turns, self.replication, *self.key)


def terms(kind: int, Y: Array, quality: Array, anchors: Anchors, origin: Array) -> np.ndarray:
    """The kernel's coefficients (T, B, 15), float32, of measurements Y (T, m) with nominal
    variances (T, m).

    See `particle_kernels.loglik`; what is not measured (NaN) gets the weight 0.
    """
    s, R = anchors.position[0] - origin, anchors.rotation[0]
    B = len(s)
    y, r = Y.reshape(len(Y), B, -1), quality.reshape(len(Y), B, -1)
    c = np.zeros((len(Y), B, 15))
    c[..., :3] = s
    known = ~np.isnan(y)
    y = np.where(known, y, 0.0)
    if kind == KINDS.index("unit_vector"):
        c[..., 3:6] = (y[..., None, :] @ R)[..., 0, :]
        c[..., 6] = np.where(known.all(-1), 0.5 / r[..., 0], 0.0)
        return c.astype(np.float32)
    cosine, sine = np.cos(y[..., :1]), np.sin(y[..., :1])
    c[..., 3:6] = cosine * R[:, 0] + sine * R[:, 1]
    c[..., 6:9] = cosine * R[:, 1] - sine * R[:, 0]
    c[..., 9:12] = R[:, 2]
    c[..., 12] = y[..., 1]
    c[..., 13:15] = known * (0.5 / r if kind == KINDS.index("azel") else 1.0)
    return c.astype(np.float32)


def weights_table(measurement: Measurement) -> np.ndarray:
    """w = 1 / (2 variance) and then log(w) / 2, each of azimuth and elevation in turn, at -90, -89
    ... 90 degrees.

    (724,) float32.
    """
    w = (0.5 / variances(measurement)).ravel()
    return np.concatenate([w, 0.5 * np.log(w)]).astype(np.float32)


def reweigh(log_w: Array, loglik: Array) -> tuple[Array, Array, bool]:
    """Normalised log weights and weights (N,) after a likelihood (N,), and whether it told
    anything.

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
    """Ancestors (N,) by systematic resampling of weights w (N,), sum 1, with one uniform `turn` in
    [0, 1).

    Particle i gets floor(N w_i) or one more children, N w_i of them in the mean. O(N): how many of
    the points (j + turn) / N, j = 0 ... N-1, lie below each cumulative weight.
    """
    N = len(w)
    below = np.ceil(N * np.cumsum(w) - turn)
    below[-1] = N  # whatever the sum's last bits
    counts = np.diff(np.clip(below, 0, N), prepend=0.0)
    return np.repeat(np.arange(N), counts.astype(np.intp))
