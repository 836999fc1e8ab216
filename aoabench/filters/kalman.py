"""Kalman filters over a tile of replications: EKF and UKF, for any measurement model with
uncorrelated components.

Both keep a square root B of the covariance, P = B B^T, and process the components of the
measurement one after the other, each as v = f^T z + e for a state x + B z (`roots.absorb`):

    EKF   B = L, the Cholesky factor of P, and f = L^T C^T
    UKF   B and f are the weighted deviations of the sigma points and of their images

The result equals K = P C^T (C P C^T + R)^-1, P+ = P - K S K^T [Nurminen 2018, Alg. 2 and 3; errata
N1-N8]. P+ is positive definite for any accuracy of the measurement.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass
from types import ModuleType
from typing import ClassVar

import numpy as np

from aoabench.filters.belief import Belief
from aoabench.filters.compiled import COMPONENTS, kind_of
from aoabench.filters.divergence import Filtered
from aoabench.filters.gaussian import Gaussian
from aoabench.filters.recursion import KalmanFilter
from aoabench.filters.roots import near, prior_root
from aoabench.kernels.loading import Compiled, engine_param
from aoabench.maths.geometry import Array
from aoabench.models.azel import AzEl
from aoabench.models.unit_vector import UnitVector
from aoabench.params import param
from aoabench.types import Anchors, Batch

KERNELS = "kernels.kalman"
Innovation = tuple[Array, Array, Array, Array]  # B, f, v, r of `roots.absorb`


@dataclass(frozen=True)
class _Kalman(Compiled, KalmanFilter):
    """Recursion of EKF and UKF, in kernels where these have the measurement model."""

    _: KW_ONLY
    engine: str = engine_param()
    per_step = True
    kernels = KERNELS
    finest: ClassVar[float] = 0.0  # the kernel's least variance

    def prepare(self, say: Callable[[str], None]) -> None:
        """Compile or load the kernels if they have the measurement model; `say` prints a line."""
        if self.kind() is not None:
            super().prepare(say)

    def filtered(self, batch: Batch, belief: Belief, size: int = 3) -> Filtered:
        """The state's first `size` components, by the kernel if there is one, else in NumPy."""
        given = self._given(batch)
        if given is None:
            return self._filtered(batch, belief, size)
        belief = belief._replace(covariance=prior_root(belief.covariance))
        kernels, kind, measured = given
        R, T = batch.azimuth.shape[:2]
        out = np.empty((R, T, size)), np.empty((R, T, size, size)), np.empty((R, T))
        counts = np.empty((R, T), dtype=np.int64)
        anchors = batch.anchors.position, batch.anchors.rotation
        arrays = *belief, *measured, *anchors, self.measurement.variances()
        read = [np.ascontiguousarray(a, dtype=float) for a in arrays]
        self._compiled(kernels, kind, batch.azimuth.shape[2], (*read, *out, counts))
        return Filtered(*out, counts)

    def _given(self, batch: Batch) -> tuple[ModuleType, int, tuple[Array, ...]] | None:
        """The kernels, the number of the measurement model, and angles and deviations that they
        take; None if NumPy is used.
        """
        kind, h = self.kind(), self.measurement
        if kind is None or (kernels := self.compiled(batch.anchors)) is None:
            return None
        assert isinstance(h, AzEl | UnitVector)
        deviations = h.deviations(batch)
        if self.finest > 0 and finest(*deviations, h.variances()) < self.finest:
            return None
        return kernels, kind, (batch.azimuth, batch.elevation, *constant(*deviations))

    def update(self, prior: Gaussian, y: Array, r: Array, anchors: Anchors) -> Gaussian:
        B, f, v, R = self.innovation(prior.mean, prior.root, y, r, anchors)
        return Gaussian(prior.mean, B).given_root(v, f, R)

    def innovation(self, x: Array, L: Array, y: Array, r: Array, anchors: Anchors) -> Innovation:
        """B (R, n, k), f (R, k, m), v (R, m) and variances (R, m) with the state x + B z,
        z ~ N(0, I), and v = f^T z + e.

        Arguments: the prior's mean x (R, n) and lower Cholesky factor L (R, n, n), measurements y
        (R, m) and their nominal variances r (R, m).
        """
        raise NotImplementedError

    def kind(self) -> int | None:
        """Number of the measurement model in the kernels; None for computation in NumPy."""
        return None

    def _compiled(
        self, kernels: ModuleType, kind: int, anchors: int, arrays: Sequence[np.ndarray]
    ) -> None:
        """Fill the last four `arrays`, which `Filtered` describes, from the others."""
        raise NotImplementedError


