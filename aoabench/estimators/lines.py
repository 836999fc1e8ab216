"""The point nearest to all measured lines, in the least-squares sense, with and without discarding
anchors.

A line through the anchor s along the unit vector u is at the distance |(I - u u^T)(p - s)| from p,
so that

    p = (sum_i (I - u_i u_i^T))^-1 sum_i (I - u_i u_i^T) s_i      [Boquet 2024, 2.2.2, M_LS]

An azimuth alone is a plane with normal n = (-sin phi, cos phi, 0) in the anchor's frame, and n n^T
replaces I - u u^T. With vertical planes alone the problem is that of bearing lines in two
dimensions.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType
from typing import NamedTuple

import numpy as np

from aoabench.estimators.packed import calls, corners, measured_rays, padded_anchors
from aoabench.estimators.parameters import clip_param
from aoabench.estimators.places import anchors_used, several
from aoabench.estimators.plane import clipped
from aoabench.estimators.rays import (
    Rays,
    angular_variance,
    apart,
    behind,
    judged,
    measured_reason,
    occupied,
    rays,
    residual_variance,
)
from aoabench.kernels.loading import Compiled, engine_param
from aoabench.maths.geometry import Array
from aoabench.maths.linalg import inverse, solve
from aoabench.params import param
from aoabench.roles import Estimator, Scenario
from aoabench.streams import Streams
from aoabench.types import Batch, Estimates

KERNELS = "kernels.lines"


class Nearest(NamedTuple):
    """Points nearest to the rays of each fix.

    position (R, T, 3) m, NaN if the rays do not determine a point, z alone NaN if only z is not
    determined; normal (R, T, 3, 3): A = sum_i P_i; level (R, T): whether z is not determined.
    """

    position: Array
    normal: Array
    level: np.ndarray


def nearest_point(r: Rays, s: Array) -> Nearest:
    """The points nearest to the rays from the anchors s (R|1, T|1, B, 3) m.

    A line's projector is I - u u^T, and a plane's n n^T.
    """
    centre = s.mean(axis=2, keepdims=True)
    s = s - centre
    v = np.where(r.plane[..., None], r.normal, r.ahead)
    A = _sum(r, r.used.astype(float))
    along = (r.plane.astype(float) - r.line) * (v * s).sum(axis=-1)
    g = (r.line[..., None] * s + along[..., None] * v).sum(axis=2)
    level = ~r.line.any(axis=-1) & (A[..., 2, 2] <= 1e-12 * (A[..., 0, 0] + A[..., 1, 1]))
    A[..., 2, 2] += level
    p = solve(A, g) + centre[:, :, 0]
    p[..., 2] = np.where(level, np.nan, p[..., 2])
    return Nearest(p, A, level)


def distances(r: Rays, s: Array, p: Array) -> Array:
    """Distances (R, T, B) m of points (R, T, 3) m from the lines or planes; 0 if not measured."""
    x, y, z = np.moveaxis(np.where(np.isnan(p), 0.0, p)[:, :, None] - s, -1, 0)
    a, b, c = np.moveaxis(r.ahead, -1, 0)
    across = np.sqrt((b * z - c * y) ** 2 + (c * x - a * z) ** 2 + (a * y - b * x) ** 2)
    if not r.plane.any():
        return across
    n = r.normal
    return np.where(r.plane, np.abs(n[..., 0] * x + n[..., 1] * y + n[..., 2] * z), across)


def covariances(batch: Batch, r: Rays, found: Nearest, d: Array) -> Array:
    """Covariances (R, T, 3, 3) m^2 of the nearest points, A^-1 (sum_i sigma_i^2 r_i^2 P_i) A^-1.

    A line's point is displaced by sigma_i r_i across the line, at the distance r_i from the anchor;
    a plane's by sigma_i times the distance r_i from the anchor's axis. sigma_i are the stated
    deviations, or one deviation from the residuals d (R, T, B) m: with C the covariance for
    sigma = 1 and m rows, sum d_i^2 / r_i^2 has the mean sigma^2 (m - 6 + tr(C sum P_i / r_i^2)).
    NaN where z is not determined or the residuals have no degree of freedom.
    """
    s = batch.anchors.position
    away = np.where(np.isnan(found.position), 0.0, found.position)[:, :, None] - s
    squared = (away**2).sum(axis=-1)
    if r.plane.any():
        axis = batch.anchors.rotation[..., 2, :]
        squared = np.where(r.plane, squared - (axis * away).sum(axis=-1) ** 2, squared)
    variance, inner = angular_variance(batch, r), inverse(found.normal)
    if variance is not None:
        P = inner @ _sum(r, np.where(r.used, variance * squared, 0.0)) @ inner
    else:
        P = inner @ _sum(r, np.where(r.used, squared, 0.0)) @ inner
        with np.errstate(invalid="ignore", divide="ignore"):
            over = np.where(r.used & (squared > 0), 1.0 / squared, 0.0)
        unknowns = 3 - found.level
        rows = 2 * r.line.sum(axis=-1) + r.plane.sum(axis=-1)
        used_up = 2 * unknowns - (P * _sum(r, over)).sum(axis=(-1, -2)) + found.level
        freedom = np.where(rows > unknowns, rows - used_up, 0.0)
        P *= residual_variance((d**2 * over).sum(axis=-1), freedom)[..., None, None]
    P[found.level, 2, :] = P[found.level, :, 2] = np.nan
    return P


def _sum(r: Rays, weight: Array) -> Array:
    """Sums (R, T, 3, 3) of the rays' projectors with weights (R, T, B), 0 where not used."""
    v = np.where(r.plane[..., None], r.normal, r.ahead)
    A = np.swapaxes((weight * (r.plane.astype(float) - r.line))[..., None] * v, -1, -2) @ v
    A[..., range(3), range(3)] += (weight * r.line).sum(axis=-1)[..., None]
    return A


