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

from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np

from aoabench.filters.compiled import kind_of
from aoabench.filters.trace import innovations
from aoabench.kernels.loading import Compiled, engine_param
from aoabench.maths.geometry import Array
from aoabench.params import param
from aoabench.roles import Belief, Filter, Measurement, Scenario, believed
from aoabench.streams import Streams
from aoabench.types import Anchors, Batch, Estimates, Outcome

if TYPE_CHECKING:  # loaded by name; results depend on it, and store.source_hash must see that
    from aoabench.kernels import kalman  # noqa: F401
from aoabench.maths.linalg import cholesky

KERNELS = "kernels.kalman"


@dataclass(frozen=True)
class _Kalman(Compiled, Filter):
    """The recursion that both filters share; the scenario brings the motion model and the prior."""

    measurement: Measurement = param(
        help="what the filter believes of the measurements", kind=Measurement
    )
    _: KW_ONLY
    engine: str = engine_param()
    tile = 128
    kernels = KERNELS

    def prepare(self, say: Callable[[str], None]) -> None:
        """Compile or load the kernels, where there is one for the measurement model."""
        if self.kind() is not None:
            super().prepare(say)

    def __call__(self, batch: Batch, scenario: Scenario, streams: Streams) -> Estimates:
        """Filtered positions (R, T, 3) m and covariances (R, T, 3, 3) m^2."""
        belief, (Y, quality) = believed(batch, scenario), self.measurement.observe(batch)
        kind = self.kind()
        compiled = None if kind is None else self.compiled(batch.anchors)
        if kind is None or compiled is None:
            position, covariance = self._recursion(batch.anchors, belief, Y, quality)
        else:
            position, covariance = np.empty((*Y.shape[:2], 3)), np.empty((*Y.shape[:2], 3, 3))
            table = self.measurement.variances()
            arrays = (*belief, Y, quality, *batch.anchors.frames, table)
            given = [np.ascontiguousarray(a, dtype=float) for a in arrays]
            self._compiled(compiled, kind, given, position, covariance)
        finite = np.asarray(np.isfinite(position).all(-1) & np.isfinite(covariance).all((-1, -2)))
        position = np.where(finite[..., None], position, np.nan)
        outcome = np.where(finite, Outcome.OK, Outcome.FAILED).astype(np.int8)
        return Estimates(position, covariance, None, outcome)

    def trace(self, batch: Batch, scenario: Scenario, streams: Streams) -> dict[str, Array]:
        """Innovations (R, T) at the predicted mean, by component."""
        seen: list[Array] = []
        measured = self.measurement.observe(batch)
        self._recursion(batch.anchors, believed(batch, scenario), *measured, seen)
        return innovations(np.stack(seen, axis=1), batch.azimuth.shape[2])

    def _recursion(
        self,
        anchors: Anchors,
        belief: Belief,
        Y: Array,
        quality: Array,
        seen: list[Array] | None = None,
    ) -> tuple[Array, Array]:
        """Means (R, T, 3) and covariances (R, T, 3, 3) in NumPy, for any measurement model;
        innovations (R, m) are appended to `seen`.
        """
        h, F = self.measurement, belief.F
        x = np.asarray(belief.mean)
        P = np.broadcast_to(belief.covariance, (*x.shape, x.shape[-1]))
        means, covariances = [], []
        with np.errstate(all="ignore"):  # what overflows becomes NaN and is counted as failed
            for k in range(Y.shape[1]):
                here = anchors.at(k)
                x, P = x @ F.T, F @ P @ F.T + belief.Q
                if seen is not None:
                    seen.append(h.residual(Y[:, k], h.predict(x, here)))
                x, P = self.update(x, P, Y[:, k], quality[:, k], here)
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

    def kind(self) -> int | None:
        """The number of the measurement model in the kernels; None where NumPy computes."""
        return None

    def _compiled(
        self,
        compiled: ModuleType,
        kind: int,
        given: Sequence[Array],
        position: Array,
        covariance: Array,
    ) -> None:
        """Fill in means (R, T, 3) and covariances (R, T, 3, 3) by the kernel."""
        raise NotImplementedError


@dataclass(frozen=True)
class EKF(_Kalman):
    """Extended Kalman filter: h linearised at the predicted mean [Nurminen 2018, Alg. 2]."""

    def kind(self) -> int | None:
        return kind_of(self.measurement, self.engine) if type(self) is EKF else None

    def _compiled(
        self,
        compiled: ModuleType,
        kind: int,
        given: Sequence[Array],
        position: Array,
        covariance: Array,
    ) -> None:
        compiled.ekf(kind, *given, position, covariance)

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
    """Unscented Kalman filter with 2 n + 1 sigma points [Nurminen 2018, Alg. 3].

    Angles are averaged as deviations from the central point's.
    """

    lambda_: float = param(0.5, "spread of the sigma points", least=0)
    form: str = param(
        "averaged",
        "variances that depend on the state: averaged over the sigma points, at the centre, "
        "or augmented (the noise is a part of the sigma points)",
        choices=("averaged", "centre", "augmented"),
    )

    def kind(self) -> int | None:
        if type(self) is not UKF or self.form == "augmented":
            return None
        return kind_of(self.measurement, self.engine)

    def _compiled(
        self,
        compiled: ModuleType,
        kind: int,
        given: Sequence[Array],
        position: Array,
        covariance: Array,
    ) -> None:
        form = ("averaged", "centre").index(self.form)
        compiled.ukf(kind, *given, position, covariance, float(self.lambda_), form)

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
