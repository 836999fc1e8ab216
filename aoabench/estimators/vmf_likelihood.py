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
from typing import NamedTuple

import numpy as np

from aoabench.errors import Unfit
from aoabench.estimators.lines import nearest_point
from aoabench.estimators.parameters import clip_param, tolerance_param, updates_param
from aoabench.estimators.plane import clipped, on_plane, plane_of
from aoabench.estimators.rays import (
    FAR,
    Rays,
    angular_variance,
    apart,
    behind,
    extent,
    measured_reason,
    rays,
    residual_variance,
)
from aoabench.maths.geometry import Array
from aoabench.maths.linalg import EPS, inverse, solve
from aoabench.params import param
from aoabench.roles import NEEDS, Estimator, Noise, Scenario
from aoabench.streams import Streams
from aoabench.types import Batch, Estimates, Outcome, Reason

FREE = "free"
HORIZON = np.deg2rad(1.0)  # rays of a start look at least this far towards the plane


class Minimum(NamedTuple):
    """Result of the iterations: position (N, 3) m, outcome, updates, cost and reason (N,)."""

    position: Array
    outcome: np.ndarray
    updates: Array
    cost: Array
    reason: np.ndarray


@dataclass(frozen=True)
class VmfLikelihood(Estimator):
    """Maximum likelihood of von Mises-Fisher directions.

    Each kappa is 1 / sigma^2 of the azimuth's stated deviation; without stated deviations all kappa
    are equal. The outcome of a fix is OSCILLATED if no step is shorter than `tolerance_m` within
    `updates`; DIVERGED behind an anchor, or farther from the anchors' centre than FAR times their
    extent; FAILED without a start. A start needs two anchors in different places, or one if the
    height is known. The score is the root mean square angle in rad between measured and expected
    directions. The covariance follows from the stated deviations of both angles, or from one
    deviation that the residuals give.
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
    by_replication = True

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
        height, s = self._height(scenario), batch.anchors.position
        r = rays(batch)
        r = r.of(r.line)  # an azimuth alone is no direction
        stated = batch.azimuth_sigma
        with np.errstate(divide="ignore", invalid="ignore"):
            w = np.where(r.line, 1.0 if stated is None else 1.0 / np.square(stated), 0.0)
        start = nearest_point(r, s).position
        distinct = apart(s, r.line)
        if height is not None:
            start = self._on_plane(r, batch, start, scenario, height)
            distinct = np.ones_like(distinct)
        start = np.where(distinct[..., None], start, np.nan)
        shape, every = start.shape, (start.shape[0] * start.shape[1], -1, 3)
        sites = np.broadcast_to(s, r.ahead.shape).reshape(every)
        flat = r.ahead.reshape(every), w.reshape(every[:2]), sites
        far = np.broadcast_to(_reach(s, height), shape[:2]).ravel()
        found = self.minimise(start.reshape(-1, 3), *flat, far, free=height is None)
        return self._estimates(batch, scenario, r, found, w, height)

    def _on_plane(
        self, r: Rays, batch: Batch, start: Array, scenario: Scenario, height: float
    ) -> Array:
        """Starts (R, T, 3) m on the plane: the point nearest to the lines, or else the mean of the
        points where the rays meet the plane.
        """
        xy = start[..., :2]
        if np.isnan(xy).any():
            each = on_plane(r.ahead, batch.anchors, height, HORIZON)
            with np.errstate(invalid="ignore"):
                mean = np.where(r.line[..., None], each, 0.0).sum(axis=2)
                mean = mean / r.line.sum(axis=-1)[..., None]
            xy = np.where(np.isnan(xy), mean, xy)
        level = np.full((*xy.shape[:2], 1), height)
        return np.concatenate([clipped(xy, scenario, True), level], axis=-1)

    def _estimates(
        self,
        batch: Batch,
        scenario: Scenario,
        r: Rays,
        found: Minimum,
        w: Array,
        height: float | None,
    ) -> Estimates:
        """Estimates from the minima (R T,), with outcomes, score and covariance."""
        s, shape = batch.anchors.position, w.shape[:2]
        n, total = r.line.sum(axis=-1), w.sum(axis=-1)
        p, cost = found.position.reshape(*shape, 3).copy(), found.cost.reshape(shape)
        failed = measured_reason(r.line, 1 if height is not None else 2, ~apart(s, r.line))
        outcome = found.outcome.reshape(shape).copy()
        reason = np.where(outcome == Outcome.FAILED, failed, found.reason.reshape(shape))
        back = (outcome == Outcome.OK) & behind(r.ahead, s, p)
        outcome[back], reason[back] = Outcome.DIVERGED, Reason.BEHIND
        score = np.sqrt(2 * cost / np.where(total > 0, total, 1.0))
        free = 2 * n - (3 if height is None else 2)
        variance = angular_variance(batch, r)
        if variance is None:
            variance = residual_variance(2 * cost, free)[..., None]
        P = self._covariance(p, w, variance, s, height is None)
        position = np.concatenate([clipped(p[..., :2], scenario, self.clip), p[..., 2:]], axis=-1)
        if height is not None:
            position[..., 2] = np.nan
        return Estimates(
            position,
            P,
            found.updates.reshape(shape),
            outcome,
            np.where(n > 1, score, np.nan),
            n.astype(float),
            reason.astype(np.int8),
        )

    def _covariance(self, p: Array, w: Array, variance: Array, s: Array, free: bool) -> Array:
        """Covariances (R, T, 3, 3) m^2 of the minima, from angular variances (R, T, B|1) rad^2.

        J^-1 (sum w^2 var (I - u u^T) / r^2) J^-1 with J = sum w (I - u u^T) / r^2; z is left out
        (NaN) unless `free`.
        """
        u = p[:, :, None] - s
        squared = np.maximum((u**2).sum(axis=-1), 1e-18)
        u = u / np.sqrt(squared)[..., None]

        def total(weight: Array) -> Array:
            J = -np.swapaxes(weight[..., None] * u, -1, -2) @ u
            J[..., range(3), range(3)] += weight.sum(axis=-1)[..., None]
            if not free:
                J[..., 2, :] = J[..., :, 2] = 0.0
                J[..., 2, 2] = J[..., 0, 0] + J[..., 1, 1]
            return J

        inner = inverse(total(w / squared))
        P = inner @ total(np.where(w > 0, w**2 * variance, 0.0) / squared) @ inner
        if not free:
            P[..., 2, :] = P[..., :, 2] = np.nan
        return P

    def minimise(self, p: Array, d: Array, w: Array, s: Array, far: Array, free: bool) -> Minimum:
        """Minima from starts p (N, 3) m, directions d, weights w and anchors s (N, B, ...); z is
        fixed unless `free`.

        `far` (N,) m is the distance from the anchors' centre beyond which a fix is DIVERGED. A
        minimum behind an anchor may be a saddle or a maximum of the likelihood; the iteration is
        then repeated from the best point on the rays, and the smaller cost counts.
        """
        found = self._descend(p, d, w, s, far, free)
        back = behind(d[:, None], s[:, None], found.position[:, None])[:, 0]
        again = np.flatnonzero(back & (found.outcome != Outcome.FAILED))
        if len(again):
            part = d[again], w[again], s[again]
            start = _in_front(found.position[again], *part, far[again] / FAR, free)
            second = self._descend(start, *part, far[again], free)
            better = second.cost < found.cost[again]
            for kept, new in zip(found, second):
                kept[again[better]] = new[better]
        return found

    def _descend(self, p: Array, d: Array, w: Array, s: Array, far: Array, free: bool) -> Minimum:
        """Levenberg-Marquardt steps from starts p (N, 3) m."""
        p, damping, count = p.copy(), np.full(len(p), 1e-3), np.zeros(len(p))
        started: np.ndarray = np.asarray(np.isfinite(p).all(axis=-1))
        outcome = np.where(started, Outcome.OSCILLATED, Outcome.FAILED).astype(np.int8)
        reason = np.where(started, Reason.NO_CONVERGENCE, Reason.UNDETERMINED).astype(np.int8)
        cost = np.where(outcome == Outcome.FAILED, np.nan, _expected(p, d, w, s)[2])
        centre = s.mean(axis=1)
        left = np.flatnonzero(started)
        for _ in range(self.updates):
            if not len(left):
                break
            A, g = _normal_equations(p[left], d[left], w[left], s[left], free)
            damped = A.copy()
            damped[:, range(3), range(3)] *= 1.0 + damping[left, None]
            step = solve(damped, g)
            tried = p[left] + step
            new = _expected(tried, d[left], w[left], s[left])[2]
            count[left] += 1
            with np.errstate(invalid="ignore"):
                better = new <= cost[left]
                length = np.linalg.norm(step, axis=-1)
                lost = ~(np.linalg.norm(tried - centre[left], axis=-1) <= far[left])
            p[left[better]], cost[left[better]] = tried[better], new[better]
            damping[left] = np.clip(damping[left] * np.where(better, 0.1, 10.0), 1e-12, 1e12)
            singular = np.isnan(length)
            outcome[left[lost]], reason[left[lost]] = Outcome.DIVERGED, Reason.TOO_FAR
            reason[left[singular]] = Reason.NO_DESCENT
            converged = ~lost & (length < self.tolerance_m)
            near = np.flatnonzero(converged)  # damping alone makes a step short, too
            full = solve(A[near], g[near])
            gain = (full * g[near]).sum(axis=-1)
            rounding = 16 * EPS * np.sqrt(2 * cost[left[near]] * w[left[near]].sum(axis=-1))
            short = np.linalg.norm(full, axis=-1) < self.tolerance_m
            converged[near] = short | (gain <= rounding)
            outcome[left[converged]], reason[left[converged]] = Outcome.OK, Reason.NONE
            left = left[~lost & ~converged]
        return Minimum(p, outcome, count, cost, reason)


def _normal_equations(p: Array, d: Array, w: Array, s: Array, free: bool) -> tuple[Array, Array]:
    """A (N, 3, 3) and g (N, 3) of a Gauss-Newton step from p (N, 3) m; z is fixed unless `free`."""
    u, r, _ = _expected(p, d, w, s)
    J = w / r
    g = (J[..., None] * (d - u * (u * d).sum(axis=-1)[..., None])).sum(axis=1)
    J = (J / r)[..., None, None]
    A = (J * (np.eye(3) - u[..., :, None] * u[..., None, :])).sum(axis=1)
    if not free:
        A[:, 2, :2] = A[:, :2, 2] = g[:, 2] = 0.0
        A[:, 2, 2] = A[:, 0, 0] + A[:, 1, 1]
    return A, g


def _in_front(p: Array, d: Array, w: Array, s: Array, length: Array, free: bool) -> Array:
    """The points (N, 3) m of least cost among points on the rays, at multiples of `length` (N,) m
    from the anchors, and p (N, 3) m itself.
    """
    best, least = p.copy(), _expected(p, d, w, s)[2]
    for multiple in (0.25, 1.0, 4.0):
        for j in range(d.shape[1]):
            tried = s[:, j] + multiple * length[:, None] * d[:, j]
            if not free:
                tried[:, 2] = p[:, 2]
            cost = np.where(w[:, j] > 0, _expected(tried, d, w, s)[2], np.inf)
            best[cost < least], least = tried[cost < least], np.minimum(cost, least)
    return best


def _reach(s: Array, height: float | None) -> Array:
    """Distance (R|1, T|1) m from the centre of the anchors (R|1, T|1, B, 3) m beyond which a fix is
    DIVERGED: FAR times the anchors' extent, or their height above the plane if that is more.
    """
    size = extent(s)
    if height is not None:
        size = np.maximum(size, np.abs(s[..., 2] - height).max(axis=-1))
    return FAR * size


def _expected(p: Array, d: Array, w: Array, s: Array) -> tuple[Array, Array, Array]:
    """Directions u (N, B, 3) and distances r (N, B) m of points (N, 3) from the anchors, and the
    cost (N,).
    """
    u = p[:, None] - s
    r = np.maximum(np.sqrt((u**2).sum(axis=-1)), 1e-9)
    u = u / r[..., None]
    return u, r, 0.5 * (w * ((d - u) ** 2).sum(axis=-1)).sum(axis=-1)