@dataclass(frozen=True)
class LineLeastSquares(Compiled, Estimator):
    """The nearest point to all lines.

    The score is the root mean square distance in m from the lines.
    """

    clip: bool = clip_param()
    engine: str = engine_param()
    tile = 8
    by_replication = True
    heard_only = True
    per_step = True
    kernels = KERNELS
    uses = frozenset({"elevation", "stated_sigma"})

    @property
    def needs(self) -> frozenset[str]:
        return frozenset({"several_anchors"})

    def __call__(self, batch: Batch, scenario: Scenario, streams: Streams) -> Estimates:
        """One position per fix; outcome FAILED if fewer than two anchors measured, if all of them
        stand in one place or if all lines are parallel; DIVERGED behind an anchor.
        """
        compiled, batch = self.compiled(batch.anchors), occupied(batch)
        if compiled is not None:
            return _by_kernel(compiled, batch, corners(scenario, self.clip), np.inf)
        return _estimates(batch, rays(batch), scenario, self.clip)


@dataclass(frozen=True)
class AnchorDiscarding(Compiled, Estimator):
    """Least squares that discards, one by one, the anchor whose line is furthest from the point.

    It stops when the root mean square distance is at most `threshold_m` or two anchors are left.
    The paper names this method M_IAD without equations; this class is a reconstruction.
    """

    threshold_m: float = param(
        0.3, "root mean square distance up to which no anchor is discarded", unit="m", least=0
    )
    clip: bool = clip_param()
    engine: str = engine_param()
    tile = 8
    by_replication = True
    heard_only = True
    per_step = True
    kernels = KERNELS
    uses = frozenset({"elevation", "stated_sigma"})

    @property
    def needs(self) -> frozenset[str]:
        return frozenset({"several_anchors"})

    def __call__(self, batch: Batch, scenario: Scenario, streams: Streams) -> Estimates:
        compiled, batch = self.compiled(batch.anchors), occupied(batch)
        if compiled is not None:
            bounds = corners(scenario, self.clip)
            return _by_kernel(compiled, batch, bounds, self.threshold_m)
        r = _kept(rays(batch), batch.anchors.position, self.threshold_m)
        return _estimates(batch, r, scenario, self.clip)


def _kept(r: Rays, s: Array, threshold_m: float) -> Rays:
    """The rays of anchors s (R|1, T|1, B, 3) m that are left when anchors have been discarded."""
    used = r.used
    for _ in range(used.shape[-1] - 2):
        d = distances(r, s, nearest_point(r, s).position)
        n = used.sum(axis=-1)
        bad = (n > 2) & ((d**2).sum(axis=-1) > n * threshold_m**2)
        if not bad.any():
            break
        worst = np.arange(used.shape[-1]) == d.argmax(axis=-1)[..., None]
        used &= ~(worst & bad[..., None])
        r = r.of(used)
    return r


def _by_kernel(compiled: ModuleType, batch: Batch, bounds: Array, threshold_m: float) -> Estimates:
    """Estimates of one tile; anchors are discarded down to the threshold."""
    R, T, B = batch.azimuth.shape
    x, P = np.empty((R, T, 3)), np.empty((R, T, 3, 3))
    outcome, reason = np.empty((2, R, T), dtype=np.int8)
    score, used = np.empty((2, R, T))
    stated, angles = measured_rays(batch, compiled.LANES)
    known = batch.anchors
    anchors = padded_anchors(known.position, known.rotation, compiled.LANES)
    for one in calls(angles, anchors, (x, P, outcome, reason, score, used)):
        compiled.nearest_points(threshold_m, B, stated, bounds, *one)
    if several(batch):  # the kernel counts columns
        used = anchors_used(batch, _kept(rays(batch), known.position, threshold_m).used)
    return Estimates(x, P, None, outcome, score, used, reason)


def _estimates(batch: Batch, r: Rays, scenario: Scenario, clip: bool) -> Estimates:
    """Estimates from the rays that are used."""
    s, n = batch.anchors.position, r.used.sum(axis=-1)
    found = nearest_point(r, s)
    level = found.level[..., None, None] & (np.arange(s.shape[-1]) == 2)  # heights do not matter
    distinct = apart(np.where(level, 0.0, s), r.used)
    p = np.where((distinct & (n > 1))[..., None], found.position, np.nan)
    solved: np.ndarray = np.asarray(np.isfinite(p[..., :2]).all(axis=-1))
    d = distances(r, s, p)
    with np.errstate(invalid="ignore", divide="ignore"):
        score = np.where(solved, np.sqrt((d**2).sum(axis=-1) / n), np.nan)
    P = np.where(solved[..., None, None], covariances(batch, r, found, d), np.nan)
    position = np.concatenate([clipped(p[..., :2], scenario, clip), p[..., 2:]], axis=-1)
    failed = measured_reason(r.used, 2, ~distinct)
    outcome, reason = judged(solved, behind(r.ahead, s, position), failed)
    return Estimates(position, P, None, outcome, score, anchors_used(batch, r.used), reason)
