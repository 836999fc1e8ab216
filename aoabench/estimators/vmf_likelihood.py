"""Maximum likelihood of von Mises-Fisher directions: unit-vector residuals, no angle and no pole in
the loop.

The likelihood of directions d_i seen along u_i(p) = (p - s_i) / r_i is exp(sum_i kappa_i u_i . d_i)
[Nurminen 2018, (5); Boquet 2024, M_vMF], and because |d - u|^2 = 2 - 2 u . d it is greatest where

    f(p) = 1/2 sum_i kappa_i |d_i - u_i(p)|^2        is least;        du/dp = (I - u u^T) / r

Levenberg-Marquardt steps from the point nearest to the measured lines, in space, or on the plane of
a known height.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aoabench.errors import Unfit
from aoabench.estimators.lines import nearest_point
from aoabench.estimators.parameters import clip_param, tolerance_param, updates_param
from aoabench.estimators.plane import clipped, directions, plane_of
from aoabench.maths.geometry import Array
from aoabench.maths.linalg import solve
from aoabench.params import param
from aoabench.roles import NEEDS, Estimator, Noise, Scenario
from aoabench.streams import Streams
from aoabench.types import Batch, Estimates, Outcome

FREE = "free"


@dataclass(frozen=True)
class VmfLikelihood(Estimator):
    """Maximum likelihood of von Mises-Fisher directions.

    Each kappa is 1 / sigma^2 of the azimuth's stated deviation; without stated deviations all kappa
    are equal. The outcome of a fix is OSCILLATED if no step is shorter than `tolerance_m` within
    `updates`, DIVERGED beyond 1e6 m, FAILED without a start. The score is the root mean square
    angle in rad between measured and expected directions.
    """

    height_m: float | str | None = param(
        None,
        "height of the target; free: z is estimated; null: the scenario's known height, else free",
        unit="m",
        also=(FREE,),
    )
    tolerance_m: float = tolerance_param(1e-4)
    updates: int = updates_param(100)
    clip: bool = clip_param()
    tile = 8

    @property
    def needs(self) -> frozenset[str]:
        return frozenset({"elevation"} | ({"several_anchors"} if self.height_m == FREE else set()))

    def check(self, scenario: Scenario, noise: Noise) -> None:
        """Raise Unfit as all estimators do, and UserError if an anchor lies in the plane."""
        super().check(scenario, noise)
        if self._height(scenario) is None and "several_anchors" not in scenario.offers():
            raise Unfit(*NEEDS["several_anchors"])

    def _height(self, scenario: Scenario) -> float | None:
        if self.height_m == FREE or (self.height_m is None and scenario.known_height_m is None):
            return None
        return plane_of(self.height_m, scenario)  # type: ignore[arg-type]

    def __call__(self, batch: Batch, scenario: Scenario, streams: Streams) -> Estimates:
        height = self._height(scenario)
        d = directions(batch)
        known: np.ndarray = np.asarray(np.isfinite(d).all(axis=-1))
        d = np.where(known[..., None], d, 0.0)
        w = known * (1.0 if batch.azimuth_sigma is None else 1.0 / np.square(batch.azimuth_sigma))
        w = np.where(known & np.isfinite(w), w, 0.0)
        s = np.broadcast_to(batch.anchors.position, d.shape)
        P = np.where(known[..., None, None], np.eye(3) - d[..., :, None] * d[..., None, :], 0.0)
        start = nearest_point(P, s)
        if height is not None:
            level = np.full((*known.shape[:2], 1), height)
            start = np.concatenate([clipped(start[..., :2], scenario, True), level], axis=-1)
        shape, size = start.shape, start.shape[0] * start.shape[1]
        flat = (
            start.reshape(size, 3),
            d.reshape(size, -1, 3),
            w.reshape(size, -1),
            s.reshape(size, -1, 3),
        )
        p, outcome, count, cost = self.minimise(*flat, free=height is None)
        n, total = known.sum(axis=-1), w.sum(axis=-1)
        score = np.where(
            n > 1, np.sqrt(2 * cost.reshape(n.shape) / np.where(total > 0, total, 1.0)), np.nan
        )
        position = p.reshape(shape).copy()
        position[..., :2] = clipped(position[..., :2], scenario, self.clip)
        if height is not None:
            position[..., 2] = np.nan
        return Estimates(
            position,
            None,
            count.reshape(shape[:2]),
            outcome.reshape(shape[:2]),
            score,
            n.astype(float),
        )

    def minimise(
        self, p: Array, d: Array, w: Array, s: Array, free: bool
    ) -> tuple[Array, np.ndarray, np.ndarray, Array]:
        """Positions (N, 3) m, outcomes, updates and costs (N,), from starts p (N, 3) m, directions
        d, weights w and anchors s (N, B, ...); z is fixed unless `free`."""
        p, damping, count = p.copy(), np.full(len(p), 1e-3), np.zeros(len(p))
        outcome = np.where(np.isfinite(p).all(axis=-1), Outcome.OSCILLATED, Outcome.FAILED).astype(
            np.int8
        )
        cost = np.where(outcome == Outcome.FAILED, np.nan, _expected(p, d, w, s)[2])
        left = np.flatnonzero(outcome == Outcome.OSCILLATED)
        for _ in range(self.updates):
            if not len(left):
                break
            u, r, _ = _expected(p[left], d[left], w[left], s[left])
            J = w[left] / r
            g = (J[..., None] * (d[left] - u * (u * d[left]).sum(axis=-1)[..., None])).sum(axis=1)
            J = (J / r)[..., None, None]
            A = (J * (np.eye(3) - u[..., :, None] * u[..., None, :])).sum(axis=1)
            if not free:
                A[:, 2, :2] = A[:, :2, 2] = g[:, 2] = 0.0
            A[:, range(3), range(3)] *= 1.0 + damping[left, None]
            step = solve(A, g)
            tried = p[left] + step
            new = _expected(tried, d[left], w[left], s[left])[2]
            count[left] += 1
            with np.errstate(invalid="ignore"):
                better = new <= cost[left]
                length = np.linalg.norm(step, axis=-1)
                lost = ~(np.linalg.norm(tried, axis=-1) <= 1e6)
            p[left[better]], cost[left[better]] = tried[better], new[better]
            damping[left] = np.clip(damping[left] * np.where(better, 0.1, 10.0), 1e-12, 1e12)
            outcome[left[lost]] = Outcome.DIVERGED
            outcome[left[~lost & (length < self.tolerance_m)]] = Outcome.OK
            left = left[~lost & (length >= self.tolerance_m)]
        return p, outcome, count, cost


def _expected(p: Array, d: Array, w: Array, s: Array) -> tuple[Array, Array, Array]:
    """Directions u (N, B, 3) and distances r (N, B) m of points (N, 3) from the anchors, and the
    cost (N,).
    """
    u = p[:, None] - s
    r = np.maximum(np.sqrt((u**2).sum(axis=-1)), 1e-9)
    u = u / r[..., None]
    return u, r, 0.5 * (w * ((d - u) ** 2).sum(axis=-1)).sum(axis=-1)
