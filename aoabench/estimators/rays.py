"""Measured rays, and the rules by which each snapshot fix is judged.

A fix is OK if the measurements determine it, and if it lies in front of each anchor that it uses:
the measured ray u of the anchor at s and the position p give u . (p - s) >= 0. A fix behind an
anchor is DIVERGED; it keeps its position, because rejecting it would lower the RMSE by selection.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from aoabench.maths.geometry import Array, to_unit
from aoabench.maths.linalg import ONE_PLACE
from aoabench.types import Anchors, Batch, Outcome, Reason

FAR = 1e6  # multiple of the anchors' extent; a fix farther from their centre is DIVERGED
POLE = 1e-6  # rad: an elevation this near to +-90 deg leaves the azimuth undefined
PRECISION = 1e-4  # rad: no deviation is estimated below it, because few lines may agree by chance


class Rays(NamedTuple):
    """Measured directions of a batch.

    ahead (R, T, B, 3): unit vectors in the global frame, along the anchor's horizon where only an
    azimuth is measured, 0 where nothing is; line (R, T, B): both angles are measured; plane
    (R, T, B): the azimuth alone; normal (R, T, B, 3): normals of these planes, else 0.
    """

    ahead: Array
    line: np.ndarray
    plane: np.ndarray
    normal: Array

    @property
    def used(self) -> np.ndarray:
        """Mask (R, T, B) of the anchors that measured an azimuth."""
        return self.line | self.plane

    def of(self, used: np.ndarray) -> Rays:
        """The rays of some anchors, by a mask (R, T, B); the others count as not measured."""
        keep = used[..., None]
        ahead, normal = np.where(keep, self.ahead, 0.0), np.where(keep, self.normal, 0.0)
        return Rays(ahead, self.line & used, self.plane & used, normal)


def rays(batch: Batch) -> Rays:
    """The measured rays of a batch; an angle whose stated deviation is not a positive number counts
    as not measured.
    """
    azimuth = np.isfinite(batch.azimuth) & is_deviation(batch.azimuth_sigma)
    elevation = np.isfinite(batch.elevation) & is_deviation(batch.elevation_sigma)
    phi = np.where(azimuth, batch.azimuth, 0.0)
    plane = azimuth & ~elevation
    u = to_unit(phi, np.where(azimuth & elevation, batch.elevation, 0.0))
    ahead = np.where(azimuth[..., None], _turned(u, batch.anchors.rotation), 0.0)
    normal = np.zeros_like(ahead)
    if plane.any():
        n = np.stack([-np.sin(phi), np.cos(phi), np.zeros_like(phi)], axis=-1)
        normal = np.where(plane[..., None], _turned(n, batch.anchors.rotation), 0.0)
    return Rays(ahead, azimuth & elevation, plane, normal)


def is_deviation(sigma: Array | None) -> np.ndarray | bool:
    """Where a stated deviation is finite and above 0; True without one."""
    if sigma is None:
        return True
    with np.errstate(invalid="ignore"):
        return np.isfinite(sigma) & (sigma > 0)


def _turned(u: Array, rotation: Array) -> Array:
    """Vectors (R, T, B, 3) from the anchors' frames into the global frame."""
    return np.asarray((u[..., None, :] @ rotation)[..., 0, :])


def off_the_poles(batch: Batch) -> tuple[Batch, np.ndarray]:
    """The batch with the frames of some anchors turned, and the mask (R, T) of the fixes concerned.

    An anchor that measured an elevation of +-90 deg, up to POLE, sees the target along its pole;
    any azimuth may stand beside it. In a frame whose x axis is the pole, azimuth and elevation of
    the ray are 0, and both have the elevation's deviation.
    """
    steep = np.abs(batch.elevation)
    if not (steep > np.pi / 2 - POLE).any():
        return batch, np.zeros(steep.shape[:2], dtype=bool)
    at_pole = np.abs(steep - np.pi / 2) < POLE
    up = np.sign(batch.elevation[..., None])
    x, y, z = np.moveaxis(np.broadcast_to(batch.anchors.rotation, (*at_pole.shape, 3, 3)), -2, 0)
    turned = np.stack([up * z, y, -up * x], axis=-2)
    rotation = np.where(at_pole[..., None, None], turned, batch.anchors.rotation)
    azimuth_sigma = batch.azimuth_sigma
    if azimuth_sigma is not None and batch.elevation_sigma is not None:
        azimuth_sigma = np.where(at_pole, batch.elevation_sigma, azimuth_sigma)
    found = replace(
        batch,
        azimuth=np.where(at_pole, 0.0, batch.azimuth),
        elevation=np.where(at_pole, 0.0, batch.elevation),
        azimuth_sigma=azimuth_sigma,
        anchors=replace(batch.anchors, rotation=rotation),
    )
    return found, np.asarray(at_pole.any(axis=-1))


