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

from dataclasses import dataclass
from types import ModuleType
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from aoabench.kernels.loading import Compiled, engine_param
from aoabench.maths.geometry import Array
from aoabench.params import param
from aoabench.roles import Estimator, Scenario
from aoabench.streams import Streams
from aoabench.types import Batch, Estimates, Outcome

if TYPE_CHECKING:  # loaded by name; results depend on it, and store.source_hash must see that
    from aoabench.kernels import snapshot  # noqa: F401
from aoabench.maths.linalg import SINGULAR, solve

KERNELS = "kernels.snapshot"


ROWS = ("printed", "invariant")


def rows_param() -> Any:
    """The parameter that chooses the elevation's equations."""
    help = "the elevation's equations: as printed, or invariant to turns about the vertical"
    return param("printed", help, choices=ROWS)


@dataclass(frozen=True)
class LeastSquares(Compiled, Estimator):
    """The closed-form solution of the linear equations above."""

    rows: str = rows_param()
    engine: str = engine_param()
    tile = 1
    kernels = KERNELS

    @property
    def needs(self) -> frozenset[str]:
        return frozenset({"elevation", "several_anchors"})

    def __call__(self, batch: Batch, scenario: Scenario, streams: Streams) -> Estimates:
        """One position per fix; outcome FAILED if the equations do not determine a position."""
        compiled = self.compiled(batch.anchors)
        if compiled is None:
            position = planes(batch, self.rows)
        else:
            position, _, _ = by_kernel(compiled, batch, self.rows)
        outcome = np.where(np.isfinite(position).all(-1), Outcome.OK, Outcome.FAILED).astype(
            np.int8
        )
        return Estimates(position, None, None, outcome)


def by_kernel(
    compiled: ModuleType,
    batch: Batch,
    rows: str,
    azimuth: int = 0,
    printed: int = 0,
    tolerance: float = 0.0,
    updates: int = 0,
) -> tuple[Array, np.ndarray, np.ndarray]:
    """Positions (R, T, 3) m, outcomes and numbers of updates (R, T); least squares alone if
    `updates` is 0.
    """
    R, T, B = batch.azimuth.shape
    x, outcome, count = np.empty((R, T, 3)), np.empty((R, T), dtype=np.int8), np.empty((R, T))
    phi, theta, wa, we = (padded(a, compiled.LANES) for a in measured(batch))
    options = (azimuth, printed, ROWS.index(rows), tolerance, updates)
    position, rotation = batch.anchors.frames
    centre = position.mean(axis=1, keepdims=True)  # (R|1, 1, 3)
    # padded with the last anchor: an anchor of zeros would have angles of NaN
    s = padded(np.swapaxes(position - centre, 1, 2), compiled.LANES, "edge")
    rotation = padded(np.moveaxis(rotation, 1, -1), compiled.LANES, "edge")
    for i in range(R):
        j, k = min(i, len(s) - 1), min(i, len(rotation) - 1)
        compiled.gauss_newton(
            *options, phi[i], theta[i], wa[i], we[i], s[j], rotation[k], x[i], outcome[i], count[i]
        )
    return x + centre, outcome, count


def measured(batch: Batch) -> tuple[Array, Array, Array, Array]:
    """Azimuths and elevations (R, T, B) rad and 1 / variance of each; both 0 if not measured."""
    angles = []
    weights = []
    for y, sigma in (
        (batch.azimuth, batch.azimuth_sigma),
        (batch.elevation, batch.elevation_sigma),
    ):
        w = np.ones_like(y) if sigma is None else 1.0 / np.square(sigma)
        known = np.isfinite(y) & np.isfinite(w) & (w > 0)
        angles.append(np.where(known, y, 0.0))
        weights.append(np.where(known, w, 0.0))
    return angles[0], angles[1], weights[0], weights[1]


def padded(a: Array, lanes: int, by: Literal["constant", "edge"] = "constant") -> Array:
    """The array with its last axis padded to a multiple of `lanes`, by zeros or by repeating the
    last element.
    """
    missing = -a.shape[-1] % lanes
    return np.ascontiguousarray(
        np.pad(a, [(0, 0)] * (a.ndim - 1) + [(0, missing)], by) if missing else a
    )


def planes(batch: Batch, rows: str = "printed") -> Array:
    """Least-squares positions (R, T, 3) m; angles that are not measured give no row.

    NaN if A^T A is singular, and if all anchors that measured are at one place, because their
    planes meet at this place for all measurements.
    """
    phi, theta = batch.azimuth, batch.elevation
    zero = np.zeros_like(phi)
    s, c = np.sin(phi), np.cos(phi)
    first = np.stack([s, -c, zero], axis=-1)
    if rows == "printed":
        second = np.stack([np.tan(theta), zero, -c], axis=-1)
    else:
        second = np.stack([np.sin(theta) * c, np.sin(theta) * s, -np.cos(theta)], axis=-1)
    a = np.stack([first, second], axis=-2)  # (R, T, B, 2, 3)
    missing = ~np.isfinite(a).all(axis=-1, keepdims=True)
    a = np.where(missing, 0.0, a) @ batch.anchors.rotation
    centre = batch.anchors.position.mean(axis=2, keepdims=True)
    b = (a @ (batch.anchors.position - centre)[..., None])[..., 0]  # (R, T, B, 2)
    A, g = np.einsum("rtbki,rtbkj->rtij", a, a), np.einsum("rtbki,rtbk->rti", a, b)
    used = ~missing[..., 0, 0] | ~missing[..., 1, 0]
    s = np.where(used[..., None], batch.anchors.position - centre, 0.0)  # (R, T, B, 3)
    n, m2 = used.sum(axis=-1), (s**2).sum(axis=(-1, -2))
    apart = n * m2 - (s.sum(axis=-2) ** 2).sum(axis=-1)
    return np.where((apart > SINGULAR * n * m2)[..., None], solve(A, g) + centre[:, :, 0], np.nan)
