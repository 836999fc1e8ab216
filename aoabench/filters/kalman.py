"""Kalman filters over a tile of replications: EKF and UKF, for any measurement model with
uncorrelated components.

Both carry a square root B of the covariance, P = B B^T, and take one component of the measurement
after the other, each as v = f^T z + e for a state x + B z (`roots.absorb`):

    EKF   B = L, the Cholesky factor of P, and f = L^T C^T
    UKF   B and f are the weighted deviations of the sigma points and of their images

which equals K = P C^T (C P C^T + R)^-1, P+ = P - K S K^T [Nurminen 2018, Alg. 2 and 3; errata
N1-N8], and is positive definite however exact the measurement is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from aoabench import kernels
from aoabench.filters.kernels import innovations, kind_of, variances
from aoabench.filters.roots import absorb, covariance, predicted, prior_root
from aoabench.geometry import Array
from aoabench.streams import Streams
from aoabench.types import (
    Anchors,
    BadValue,
    Batch,
    Estimates,
    Measurement,
    Outcome,
    check_choice,
    check_number,
)

if TYPE_CHECKING:  # loaded by name; results depend on it, and store.source_hash must see that
    from aoabench.filters import kalman_kernels  # noqa: F401

KERNELS = "filters.kalman_kernels"


@dataclass(frozen=True)
class _Kalman:
    """The recursion that both filters share; the scenario brings the motion model and the prior.

    `engine`: `auto` takes the compiled kernel where there is one for the measurement model and its
    variances are not below `finest`, `numpy` never does.
    """

    measurement: Measurement
    _: KW_ONLY
    engine: str = "auto"
    tile: ClassVar[int] = 128
    finest: ClassVar[float] = 0.0  # the kernel's least variance

    def __post_init__(self) -> None:
        kernels.check_engine(self.engine)

    def prepare(self, say: Callable[[str], None]) -> None:
        """Compile what is needed, before others work in parallel."""
        if self.kernel() is not None:
            kernels.prepare(KERNELS, say)

    def __call__(self, batch: Batch, scenario: Any, streams: Streams) -> Estimates:
        """Filtered positions (R, T, 3) m and covariances (R, T, 3, 3) m^2."""
        if scenario.motion is None or batch.prior_mean is None or batch.prior_cov is None:
            raise BadValue(
                "filter", type(self).__name__, "a scenario with a motion model and a prior"
            )
        F, Q = scenario.motion.matrices(scenario.dt)
        Y, quality = self.measurement.observe(batch)
        table = variances(self.measurement)
        kernel = None if min(quality.min(), table.min()) < self.finest else self.kernel()
        compiled = None if kernel is None else kernels.load(KERNELS)
        if kernel is None or compiled is None:
            position, P = self._recursion(batch, F, Q, Y, quality)
        else:
            position, P = np.empty((*Y.shape[:2], 3)), np.empty((*Y.shape[:2], 3, 3))
            function, kind, *more = kernel
            model, anchors = (batch.prior_mean, prior_root(batch.prior_cov), F, Q), batch.anchors
            arrays = (
                *model,
                Y,
                quality,
                anchors.position,
                anchors.rotation,
                table,
            )
            given = (np.ascontiguousarray(a, dtype=float) for a in arrays)
            getattr(compiled, function)(kind, *given, position, P, *more)
        finite = np.asarray(np.isfinite(position).all(-1) & np.isfinite(P).all((-1, -2)))
        position = np.where(finite[..., None], position, np.nan)
        return Estimates(
            position, P, None, np.where(finite, Outcome.OK, Outcome.FAILED).astype(np.int8)
        )

    def trace(self, batch: Batch, scenario: Any, streams: Streams) -> dict[str, Array]:
        """Innovations (R, T) at the predicted mean, by component."""
        seen: list[Array] = []
        F, Q = scenario.motion.matrices(scenario.dt)
        self._recursion(batch, F, Q, *self.measurement.observe(batch), seen)
        return innovations(np.stack(seen, axis=1), batch.azimuth.shape[2])

    def _recursion(
        self,
        batch: Batch,
        F: Array,
        Q: Array,
        Y: Array,
        quality: Array,
        seen: list[Array] | None = None,
    ) -> tuple[Array, Array]:
        """The same in NumPy, for any measurement model; innovations (R, m) go to `seen`."""
        h = self.measurement
        x, B = np.asarray(batch.prior_mean), prior_root(np.asarray(batch.prior_cov))
        B = np.broadcast_to(B, (*x.shape, x.shape[-1]))
        means, covariances = [], []
        with np.errstate(
            all="ignore"
        ):  # a replication that overflows becomes NaN and is counted as failed
            for k in range(Y.shape[1]):
                x, L = x @ F.T, predicted(B, F, Q)
                if seen is not None:
                    seen.append(h.residual(Y[:, k], h.predict(x, batch.anchors)))
                x, B = self.update(x, L, Y[:, k], quality[:, k], batch.anchors)
                means.append(x[:, :3])
                covariances.append(covariance(B[:, :3]))
        return np.stack(means, axis=1), np.stack(covariances, axis=1)

    def update(
        self, x: Array, L: Array, y: Array, r: Array, anchors: Anchors
    ) -> tuple[Array, Array]:
        """Posterior mean (R, n) and a root (R, n, k) of its covariance.

        From the prior's mean and lower Cholesky factor L (R, n, n), y (R, m) and its variances r
        (R, m).
        """
        raise NotImplementedError

    def kernel(self) -> tuple[Any, ...] | None:
        """Compiled function, number of the measurement model and further arguments; None if there
        is none.
        """
        return None


@dataclass(frozen=True)
class EKF(_Kalman):
    """Extended Kalman filter: h linearised at the predicted mean [Nurminen 2018, Alg. 2]."""

    def kernel(self) -> tuple[Any, ...] | None:
        kind = kind_of(self.measurement, self.engine)
        return None if kind is None or type(self) is not EKF else ("ekf", kind)

    def update(
        self, x: Array, L: Array, y: Array, r: Array, anchors: Anchors
    ) -> tuple[Array, Array]:
        h = self.measurement
        f = np.swapaxes(h.jacobian(x, anchors) @ L, -1, -2)
        v = h.residual(y, h.predict(x, anchors))
        return absorb(x, L, f, v, h.covariance(x, anchors, r))


@dataclass(frozen=True)
class UKF(_Kalman):
    """Unscented Kalman filter with 2 n + 1 sigma points [Nurminen 2018, Alg. 3]; `lambda_` >= 0
    spreads them.

    Angles are averaged as deviations from the central point's. Where the variances depend on the
    state, `form` says how: `averaged` over the sigma points, at the `centre`, or `augmented` (the
    noise is a part of the sigma points).
    """

    lambda_: float = 0.5
    form: str = "averaged"
    finest: ClassVar[float] = 1e-12  # rad^2; squares of more exact angles swallow what others say

    def __post_init__(self) -> None:
        super().__post_init__()
        check_number("lambda_", self.lambda_, least=0)
        check_choice("form", self.form, ("averaged", "centre", "augmented"))

    def kernel(self) -> tuple[Any, ...] | None:
        kind = kind_of(self.measurement, self.engine)
        if kind is None or type(self) is not UKF or self.form == "augmented":
            return None
        return "ukf", kind, float(self.lambda_), ("averaged", "centre").index(self.form)

    def update(
        self, x: Array, L: Array, y: Array, r: Array, anchors: Anchors
    ) -> tuple[Array, Array]:
        if self.form == "augmented":
            return self._augmented(x, L, y, r, anchors)
        h = self.measurement
        points, w = sigma_points(x, L, self.lambda_)
        images = h.predict(points, anchors)
        deviation = h.residual(images, images[:, :1])
        mean = w @ deviation
        if self.form == "centre":
            R = h.covariance(x, anchors, r)
        else:
            R = (w[:, None] * np.broadcast_to(h.covariance(points, anchors, r), images.shape)).sum(
                axis=1
            )
        B = np.swapaxes(np.sqrt(w)[:, None] * (points - x[:, None]), -1, -2)  # (R, n, S)
        f = np.sqrt(w)[:, None] * (deviation - mean[:, None])  # (R, S, m)
        return absorb(x, B, f, h.residual(y, images[:, 0] + mean), R)

    def _augmented(
        self, x: Array, L: Array, y: Array, r: Array, anchors: Anchors
    ) -> tuple[Array, Array]:
        """Sigma points of (x, e), e ~ N(0, I) in m dimensions, through h(x) + sigma(x) e."""
        h, (n, m) = self.measurement, (x.shape[-1], y.shape[-1])
        both = np.zeros((len(x), n + m, n + m))
        both[:, :n, :n] = L
        both[:, n:, n:] = np.eye(m)
        centre = np.concatenate([x, np.zeros((len(x), m))], axis=-1)
        points, w = sigma_points(centre, both, self.lambda_)
        state = np.ascontiguousarray(points[..., :n])
        images = h.predict(state, anchors)
        deviation = (
            h.residual(images, images[:, :1])
            + np.sqrt(h.covariance(state, anchors, r)) * points[..., n:]
        )
        mean = w @ deviation
        B = np.swapaxes(np.sqrt(w)[:, None] * (state - x[:, None]), -1, -2)
        f = np.sqrt(w)[:, None] * (deviation - mean[:, None])
        v = h.residual(y, images[:, 0] + mean)
        return absorb(x, B, f, v, np.zeros_like(v))  # the noise is in f


def sigma_points(x: Array, L: Array, lambda_: float) -> tuple[Array, Array]:
    """Points (R, 2n+1, n) x, x + sqrt(n + lambda) L_i, x - sqrt(n + lambda) L_i, and their weights
    (2n+1,).
    """
    n = x.shape[-1]
    spread = np.sqrt(n + lambda_) * np.swapaxes(L, -1, -2)
    points = np.concatenate([x[:, None], x[:, None] + spread, x[:, None] - spread], axis=1)
    weights = np.full(2 * n + 1, 0.5 / (n + lambda_))
    weights[0] = lambda_ / (n + lambda_)
    return points, weights
