"""Closed-form least squares on azimuth and elevation: each measurement is a plane through its
anchor.

In the anchor's frame, p = R_j (x - s_j), azimuth phi and elevation theta give [Le 2021, (10)-(19)]

    (sin phi, -cos phi, 0) p = 0
    (tan theta, 0, -cos phi) p = 0                                   (second row, as printed)
    (sin theta cos phi, sin theta sin phi, -cos theta) p = 0         (or invariant)

and x = (A^T A)^-1 A^T b. The printed second row divides by x - x_j, so that renaming x and y
changes the estimate (L6).
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, replace
from types import ModuleType
from typing import Any

import numpy as np

from aoabench.estimators.packed import calls, padded, padded_anchors
from aoabench.estimators.places import anchors_used, several
from aoabench.estimators.rays import (
    apart,
    behind,
    judged,
    measured_reason,
    occupied,
    off_the_poles,
    rays,
    residual_variance,
    those,
)
from aoabench.kernels.loading import Compiled, engine_param
from aoabench.maths.geometry import Array
from aoabench.maths.linalg import inverse, solve
from aoabench.params import param
from aoabench.roles import Estimator, Scenario
from aoabench.streams import Streams
from aoabench.types import Batch, Estimates

KERNELS = "kernels.snapshot"
TINY = np.finfo(float).tiny  # rad^2: a smaller variance has no finite inverse


ROWS = ("printed", "invariant")


def rows_param() -> Any:
    """The parameter that chooses the elevation's equations."""
    help = "the elevation's equations: invariant to turns about the vertical, or as printed"
    return param("invariant", help, choices=ROWS)


@dataclass(frozen=True)
class LeastSquares(Compiled, Estimator):
    """The closed-form solution of the linear equations above."""

    rows: str = rows_param()
    engine: str = engine_param()
    tile = 1
    by_replication = True
    heard_only = True
    per_step = True
    kernels = KERNELS
    uses = frozenset({"elevation", "stated_sigma"})

    @property
    def needs(self) -> frozenset[str]:
        return frozenset({"elevation", "several_anchors"})

    def __call__(self, batch: Batch, scenario: Scenario, streams: Streams) -> Estimates:
        """One position per fix; outcome FAILED if the equations do not determine a position,
        DIVERGED behind an anchor.

        The covariance follows from the stated variances of the angles, or from one variance that
        the residuals give.
        """
        compiled, batch = self.compiled(batch.anchors), occupied(batch)
        turned, at_pole = off_the_poles(batch)
        if self.rows == "printed":
            turned, at_pole = batch, np.zeros_like(at_pole)
        if compiled is None:
            return planes(turned, self.rows)
        found = by_kernel(compiled, batch, self.rows)
        if not at_pole.any():
            return found
        return replaced(found, planes(those(turned, at_pole), self.rows), at_pole)


def replaced(found: Estimates, others: Estimates, fixes: np.ndarray) -> Estimates:
    """The estimates with N `fixes`, a mask (R, T), taken from others (1, N)."""
    for f in dataclasses.fields(Estimates):
        into, value = getattr(found, f.name), getattr(others, f.name)
        if into is not None:
            into[fixes] = value[0]
    return found


def by_kernel(
    compiled: ModuleType,
    batch: Batch,
    rows: str,
    variant: tuple[int, int] = (0, 0),
    tolerance: float = 0.0,
    updates: int = 0,
) -> Estimates:
    """Estimates of one tile; least squares alone if `updates` is 0. `variant`: the definition of an
    azimuth's difference, and the erratum as printed.
    """
    R, T, B = batch.azimuth.shape
    x, P = np.empty((R, T, 3)), np.empty((R, T, 3, 3))
    outcome, reason = np.empty((2, R, T), dtype=np.int8)
    count, used = np.empty((2, R, T))
    angles = tuple(padded(a, compiled.LANES) for a in measured(batch))
    options = (*variant, ROWS.index(rows), stated(batch), tolerance, updates)
    position, rotation = batch.anchors.position, batch.anchors.rotation
    centre = position.sum(axis=2, keepdims=True) / B  # (R|1, T|1, 1, 3)
    anchors = padded_anchors(position - centre, rotation, compiled.LANES)
    for one in calls(angles, anchors, (x, P, outcome, reason, count, used)):
        compiled.gauss_newton(*options, *one)
    iterations = count if updates else None
    if several(batch):  # the kernel counts columns
        used = anchors_used(batch, measured(batch)[2] > 0)
    return Estimates(x + centre[:, :, 0], P, iterations, outcome, None, used, reason)


def measured(batch: Batch) -> tuple[Array, Array, Array, Array]:
    """Azimuths and elevations (R, T, B) rad and 1 / variance of each; both 0 if not measured."""
    angles = []
    weights = []
    for y, sigma in (
        (batch.azimuth, batch.azimuth_sigma),
        (batch.elevation, batch.elevation_sigma),
    ):
        known = np.isfinite(y)
        if sigma is None:
            weights.append(known.astype(float))
        else:
            variance = np.square(sigma)
            known &= (variance >= TINY) & np.isfinite(variance)
            weights.append(np.divide(1.0, variance, out=np.zeros_like(y), where=known))
        angles.append(np.where(known, y, 0.0))
    return angles[0], angles[1], weights[0], weights[1]