def those(batch: Batch, fixes: np.ndarray) -> Batch:
    """The batch (1, N, B) of N fixes of a snapshot batch, by a mask (R, T)."""

    def chosen(a: np.ndarray) -> np.ndarray:
        return np.asarray(np.broadcast_to(a, (*fixes.shape, *a.shape[2:]))[fixes][None])

    def anchors(given: Anchors) -> Anchors:
        return Anchors(**{name: chosen(a) for name, a in given.arrays.items()})

    given = {n: a for n, a in batch.arrays.items() if a is not None and not n.startswith("prior")}
    return Batch(
        anchors=anchors(batch.anchors),
        known=None if batch.known is None else anchors(batch.known),
        **{name: chosen(a) for name, a in given.items()},
    )


def occupied(batch: Batch) -> Batch:
    """The batch with the anchor of the step's first occupied place at each empty place, so that
    empty places change neither the anchors' extent nor an average by much.
    """
    if batch.anchor_id is None or (batch.anchor_id >= 0).all():
        return batch
    there = batch.anchor_id >= 0
    first = there.argmax(axis=2)[..., None, None]
    position, rotation = batch.anchors.position, batch.anchors.rotation
    return replace(
        batch,
        anchors=replace(
            batch.anchors,
            position=np.where(there[..., None], position, np.take_along_axis(position, first, 2)),
            rotation=np.where(
                there[..., None, None],
                rotation,
                np.take_along_axis(rotation, first[..., None], 2),
            ),
        ),
    )


def apart(position: Array, used: np.ndarray) -> np.ndarray:
    """Mask (R, T) of the fixes whose anchors, used (R, T, B) at position (R|1, T|1, B, k) m, stand
    in more than one place.

    Lines and planes through one place meet there for all measurements.
    """
    s = position - position.mean(axis=2, keepdims=True)
    s = np.where(used[..., None], s, 0.0)
    n, squares = used.sum(axis=-1), (s**2).sum(axis=(-1, -2))
    between = n * squares - (s.sum(axis=-2) ** 2).sum(axis=-1)
    return np.asarray(between > ONE_PLACE * n * squares)


def extent(position: Array) -> Array:
    """Largest distance (R|1, T|1) m of the anchors (R|1, T|1, B, 3) m from their centre."""
    away = position - position.mean(axis=2, keepdims=True)
    return np.sqrt((away**2).sum(axis=-1)).max(axis=-1)


def behind(ahead: Array, s: Array, p: Array) -> np.ndarray:
    """Mask (R, T) of the positions p (R, T, 3) m that lie behind one of the anchors s
    (R|1, T|1, B, 3) m, whose measured rays are `ahead` (R, T, B, 3), 0 where not used.

    A height that is not known (NaN) is taken as the anchor's.
    """
    d = p[:, :, None] - s
    d = np.where(np.isnan(d), 0.0, d)
    return np.asarray(((ahead * d).sum(axis=-1) < 0).any(axis=-1))


def measured_reason(
    used: np.ndarray, least: int, one_place: np.ndarray | None = None
) -> np.ndarray:
    """Reason (R, T) for a fix without a position, from the anchors used (R, T, B), the number that
    the method needs, and the mask (R, T) of fixes with all anchors in one place.
    """
    n = used.sum(axis=-1)
    together = np.zeros(n.shape, dtype=bool) if one_place is None else one_place
    choices = [(n == 0, Reason.NO_MEASUREMENT), (n < least, Reason.TOO_FEW_ANCHORS)]
    choices += [(together, Reason.ONE_PLACE)]
    found = np.select([c for c, _ in choices], [r for _, r in choices], Reason.UNDETERMINED)
    return np.asarray(found, dtype=np.int8)


def judged(
    found: np.ndarray, back: np.ndarray, failed: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Outcomes and reasons (R, T) of closed-form fixes: FAILED with the reason `failed` where no
    position was `found`, DIVERGED where the position lies `back` of an anchor, else OK.
    """
    outcome = np.where(found, np.where(back, Outcome.DIVERGED, Outcome.OK), Outcome.FAILED)
    reason = np.where(found, np.where(back, Reason.BEHIND, Reason.NONE), failed)
    return outcome.astype(np.int8), reason.astype(np.int8)


def angular_variance(batch: Batch, r: Rays) -> Array | None:
    """Stated variances (R, T, B) rad^2 of the rays, per direction across a ray: the mean of
    (sigma_azimuth cos elevation)^2 and sigma_elevation^2, or that of the azimuth alone; None if the
    measurements state none.
    """
    if batch.azimuth_sigma is None:
        return None
    a = np.square(batch.azimuth_sigma)
    if batch.elevation_sigma is None:
        return np.where(r.used, a, np.nan)
    cosine = np.cos(np.where(r.line, batch.elevation, 0.0))
    both = 0.5 * (a * cosine**2 + np.square(batch.elevation_sigma))
    return np.where(r.line, both, np.where(r.plane, a, np.nan))


def residual_variance(squares: Array, freedom: np.ndarray) -> Array:
    """Variance (R, T) rad^2 from sums of squared angular residuals (R, T) rad^2 with so many
    degrees of `freedom` (R, T); at least PRECISION^2, NaN without a degree of freedom.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        found = np.where(freedom > 0, squares / np.maximum(freedom, 1), np.nan)
        return np.maximum(found, PRECISION**2)
