"""Bootstrap particle filter for any measurement model with a likelihood.

Weights are stored as logarithms, so that kappa = 1e6 and many steps without resampling do not
underflow [Nurminen 2018, Alg. 1]:

    x_k^i ~ N(F x_{k-1}^i, Q),   log w_k^i = log w_{k-1}^i + log p(y_k | x_k^i),
    x_k = sum_i w_k^i x_k^i

If 1 / sum_i (w_k^i)^2 < `resample_below` N, the particles are resampled systematically.

`ParticleFilter` has two implementations: a readable reference in NumPy and double precision, and a
compiled kernel in single precision (`kernels/particle.py`) for the measurement models that name
one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from types import ModuleType
from typing import NamedTuple, Protocol

import numpy as np

from aoabench.errors import BadValue
from aoabench.filters.belief import Belief, believed
from aoabench.filters.compiled import kind_of
from aoabench.filters.divergence import SINGULAR, ExtentBound, marked, sound
from aoabench.filters.particle_inputs import KernelDraws, shared_normals, terms, weights_table
from aoabench.filters.roots import moved, process_roots
from aoabench.filters.trace import innovations
from aoabench.kernels.limits import ONE_PARTICLE
from aoabench.kernels.loading import Compiled, engine_param, load
from aoabench.maths.geometry import Array
from aoabench.params import param
from aoabench.roles import Filter, Measurement, Scenario
from aoabench.streams import PARTICLES, Streams
from aoabench.types import Anchors, Batch, Estimates, Outcome, Reason

KERNELS = "kernels.particle"
_TILE_OF_PARTICLES = 2**16  # more of them at once save no time and take more memory


class Normals(Protocol):
    """Source of a filter's draws: numpy.random.Generator, or the kernel's own draws."""

    def standard_normal(self, shape: tuple[int, int]) -> Array: ...
    def random(self) -> float: ...


class Track(NamedTuple):
    """Input of some replications: the belief with means (R, n), measured values and their
    variances (R, T, m), and the anchors (R|1, T|1, B, ...).
    """

    belief: Belief
    Y: Array
    quality: Array
    anchors: Anchors

    def of(self, i: int) -> Track:
        """The input of one replication."""
        some = slice(i, i + 1)
        return Track(self.belief.of(i), self.Y[some], self.quality[some], self.anchors.of(i))


class Posterior(NamedTuple):
    """Result of some replications: means (R, T, 3) m, covariances (R, T, 3, 3) m^2, outcomes (R, T)
    and effective numbers of particles (R, T).
    """

    mean: Array
    covariance: Array
    outcome: np.ndarray
    effective: Array

    @classmethod
    def empty(cls, *shape: int) -> Posterior:
        """An empty result for (R, T) fixes, to be filled in."""
        outcome = np.empty(shape, dtype=np.int8)
        return cls(np.empty((*shape, 3)), np.empty((*shape, 3, 3)), outcome, np.empty(shape))

    @classmethod
    def joined(cls, parts: Sequence[Posterior]) -> Posterior:
        """The results of several sets of replications in one."""
        return cls(*(np.concatenate(arrays) for arrays in zip(*parts)))


@dataclass(frozen=True)
class ParticleFilter(ExtentBound, Compiled, Filter):
    """A bootstrap particle filter with systematic resampling.

    Every draw depends on the replication alone, never on the weights, so all particle filters of
    one replication move their particles by the same noise. The compiled kernel needs a state that
    is the position alone. The engine `numpy` has draws of its own; the engine `double` repeats the
    kernel in double precision, to show the effect of single precision.
    """

    measurement: Measurement = param(
        help="measurement model that the filter assumes", kind=Measurement
    )
    particles: int = param(10_000, "number of particles", least=1, most=10_000_000)
    resample_below: float = param(
        0.1,
        "ratio of effective to all particles below which particles are resampled",
        least=0,
        most=1,
    )
    engine: str = engine_param(double="NumPy with the kernel's draws")
    by_replication = True
    heard_only = True
    kernels = KERNELS
    entries = ("draw", "lap")
    per_step = True

    @property
    def tile(self) -> int:  # type: ignore[override]
        """Several replications at a time, fewer the more particles they have; up to 16."""
        most = max(min(_TILE_OF_PARTICLES // self.particles, 16), 1)
        return 1 << (most.bit_length() - 1)

    def prepare(self, say: Callable[[str], None]) -> None:
        """Compile or load the kernels, if the measurement model has one; `say` prints a line."""
        if kind_of(self.measurement, self.engine) is not None:
            super().prepare(say)

    def __call__(self, batch: Batch, scenario: Scenario, streams: Streams) -> Estimates:
        """Posterior means (R, T, 3) m and covariances (R, T, 3, 3) m^2.

        If the likelihood of a step is 0 or NaN at every particle, the particles keep their weights
        and the fix is DIVERGED with the reason NO_LIKELIHOOD. TOO_FAR and COVARIANCE are the other
        reasons; a covariance is degenerate if one particle has all the weight, or if particles lie
        in a plane to within single precision. Innovations are not judged: no covariance of the
        expected measurement describes a cloud of particles that a curved likelihood bends.
        """
        belief = believed(batch, scenario)
        posterior = self._posterior(batch, belief, streams)
        found = sound(posterior.mean, posterior.covariance)
        informed = posterior.outcome == Outcome.OK
        found = marked(found, ~informed, Reason.NO_LIKELIHOOD)
        judged = self.judged(found, batch.layout, belief, SINGULAR)
        return marked(judged, posterior.effective < ONE_PARTICLE, Reason.COVARIANCE)

    def trace(self, batch: Batch, scenario: Scenario, streams: Streams) -> dict[str, Array]:
        """Effective numbers of particles `ess` (R, T) and innovations (R, T) at the predicted mean,
        by component.
        """
        belief = believed(batch, scenario)
        found = self._posterior(batch, belief, streams)
        columns = {"ess": found.effective}
        if belief.size == 3:  # the mean of a larger state is not kept
            h, means = self.measurement, found.mean
            Y, _ = h.observe(batch)
            x = np.concatenate([belief.mean[:, None], means[:, :-1]], axis=1)
            states = [moved(x[:, k], belief.at(k)[0]) for k in range(Y.shape[1])]
            expected = [h.predict(each, batch.anchors.at(k)) for k, each in enumerate(states)]
            seen = [h.residual(Y[:, k], y) for k, y in enumerate(expected)]
            columns |= innovations(np.stack(seen, axis=1), batch.azimuth.shape[2])
        return columns

    @np.errstate(all="ignore")  # what is not finite is counted as failed
    def _posterior(self, batch: Batch, belief: Belief, streams: Streams) -> Posterior:
        """The posteriors of all replications."""
        track = Track(belief, *self.measurement.observe(batch), batch.anchors)
        kind = kind_of(self.measurement, self.engine) if belief.size == 3 else None
        compiled = None if kind is None else self.compiled(batch.anchors)
        if kind is not None and compiled is not None:
            return self._compiled(compiled, kind, track, streams)
        one = self._along_the_kernel if self.engine == "double" else self._in_numpy
        each = enumerate(streams.replications)
        return Posterior.joined(
            [one(track.of(i), replace(streams, replications=(r,))) for i, r in each]
        )

    def _in_numpy(self, track: Track, streams: Streams) -> Posterior:
        """One replication with draws of its own."""
        return self._reference(track, streams.estimator(0, PARTICLES))

    def _reference(self, track: Track, rng: Normals, chosen: np.ndarray | None = None) -> Posterior:
        """One replication in NumPy.

        `chosen` (T, 2, N): ancestors chosen by the compiled filter and its weights q, -1 at steps
        without resampling; offspring then carry the weights w / q.
        """
        belief, (Y,), (quality,), anchors = track
        T, N, n = len(Y), self.particles, belief.size
        found = Posterior.empty(1, T)
        outcome, means, covariances, effective = (
            found.outcome[0],
            found.mean[0],
            found.covariance[0],
            found.effective[0],
        )
        root_P, roots = np.linalg.cholesky(belief.covariance), process_roots(belief.Q[0])
        x = belief.mean[0] + rng.standard_normal((N, n)) @ root_P.T
        log_w = np.full(N, -np.log(N))
        for k in range(T):
            root_Q = roots[min(k, len(roots) - 1)]
            x = x @ belief.at(k)[0].T + rng.standard_normal((N, n)) @ root_Q.T
            here = anchors.at(k)
            loglik = self.measurement.loglik(x[None], here, Y[None, k], quality[None, k])[0]
            offset = rng.random()
            log_w, w, informed = reweigh(log_w, loglik)
            outcome[k] = Outcome.OK if informed else Outcome.DIVERGED
            means[k] = w @ x[:, :3]
            effective[k] = 1.0 / (w @ w)
            d = x[:, :3] - means[k]
            covariances[k] = d.T @ (w[:, None] * d)
            if chosen is not None:
                if chosen[k, 0, 0] >= 0:
                    parents = chosen[k, 0].astype(np.intp)
                    x, log_w = x[parents], np.log(w[parents] / chosen[k, 1, parents])
            elif effective[k] < self.resample_below * N:
                x = x[systematic(w, offset)]
                log_w = np.full(N, -np.log(N))
        return found

    def _compiled(
        self,
        compiled: ModuleType,
        kind: int,
        track: Track,
        streams: Streams,
        chosen: np.ndarray | None = None,
    ) -> Posterior:
        """All replications by the kernel, computed relative to the prior's means.

        `chosen` (R, T, 2, N), for each replication as in `_reference`, is filled in if given.
        """
        belief, Y, quality, anchors = track
        origins, N = belief.mean, self.particles
        R, T = Y.shape[:2]
        key, out = streams.philox_key(PARTICLES), np.empty((R, T, 13))
        root_P = np.linalg.cholesky(belief.covariance)
        coefficients = terms(kind, Y, quality, anchors, origins)
        table = weights_table(self.measurement, kind)
        if chosen is None:
            chosen = np.empty((R, 0, 2, N), dtype=np.float32)
        Fs, roots = np.ascontiguousarray(belief.F, dtype=float), process_roots(belief.Q)
        for i, (replication, origin) in enumerate(zip(streams.replications, origins)):
            F, root_Q = (A[min(i, len(A) - 1)] for A in (Fs, roots))
            noise = shared_normals(compiled, key, replication, T + 1, N, R)
            compiled.lap(
                kind, N, noise, replication, *key, F, F @ origin - origin, root_Q, root_P,
                coefficients[i], table, self.resample_below, out[i], chosen[i],
            )  # fmt: skip
        outcome = np.full((R, T), Outcome.OK, dtype=np.int8)
        mean, covariance = out[..., :3] + origins[:, None], out[..., 3:12].reshape(R, T, 3, 3)
        return Posterior(mean, covariance, outcome, out[..., 12])

    def _along_the_kernel(self, track: Track, streams: Streams) -> Posterior:
        """One replication in double precision with the kernel's draws and the ancestors that
        the kernel chose.

        The kernel chooses ancestors by its weights q in single precision. Each resampled particle
        therefore carries the ratio w / q, w being its weight in double precision. The result is a
        valid particle filter that differs from the kernel by rounding alone. If this filter chose
        ancestors by w, rounding would change an ancestor at the first near tie, and from then on
        both filters would differ like filters with different seeds. Raises BadValue without kernel.
        """
        kind = kind_of(self.measurement) if track.belief.size == 3 else None
        compiled = None if kind is None else load(KERNELS)
        if kind is None or compiled is None:
            allowed = "auto or numpy: double needs numba and a kernel for the model"
            raise BadValue("engine", "double", allowed)
        chosen = np.full((*track.Y.shape[:2], 2, self.particles), -1.0, dtype=np.float32)
        self._compiled(compiled, kind, track, streams, chosen)
        draws = KernelDraws(compiled, streams.philox_key(PARTICLES), streams.replications[0])
        return self._reference(track, draws, chosen[0])


def reweigh(log_w: Array, loglik: Array) -> tuple[Array, Array, bool]:
    """Normalised log weights and weights (N,) after a log likelihood (N,), and whether a particle
    has a likelihood above 0.

    A NaN counts as likelihood 0. If no particle has a likelihood above 0, the weights do not
    change.
    """
    new = log_w + np.where(np.isnan(loglik), -np.inf, loglik)
    top = new.max()
    informed = bool(np.isfinite(top))
    if not informed:
        new, top = log_w, log_w.max()
    w = np.exp(new - top)
    total = w.sum()
    return new - (top + np.log(total)), w / total, informed


def systematic(w: Array, offset: float) -> np.ndarray:
    """Ancestors (N,) by systematic resampling of weights w (N,), sum 1, with one uniform `offset`
    in [0, 1).

    Particle i gets floor(N w_i) children or one more, and N w_i on average. The cost is O(N): the
    points (j + offset) / N, j = 0 ... N-1, below each cumulative weight are counted.
    """
    N = len(w)
    below = np.ceil(N * np.cumsum(w) - offset)
    below[-1] = N  # despite rounding of the sum
    counts = np.diff(np.clip(below, 0, N), prepend=0.0)
    return np.repeat(np.arange(N), counts.astype(np.intp))