@dataclass(frozen=True)
class EKF(_Kalman):
    """Extended Kalman filter: h linearised at the predicted mean [Nurminen 2018, Alg. 2].

    An anchor on the predicted mean, or nearer than 0.001 of its standard deviation, has no
    meaningful derivative and is left out at that step.
    """

    entries = ("ekf",)

    def kind(self) -> int | None:
        return kind_of(self.measurement, self.engine) if type(self) is EKF else None

    def _compiled(
        self, kernels: ModuleType, kind: int, anchors: int, arrays: Sequence[np.ndarray]
    ) -> None:
        kernels.ekf(kind, *arrays)

    def innovation(self, x: Array, L: Array, y: Array, r: Array, anchors: Anchors) -> Innovation:
        h = self.measurement
        f = np.swapaxes(h.jacobian(x, anchors) @ L, -1, -2)
        v = h.residual(y, h.predict(x, anchors))
        skipped = near(x, L, anchors)
        if skipped.any():
            v = np.where(np.repeat(skipped, v.shape[1] // anchors.count, axis=1), np.nan, v)
        return L, f, v, h.covariance(x, anchors, r)


@dataclass(frozen=True)
class UKF(_Kalman):
    """Unscented Kalman filter with 2 n + 1 sigma points [Nurminen 2018, Alg. 3].

    Angles are averaged as deviations from the angle of the central point.
    """

    lambda_: float = param(0.5, "spread of the sigma points", least=0)
    form: str = param(
        "averaged",
        "variances that depend on the state: averaged over the sigma points, at the centre, "
        "or augmented (the noise is a part of the sigma points)",
        choices=("averaged", "centre", "augmented"),
    )
    entries = ("ukf",)
    finest: ClassVar[float] = 1e-12  # rad^2; with smaller ones rounding loses other components

    @property
    def heard_only(self) -> bool:  # type: ignore[override]
        """False for the augmented form: its sigma points depend on the number of all anchors."""
        return self.form != "augmented"

    def kind(self) -> int | None:
        return kind_of(self.measurement, self.engine) if type(self) is UKF else None

    def _compiled(
        self, kernels: ModuleType, kind: int, anchors: int, arrays: Sequence[np.ndarray]
    ) -> None:
        """The sigma points of the m components' noise deviate in nothing but their own component,
        by its deviation at the centre: the augmented form is the central one with lambda + m.
        """
        spread, form = float(self.lambda_), kernels.CENTRE
        if self.form == "augmented":
            spread += anchors * COMPONENTS[kind]
        elif self.form == "averaged":
            form = kernels.AVERAGED
        kernels.ukf(kind, *arrays, spread, form)

    def innovation(self, x: Array, L: Array, y: Array, r: Array, anchors: Anchors) -> Innovation:
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
        return B, f, h.residual(y, images[:, 0] + mean), R

    def _augmented(self, x: Array, L: Array, y: Array, r: Array, anchors: Anchors) -> Innovation:
        """The innovation from sigma points of (x, e), e ~ N(0, I) in m dimensions, mapped to
        h(x) + sigma(x) e.
        """
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
        return B, f, v, np.zeros_like(v)  # the noise is in f


def constant(*arrays: Array) -> tuple[Array, ...]:
    """Arrays (R|1, T|1, B), or their first step (1, 1, B) if it is that of all replications and
    steps in all of them.
    """
    first = tuple(each[:1, :1] for each in arrays)
    return first if all((a == b).all() for a, b in zip(arrays, first)) else arrays


def finest(azimuth: Array, elevation: Array, table: Array) -> float:
    """The least usable variance of deviations (...) rad, and of a table of variances rad^2."""
    least = [np.min(each, where=each > 0, initial=np.inf) ** 2 for each in (azimuth, elevation)]
    return float(min(*least, table.min()))


def sigma_points(x: Array, L: Array, lambda_: float) -> tuple[Array, Array]:
    """Sigma points (R, 2n+1, n) x, x + sqrt(n + lambda) L_i, x - sqrt(n + lambda) L_i, and their
    weights (2n+1,).
    """
    n = x.shape[-1]
    spread = np.sqrt(n + lambda_) * np.swapaxes(L, -1, -2)
    points = np.concatenate([x[:, None], x[:, None] + spread, x[:, None] - spread], axis=1)
    weights = np.full(2 * n + 1, 0.5 / (n + lambda_))
    weights[0] = lambda_ / (n + lambda_)
    return points, weights
