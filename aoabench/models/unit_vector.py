"""Unit-vector measurement model: von Mises-Fisher directions, which Kalman filters take as normal
with covariance I / kappa.

Components in anchor order: x, y, z of the unit vector in the frame of anchor 1, of anchor 2, ...
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass

import numpy as np

from aoabench.maths.directional import kappa_from_sigma, vmf_log_peak
from aoabench.maths.geometry import Array, in_frames, rotations_for, to_unit
from aoabench.models.components import (
    interleave,
    into_state,
    over_measured,
    per_step,
    stated_deviations,
    unstated_param,
    with_quality,
)
from aoabench.params import param
from aoabench.roles import Measurement
from aoabench.types import Anchors, Batch

KAPPA_MOST = 1e15  # larger ones weigh the rounding errors of unit vectors


@dataclass(frozen=True)
class UnitVector(Measurement):
    """u_j ~ VMF(R_j (theta - s_j) / |theta - s_j|, kappa) [Nurminen 2018, (5) with R_j, (9)]."""

    kappa: float | None = param(
        None,
        "concentration; null: by (7) from the measurements' stated deviations",
        above=0,
        most=KAPPA_MOST,
    )
    _: KW_ONLY
    unstated_deg: Sequence[float] = unstated_param()
    kernel = "unit_vector"

    @property
    def needs(self) -> frozenset[str]:
        """Elevations: a direction has both angles."""
        return frozenset({"elevation"})

    @property
    def uses(self) -> frozenset[str]:  # type: ignore[override]
        return frozenset({"elevation"} | ({"stated_sigma"} if self.kappa is None else set()))

    def deviations(self, batch: Batch) -> tuple[Array, Array]:
        """Nominal deviations (R|1, T|1, B) rad of azimuths and elevations, or 1 / sqrt(kappa)."""
        if self.kappa is not None:
            own = np.full((1, 1, batch.azimuth.shape[2]), 1.0 / np.sqrt(self.kappa))
            return own, own
        if batch.azimuth_sigma is not None and batch.elevation_sigma is None:
            return batch.azimuth_sigma, batch.azimuth_sigma
        return stated_deviations(batch, self.unstated_deg)

    def observe(self, batch: Batch) -> tuple[Array, Array]:
        """Unit vectors (R, T, 3B) and their nominal variances 1 / kappa (R, T, 3B), kappa at most
        1e15.
        """
        u = to_unit(batch.azimuth, batch.elevation)
        if self.kappa is not None:
            r = np.full((1, 1, batch.azimuth.shape[2]), 1.0 / self.kappa)
        else:
            kappa = kappa_from_sigma(*self.deviations(batch))
            r = np.where(kappa < np.inf, 1.0 / np.minimum(kappa, KAPPA_MOST), 0.0)
        return with_quality(u.reshape(*u.shape[:2], -1), np.repeat(r, 3, -1))

    def predict(self, x: Array, anchors: Anchors) -> Array:
        """Unit vectors (R, ..., 3B) towards positions x (R, ..., n); 0 for a position at the anchor
        itself.
        """
        return interleave(_directions(x, anchors)[0])

    def residual(self, y: Array, expected: Array) -> Array:
        """y - expected (..., 3B)."""
        return y - expected

    def jacobian(self, x: Array, anchors: Anchors) -> Array:
        """Derivatives (R, ..., 3B, n): R_j (I - d d^T) / |theta - s_j| = (I - c c^T) R_j / |theta -
        s_j|, c = R_j d.
        """
        units, distance = _directions(x, anchors)
        c = np.stack(units, axis=-1)
        R = rotations_for(x, anchors.frames[1])
        d = (c[..., None, :] @ R)[..., 0, :]  # back in the global frame
        return into_state(
            (R - c[..., :, None] * d[..., None, :]) / distance[..., None, None], x.shape[-1]
        )

    def covariance(self, x: Array, anchors: Anchors, quality: Array) -> Array:
        """Variances 1 / kappa (R, ..., 3B), independent of x."""
        return per_step(quality, x)

    def loglik(self, x: Array, anchors: Anchors, y: Array, quality: Array) -> Array:
        """VMF log likelihood (R, ...) of directions y (R, 3B); anchors with NaN are left out."""
        units, _ = _directions(x, anchors)
        u, kappa = per_step(y, x), 1.0 / per_step(quality, x)[..., 0::3]
        chord2 = sum((u[..., i::3] - units[i]) ** 2 for i in range(3))
        return over_measured(vmf_log_peak(kappa) - 0.5 * kappa * chord2, y[..., 0::3], x)


def _directions(x: Array, anchors: Anchors) -> tuple[tuple[Array, Array, Array], Array]:
    """Components (R, ..., B) of unit vectors in the anchors' frames; distances (R, ..., B) m."""
    px, py, pz = in_frames(x[..., :3], *anchors.frames)
    distance = np.maximum(np.sqrt(px * px + py * py + pz * pz), 1e-12)
    return (px / distance, py / distance, pz / distance), distance
