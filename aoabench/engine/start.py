"""Prior of a filter for a recorded track, from the track's first fix.

An azimuth says that the position p lies in a plane through the anchor s, n^T (p - s) = 0, and an
elevation beside it in a second one. The weighted least-squares point of the planes, with weights
1 / (range deviation)^2 and a weak prior in front of the anchors, has the covariance C = A^-1. The
filter's prior is the point with C + start_sigma_m^2 I: wider than the fix, so that the fix's own
measurements, which the filter takes too, decide.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from aoabench.maths.geometry import Array
from aoabench.models.components import UNSTATED_DEG
from aoabench.roles import Motion
from aoabench.types import Batch

MOST_STEPS = 64  # measured steps that are put together until they determine a position
DETERMINED = 0.25  # of the extent: deviation in the plane up to which a position is determined
LEAST_EXTENT_M = 5.0
ITERATIONS = 5  # of the ranges in the weights
HEIGHT_SIGMA_M = 0.1  # of a height that is known


class Planes(NamedTuple):
    """Planes of azimuths and of elevations through anchors, one or two for each of K directions.

    origin, ahead (K, 3): the anchor's position and the direction, horizontal to the anchor where
    there is no elevation; normal (K, 2, 3); sigma (K, 2) rad, infinite where not measured; axis
    (K, 3): the anchor's z axis.
    """

    origin: Array
    ahead: Array
    normal: Array
    sigma: Array
    axis: Array

    def some(self, index: np.ndarray) -> Planes:
        """The planes of some of the directions."""
        return Planes(*(array[index] for array in self))


class Point(NamedTuple):
    """A position (3,) m and its covariance (3, 3) m^2."""

    mean: Array
    covariance: Array


def prior_of(
    batch: Batch, motion: Motion, sigma: float, height: float | None = None
) -> tuple[Array, Array]:
    """Mean (n,) and covariance (n, n) of the state at the first step of a track.

    batch: the measurements (1, T, B) of one track; sigma m: `start_sigma_m`; height m: the known
    height. The position is that of the first measured step, or of as many more as determine one.
    """
    point = first_point(batch, height)
    rest = motion.start()
    mean, P = np.zeros(3 + len(rest)), np.diag([sigma**2] * 3 + [*rest**2])
    if height is not None:
        P[2, 2] = 0.0
    mean[:3], P[:3, :3] = point.mean, P[:3, :3] + point.covariance
    return mean, P


def first_point(batch: Batch, height: float | None) -> Point:
    """Where a track starts: by its first measured step, or by as many more as determine a position
    in front of the anchors; if none do, by the first one, with the uncertainty that remains.
    """
    position = batch.layout.position.reshape(-1, 3)
    position = position[np.isfinite(position).all(axis=1)]
    centre = position.mean(axis=0) if len(position) else np.zeros(3)
    extent = max(2 * np.linalg.norm(position - centre, axis=1).max(initial=0.0), LEAST_EXTENT_M)
    planes, step = planes_of(batch)
    found: list[Point] = []
    for k in np.unique(step)[:MOST_STEPS]:
        some = planes.some(step <= k)
        point = nearest(some, extent, height)
        found.append(point)
        widest = np.linalg.eigvalsh(point.covariance[:2, :2])[-1]
        ahead = ((point.mean - some.origin) * some.ahead).sum(axis=1) > 0
        if widest <= (DETERMINED * extent) ** 2 and ahead.all():
            return point
    return found[0] if found else anywhere(centre, extent, height)


def anywhere(centre: Array, extent: float, height: float | None) -> Point:
    """The point for a track without measurements."""
    mean, deviation = centre.copy(), np.full(3, extent)
    if height is not None:
        mean[2], deviation[2] = height, HEIGHT_SIGMA_M
    return Point(mean, np.diag(deviation**2))


def planes_of(batch: Batch) -> tuple[Planes, np.ndarray]:
    """The planes of the azimuths, and elevations beside them, of the first measured steps of one
    track, and the step of each.
    """
    steps = np.flatnonzero(np.isfinite(batch.azimuth[0]).any(axis=1))[:MOST_STEPS]
    azimuth, elevation = batch.azimuth[0, steps], batch.elevation[0, steps]
    those = batch.anchors.at(steps)
    shape = (*azimuth.shape, 3)
    position = np.broadcast_to(those.position[0], shape)
    rotation = np.broadcast_to(those.rotation[0], (*shape, 3))
    use = np.isfinite(azimuth) & np.isfinite(position).all(-1)
    a, e = azimuth[use], elevation[use]
    known = np.isfinite(e)
    e = np.where(known, e, 0.0)
    ca, sa, ce, se, zero = np.cos(a), np.sin(a), np.cos(e), np.sin(e), np.zeros_like(a)
    local = [(ce * ca, ce * sa, se), (-sa, ca, zero), (-se * ca, -se * sa, ce)]
    R = rotation[use]
    ahead, first, second = ((np.stack(v, -1)[:, None] @ R)[:, 0] for v in local)
    sigma = _deviations(batch, steps)[use]
    sigma[~known, 1] = np.inf
    normal = np.stack([first, second], axis=1)
    return Planes(position[use], ahead, normal, sigma, R[:, 2]), np.nonzero(use)[0]


def _deviations(batch: Batch, steps: np.ndarray) -> Array:
    """Deviations (K, B, 2) rad of azimuths and elevations, where stated as positive numbers."""
    found = np.empty((len(steps), batch.azimuth.shape[2], 2))
    found[:] = np.deg2rad(UNSTATED_DEG)
    for i, stated in enumerate((batch.azimuth_sigma, batch.elevation_sigma)):
        if stated is not None:
            given = stated[0, steps]
            usable = np.isfinite(given) & (given > 0)
            found[..., i] = np.where(usable, given, found[..., i])
    return found


def nearest(planes: Planes, extent: float, height: float | None) -> Point:
    """The point nearest to the planes, with a weak prior: the mean of the points half an extent in
    front of each anchor, with the deviation `extent` m, and a known height with HEIGHT_SIGMA_M.
    """
    s, normal = planes.origin, planes.normal
    guess = (s + 0.5 * extent * planes.ahead).mean(axis=0)
    weak = np.full(3, extent**-2.0)
    if height is not None:
        guess[2], weak[2] = height, HEIGHT_SIGMA_M**-2.0
    p, along = guess, (normal * s[:, None]).sum(axis=-1)
    for _ in range(ITERATIONS):
        apart = p - s
        full = np.linalg.norm(apart, axis=1)
        level = np.sqrt(np.maximum(full**2 - (apart * planes.axis).sum(axis=1) ** 2, 0.0))
        distance = np.maximum(np.stack([level, full], axis=1), 0.05 * extent)
        w = 1.0 / (planes.sigma * distance) ** 2
        A = np.diag(weak) + np.einsum("kr,kri,krj->ij", w, normal, normal)
        p = np.linalg.solve(A, weak * guess + np.einsum("kr,kri,kr->i", w, normal, along))
    return Point(p, np.linalg.inv(A))