def stated(batch: Batch) -> bool:
    """Whether the measurements state the deviations of both angles."""
    return batch.azimuth_sigma is not None and batch.elevation_sigma is not None


def planes(batch: Batch, rows: str = "invariant") -> Estimates:
    """The least-squares estimates in NumPy; angles that are not measured give no row.

    FAILED if A^T A is singular, and if all anchors that measured are at one place, because their
    planes meet at this place for all measurements.
    """
    phi, theta, wa, we = measured(batch)
    used = wa > 0
    a = _rows(phi, theta, wa, we, rows) @ batch.anchors.rotation  # (R, T, B, 2, 3)
    s = batch.anchors.position
    centre = s.mean(axis=2, keepdims=True)
    b = (a @ (s - centre)[..., None])[..., 0]  # (R, T, B, 2)
    A, g = np.einsum("rtbki,rtbkj->rtij", a, a), np.einsum("rtbki,rtbk->rti", a, b)
    distinct = apart(s, used)
    p = np.where(distinct[..., None], solve(A, g) + centre[:, :, 0], np.nan)
    found: np.ndarray = np.asarray(np.isfinite(p).all(axis=-1))
    outcome, reason = judged(
        found, behind(rays(usable(batch, wa, we)).ahead, s, p), measured_reason(used, 2, ~distinct)
    )
    P = _covariance(batch, (phi, theta, wa, we), a, A, p, rows)
    P = np.where(found[..., None, None], P, np.nan)
    return Estimates(p, P, None, outcome, None, anchors_used(batch, used), reason)


def usable(batch: Batch, wa: Array, we: Array) -> Batch:
    """The batch without the angles that have no weight."""
    azimuth = np.where(wa > 0, batch.azimuth, np.nan)
    return replace(batch, azimuth=azimuth, elevation=np.where(we > 0, batch.elevation, np.nan))


def _rows(phi: Array, theta: Array, wa: Array, we: Array, rows: str) -> Array:
    """The equations' coefficients (R, T, B, 2, 3) in the anchors' frames; 0 if not measured."""
    zero, s, c = np.zeros_like(phi), np.sin(phi), np.cos(phi)
    first = np.stack([s, -c, zero], axis=-1)
    if rows == "printed":
        second = np.stack([np.tan(theta), zero, -c], axis=-1)
    else:
        second = np.stack([np.sin(theta) * c, np.sin(theta) * s, -np.cos(theta)], axis=-1)
    known = np.stack([wa > 0, wa * we > 0], axis=-1)
    return np.where(known[..., None], np.stack([first, second], axis=-2), 0.0)


def _covariance(
    batch: Batch, given: tuple[Array, ...], a: Array, A: Array, p: Array, rows: str
) -> Array:
    """Covariances (R, T, 3, 3) m^2 of the positions p, A^-1 M A^-1.

    e = a (p - s) are the residuals of the rows a; M sums b b^T var over the angles, with b the
    derivative of e by the angle times its row a. Without stated variances, the residuals e / k of m
    angles give one, where k are the derivatives of e by its own angle: with C the covariance for
    variance 1, sum (e / k)^2 has the mean variance (m - 6 + tr(C sum a a^T / k^2)).
    """
    phi, theta, wa, we = given
    offset = p[:, :, None] - batch.anchors.position
    u, v, w = np.moveaxis((batch.anchors.rotation @ offset[..., None])[..., 0], -1, 0)
    s, c, st, ct = np.sin(phi), np.cos(phi), np.sin(theta), np.cos(theta)
    f = c * u + s * v
    if rows == "printed":
        h, k = s * w, u / ct**2
    else:
        h, k = st * (c * v - s * u), ct * f + st * w
    one, two = wa > 0, wa * we > 0
    e = (a @ offset[..., None])[..., 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        va, ve = np.where(one, 1.0 / wa, 0.0), np.where(two, 1.0 / we, 0.0)
        e = e**2  # sin^2 of the residual angles
        squares = np.where(one, e[..., 0] / (e[..., 0] + f**2), 0.0)
        squares += np.where(two, e[..., 1] / (e[..., 1] + k**2), 0.0)
    by_azimuth = f[..., None] * a[..., 0, :] + h[..., None] * a[..., 1, :]
    by_elevation = k[..., None] * a[..., 1, :]
    M = np.einsum("rtb,rtbi,rtbj->rtij", va, by_azimuth, by_azimuth)
    M += np.einsum("rtb,rtbi,rtbj->rtij", ve, by_elevation, by_elevation)
    P = inverse(A) @ M @ inverse(A)
    if stated(batch):
        return np.asarray(P)
    with np.errstate(divide="ignore", invalid="ignore"):
        over = np.stack([np.where(one, 1 / f**2, 0.0), np.where(two, 1 / k**2, 0.0)], axis=-1)
    N = np.einsum("rtbk,rtbki,rtbkj->rtij", over, a, a)
    number = one.sum(axis=-1) + two.sum(axis=-1)
    freedom = np.where(number > 3, number - 6 + (P * N).sum(axis=(-1, -2)), 0.0)
    return np.asarray(P * residual_variance(squares.sum(axis=-1), freedom)[..., None, None])
