"""Kalman filters over a tile of replications: EKF and UKF, for any measurement model with
uncorrelated components.

The state has few dimensions and the measurement many, so both updates invert in the small space.
With W = R^-1 (0 for a component that is not measured):

    EKF   P+ = L (I + L^T C^T W C L)^-1 L^T,  P = L L^T;   x+ = x + P+ C^T W (y - h(x))
    UKF   P+ = X (I + Z^T W Z)^-1 X^T,  X, Z the weighted deviations of sigma points and of their images

which equal K = P C^T (C P C^T + R)^-1, P+ = P - K S K^T [Nurminen 2018, Alg. 2 and 3; errata
N1-N8].
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from aoabench.errors import BadValue, check_choice, check_number
from aoabench.filters.compiled import kind_of, variances
from aoabench.filters.trace import innovations
from aoabench.kernels import loading
from aoabench.maths.geometry import Array
from aoabench.roles import Measurement
from aoabench.streams import Streams
from aoabench.types import Anchors, Batch, Estimates, Outcome

if TYPE_CHECKING:  # loaded by name; results depend on it, and store.source_hash must see that
    from aoabench.kernels import kalman  # noqa: F401
from aoabench.maths.linalg import cholesky

KERNELS = "kernels.kalman"


@dataclass(frozen=True)
class _Kalman:
    """The recursion that both filters share; the scenario brings the motion model and the prior.

    `engine`: `auto` takes the compiled kernel where there is one for the measurement model, `numpy`
    never does.
    """

    measurement: Measurement
    _: KW_ONLY
    engine: str = "auto"
    tile: ClassVar[int] = 128

    def __post_init__(self) -> None:
        loading.check_engine(self.engine)

    def prepare(self, say: Callable[[str], None]) -> None:
        """Compile what is needed, before others work in parallel."""
        if self.kernel() is not None:
            loading.prepare(KERNELS, say)

    def __call__(self, batch: Batch, scenario: Any, streams: Streams) -> Estimates:
        """Filtered positions (R, T, 3) m and covariances (R, T, 3, 3) m^2."""
        if scenario.motion is None or batch.prior_mean is None or batch.prior_cov is None:
            raise BadValue(
                "filter", type(self).__name__, "a scenario with a motion model and a prior"
            )
        F, Q = scenario.motion.matrices(scenario.dt)
        Y, quality = self.measurement.observe(batch)
        kernel = self.kernel()
        compiled = None if kernel is None else loading.load(KERNELS)
        if kernel is None or compiled is None:
            position, covariance = self._recursion(batch, batch.prior_cov, F, Q, Y, quality)
        else:
            position, covariance = np.empty((*Y.shape[:2], 3)), np.empty((*Y.shape[:2], 3, 3))
            function, kind, *more = kernel
            model, anchors = (batch.prior_mean, batch.prior_cov, F, Q), batch.anchors
            arrays = (
                *model,
                Y,
                quality,
                anchors.position,
                anchors.rotation,
                variances(self.measurement),
            )
            given = (np.ascontiguousarray(a, dtype=float) for a in arrays)
            getattr(compiled, function)(kind, *given, position, covariance, *more)
        finite = np.asarray(np.isfinite(position).all(-1) & np.isfinite(covariance).all((-1, -2)))
        position = np.where(finite[..., None], position, np.nan)
        return Estimates(
            position, covariance, None, np.where(finite, Outcome.OK, Outcome.FAILED).astype(np.int8)
        )

    def trace(self, batch: Batch, scenario: Any, streams: Streams) -> dict[str, Array]:
        """Innovations (R, T) at the predicted mean, by component."""
        seen: list[Array] = []
        F, Q = scenario.motion.matrices(scenario.dt)
        self._recursion(
            batch, np.asarray(batch.prior_cov), F, Q, *self.measurement.observe(batch), seen
        )
        return innovations(np.stack(seen, axis=1), batch.azimuth.shape[2])

    def _recursion(
        self,
        batch: Batch,
        P: Array,
        F: Array,
        Q: Array,
        Y: Array,
        quality: Array,
        seen: list[Array] | None = None,
    ) -> tuple[Array, Array]:
        """The same in NumPy, for any measurement model; innovations (R, m) are appended to `seen`."""
        h = self.measurement
        x = np.asarray(batch.prior_mean)
        P = np.broadcast_to(P, (*x.shape, x.shape[-1]))
        means, covariances = [], []
        with np.errstate(
            all="ignore"
        ):  # a replication that overflows becomes NaN and is counted as failed
            for k in range(Y.shape[1]):
                x = x @ F.T
                P = F @ P @ F.T + Q
                if seen is not None:
                    seen.append(h.residual(Y[:, k], h.predict(x, batch.anchors)))
                x, P = self.update(x, P, Y[:, k], quality[:, k], batch.anchors)
                means.append(x[:, :3])
                covariances.append(P[:, :3, :3])
        return np.stack(means, axis=1), np.stack(covariances, axis=1)

    def update(
        self, x: Array, P: Array, y: Array, r: Array, anchors: Anchors
    ) -> tuple[Array, Array]:
        """Posterior mean (R, n) and covariance (R, n, n) from the prior's, y (R, m) and its
        variances r (R, m).
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
        self, x: Array, P: Array, y: Array, r: Array, anchors: Anchors
    ) -> tuple[Array, Array]:
        h = self.measurement
        C = h.jacobian(x, anchors)
        v, W = weigh(h.residual(y, h.predict(x, anchors)), h.covariance(x, anchors, r))
        L = cholesky(P)
        CtW = np.swapaxes(C, -1, -2) * W[:, None, :]
        Lt = np.swapaxes(L, -1, -2)
        P = L @ np.linalg.solve(np.eye(x.shape[-1]) + Lt @ (CtW @ C) @ L, Lt)
        P = 0.5 * (P + np.swapaxes(P, -1, -2))
        return x + (P @ (CtW @ v[..., None]))[..., 0], P


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
        self, x: Array, P: Array, y: Array, r: Array, anchors: Anchors
    ) -> tuple[Array, Array]:
        if self.form == "augmented":
            return self._augmented(x, P, y, r, anchors)
        h = self.measurement
        points, w = sigma_points(x, cholesky(P), self.lambda_)
        images = h.predict(points, anchors)
        deviation = h.residual(images, images[:, :1])
        mean = w @ deviation
        if self.form == "centre":
            R = h.covariance(x, anchors, r)
        else:
            R = (w[:, None] * np.broadcast_to(h.covariance(points, anchors, r), images.shape)).sum(
                axis=1
            )
        v, W = weigh(h.residual(y, images[:, 0] + mean), R)
        X = np.sqrt(w)[:, None] * (points - x[:, None])  # (R, S, n)
        Z = np.sqrt(w)[:, None] * (deviation - mean[:, None])  # (R, S, m)
        ZW = Z * W[:, None, :]
        G = np.linalg.solve(np.eye(len(w)) + ZW @ np.swapaxes(Z, -1, -2), X)  # (R, S, n)
        Gt = np.swapaxes(G, -1, -2)
        P = Gt @ X
        return x + (Gt @ (ZW @ v[..., None]))[..., 0], 0.5 * (P + np.swapaxes(P, -1, -2))

    def _augmented(
        self, x: Array, P: Array, y: Array, r: Array, anchors: Anchors
    ) -> tuple[Array, Array]:
        """Sigma points of (x, e), e ~ N(0, I) in m dimensions, through h(x) + sigma(x) e."""
        h, (n, m) = self.measurement, (x.shape[-1], y.shape[-1])
        L = np.zeros((len(x), n + m, n + m))
        L[:, :n, :n] = cholesky(P)
        L[:, n:, n:] = np.eye(m)
        points, w = sigma_points(
            np.concatenate([x, np.zeros((len(x), m))], axis=-1), L, self.lambda_
        )
        state = np.ascontiguousarray(points[..., :n])
        images = h.predict(state, anchors)
        deviation = (
            h.residual(images, images[:, :1])
            + np.sqrt(h.covariance(state, anchors, r)) * points[..., n:]
        )
        mean = w @ deviation
        v = h.residual(y, images[:, 0] + mean)
        measured = ~np.isnan(v)
        X = np.sqrt(w)[:, None] * (state - x[:, None])
        Z = np.sqrt(w)[:, None] * (deviation - mean[:, None]) * measured[:, None, :]
        S = np.swapaxes(Z, -1, -2) @ Z + np.eye(m) * ~measured[:, None, :]
        Kt = np.linalg.solve(S, np.swapaxes(Z, -1, -2) @ X)  # (R, m, n)
        K = np.swapaxes(Kt, -1, -2)
        P = np.swapaxes(X, -1, -2) @ X - K @ S @ Kt
        return x + (K @ np.where(measured, v, 0.0)[..., None])[..., 0], 0.5 * (
            P + np.swapaxes(P, -1, -2)
        )


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


def weigh(residual: Array, variance: Array) -> tuple[Array, Array]:
    """Residuals and inverse variances, both 0 where a component is not measured (NaN)."""
    missing = np.isnan(residual)
    return np.where(missing, 0.0, residual), np.where(missing, 0.0, 1.0 / variance)
