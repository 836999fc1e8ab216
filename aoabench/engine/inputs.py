"""Facts about the fixes of replications that follow from their measurements and anchors alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from aoabench.estimators.places import anchors_used
from aoabench.maths.geometry import Array
from aoabench.maths.linalg import blocks
from aoabench.types import Batch, Estimates, Outcome


@dataclass(frozen=True)
class Inputs:
    """What the measurements and known anchors of R replications of T steps say.

    unmeasured (R, T): no anchor has an azimuth, an elevation or a delay; centre (R, T|1, 3) m: the
    mean of the anchors' positions; extent (R, T|1) m: the largest distance between two anchors, 0
    for a single one; time (R, T) s, NaN where unknown.
    """

    unmeasured: np.ndarray
    centre: Array
    extent: Array
    time: Array

    @classmethod
    def of(cls, batch: Batch) -> Inputs:
        """The facts about a batch."""
        unmeasured = _unmeasured(batch)
        shape = unmeasured.shape[:2]
        centre, extent = _layout(batch.layout.position)
        time = np.nan if batch.time is None else batch.time
        return cls(
            np.asarray(unmeasured.all(axis=2)),
            np.broadcast_to(centre, (shape[0], *centre.shape[1:])),
            np.broadcast_to(extent, (shape[0], *extent.shape[1:])),
            np.broadcast_to(time, shape),
        )

    @classmethod
    def joined(cls, tiles: Sequence[Inputs]) -> Inputs:
        """The facts about the replications of several tiles, one after the other."""
        if len(tiles) == 1:
            return tiles[0]
        names = ("unmeasured", "centre", "extent", "time")
        return cls(*(np.concatenate([getattr(tile, name) for tile in tiles]) for name in names))

    def imprecise(self, estimates: Estimates) -> np.ndarray:
        """Whether the largest standard deviation of a fix, in any direction, exceeds both the
        anchors' extent and the fix's distance from their centre, (R, T).

        The deviation is the root of the largest eigenvalue of the covariance; of its x, y block
        where z is NaN. An infinite covariance is imprecise; a fix without a position or with NaN
        in its covariance is not.
        """
        given = (estimates.outcome != Outcome.FAILED) & (estimates.outcome != Outcome.REJECTED)
        found, P = np.zeros(given.shape, dtype=bool), estimates.covariance
        if P is None:
            return found
        for some in blocks(given.shape):
            offset = estimates.position[some] - self.centre[some]
            found[some] = _imprecise(given[some], P[some], offset, self.extent[some])
        return found


def _imprecise(given: np.ndarray, P: Array, offset: Array, extent: Array) -> np.ndarray:
    """`Inputs.imprecise` for the `given` (R, T) of fixes with covariances P (R, T, 3, 3), at an
    `offset` (R, T, 3) from the centre of anchors with an `extent` (R, T|1).
    """
    x, y, z = offset[..., 0], offset[..., 1], offset[..., 2]
    flat = np.isnan(z) | np.isnan(P[..., 2, 2])
    z = np.where(np.isnan(z), 0.0, z)
    limit = np.maximum(extent**2, x**2 + y**2 + z**2)
    with np.errstate(over="ignore", invalid="ignore"):
        suspect = given & ~(_square(P, flat) <= limit**2)
    if suspect.any():
        some = flat[suspect]
        cut = np.where(some[:, None, None] & _OF_Z, 0.0, P[suspect])
        suspect[suspect] = _larger(cut, limit[suspect])
    return np.asarray(suspect)


def _unmeasured(batch: Batch) -> np.ndarray:
    """Whether a place (R, T, B) of the batch has no azimuth, elevation or delay."""
    found = np.isnan(batch.azimuth) & np.isnan(batch.elevation)
    return found if batch.delay is None else found & np.isnan(batch.delay)


def heard(batch: Batch) -> np.ndarray:
    """The number (R, T) of different anchors that have an azimuth, an elevation or a delay."""
    return anchors_used(batch, ~_unmeasured(batch))


_OF_Z = np.array([[False, False, True], [False, False, True], [True, True, True]])


def _square(P: Array, flat: np.ndarray) -> Array:
    """Sum of the squared entries of covariances (R, T, 3, 3), of the x, y block where `flat` (R,
    T): it is at least the square of the largest eigenvalue.
    """
    square = P[..., 0, 0] ** 2 + P[..., 1, 1] ** 2 + P[..., 0, 1] ** 2 + P[..., 1, 0] ** 2
    if flat.all():
        return square
    of_z = P[..., 0, 2] ** 2 + P[..., 2, 0] ** 2 + P[..., 1, 2] ** 2 + P[..., 2, 1] ** 2
    return square + np.where(flat, 0.0, of_z + P[..., 2, 2] ** 2)


def _larger(P: Array, limit: Array) -> np.ndarray:
    """Whether the largest eigenvalue of covariances (K, 3, 3) m^2 exceeds `limit` (K,) m^2."""
    finite = np.asarray(np.isfinite(P).all((-1, -2)))
    largest = np.linalg.eigvalsh(np.where(finite[:, None, None], P, 0.0))[:, -1]
    return np.asarray(np.where(finite, largest > limit, np.isinf(P).any((-1, -2))))


def _layout(position: Array) -> tuple[Array, Array]:
    """Centre (R|1, T|1, 3) m and extent (R|1, T|1) m of anchors (R|1, T|1, B, 3) m; those with a
    NaN position are left out.
    """
    known = np.isfinite(position).all(axis=-1, keepdims=True)
    count = np.maximum(known.sum(axis=2), 1)
    centre = np.where(known, position, 0.0).sum(axis=2) / count
    extent = np.zeros(position.shape[:2])
    for b in range(position.shape[2]):
        apart = np.linalg.norm(position - position[:, :, b : b + 1], axis=-1)
        extent = np.fmax(extent, np.fmax.reduce(apart, axis=2))
    return centre, extent
