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
from aoabench.estimators.packed import calls, corners, measured_rays, padded_anchors
from aoabench.estimators.parameters import clip_param, tolerance_param, updates_param
from aoabench.estimators.places import anchors_used, several
from aoabench.estimators.plane import clipped, on_plane, plane_of
from aoabench.estimators.rays import (
    FAR,
    Rays,
    angular_variance,
    apart,
    behind,
    extent,
    measured_reason,
    occupied,
    rays,
    residual_variance,
)
from aoabench.estimators.vmf_descent import Minimum, minimise
from aoabench.kernels.loading import Compiled, engine_param
from aoabench.maths.geometry import Array
from aoabench.maths.linalg import inverse
from aoabench.params import param
from aoabench.roles import NEEDS, Estimator, Noise, Scenario
from aoabench.streams import Streams
from aoabench.types import Batch, Estimates, Outcome, Reason

FREE = "free"
HORIZON = np.deg2rad(1.0)  # rays of a start look at least this far towards the plane


@dataclass(frozen=True)
class VmfLikelihood(Compiled, Estimator):
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
    engine: str = engine_param()
    tile = 8
    by_replication = True
    heard_only = True
    per_step = True
    kernels = "kernels.vmf"
    uses = frozenset({"elevation", "stated_sigma"})

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
        compiled, batch = self.compiled(batch.anchors), occupied(batch)
        height = self._height(scenario)
        if compiled is None:
            return self.in_numpy(batch, scenario, height)
        R, T, B = batch.azimuth.shape
        x, P = np.empty((R, T, 3)), np.empty((R, T, 3, 3))
        outcome, reason = np.empty((2, R, T), dtype=np.int8)
        score, used, count = np.empty((3, R, T))
        stated, angles = measured_rays(batch, compiled.LANES)
        z, known = np.nan if height is None else height, batch.anchors
        options = self.tolerance_m, self.updates, B, stated, z, self.clip, corners(scenario)
        anchors = padded_anchors(known.position, known.rotation, compiled.LANES)
        for one in calls(angles, anchors, (x, P, outcome, reason, score, used, count)):
            compiled.vmf_minima(*options, *one)
        if several(batch):  # the kernel counts columns
            used = anchors_used(batch, rays(batch).line)
        return Estimates(x, P, count, outcome, score, used, reason)

    def in_numpy(self, batch: Batch, scenario: Scenario, height: float | None) -> Estimates:
        """The estimates of a tile in NumPy."""
        r, s = rays(batch), batch.anchors.position
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
        options = self.tolerance_m, self.updates
        found = minimise(start.reshape(-1, 3), *flat, far, height is None, options)
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
            anchors_used(batch, r.line),
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


def _reach(s: Array, height: float | None) -> Array:
    """Distance (R|1, T|1) m from the centre of the anchors (R|1, T|1, B, 3) m beyond which a fix is
    DIVERGED: FAR times the anchors' extent, or their height above the plane if that is more.
    """
    size = extent(s)
    if height is not None:
        size = np.maximum(size, np.abs(s[..., 2] - height).max(axis=-1))
    return FAR * size
