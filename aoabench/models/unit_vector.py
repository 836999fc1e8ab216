"""Unit-vector measurement model: von Mises-Fisher directions, normal with covariance I / kappa for Kalman filters.

Components in anchor order: x, y, z of the unit vector in the frame of anchor 1, of anchor 2, ...
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aoabench.directional import kappa_from_sigma, vmf_log_peak
from aoabench.geometry import Array, in_frames, rotations_for, to_unit
from aoabench.models.components import flat, into_state, per_step
from aoabench.types import Anchors, BadValue, Batch, check_number


@dataclass(frozen=True)
class UnitVector:
    """u_j ~ VMF(R_j (theta - s_j) / |theta - s_j|, kappa) [Nurminen 2018, (5) with R_j, (9)].

    `kappa` > 0, or null for what each measurement's stated deviations give by (7).
    """

    kappa: float | None = None

    def __post_init__(self) -> None:
        check_number("kappa", self.kappa, above=0, optional=True)

    def observe(self, batch: Batch) -> tuple[Array, Array]:
        """Unit vectors (R, T, 3B) and their nominal variances 1 / kappa (R, T, 3B)."""
        u = to_unit(batch.azimuth, batch.elevation)
        if self.kappa is not None:
            r = np.full(u.shape, 1.0 / self.kappa)
        elif batch.azimuth_sigma is None:
            raise BadValue("kappa", None, "a number, because these measurements do not state their deviations")
        else:
            r = np.repeat(1.0 / kappa_from_sigma(batch.azimuth_sigma, batch.elevation_sigma)[..., None], 3, axis=-1)
        return flat(u), flat(r)

    def predict(self, x: Array, anchors: Anchors) -> Array:
        """Unit vectors (R, ..., 3B) towards positions x (R, ..., n); 0 where a position lies on its anchor."""
        return flat(_directions(x, anchors)[0])

    def residual(self, y: Array, expected: Array) -> Array:
        """y - expected (..., 3B)."""
        return y - expected

    def jacobian(self, x: Array, anchors: Anchors) -> Array:
        """Derivatives (R, ..., 3B, n): R_j (I - d d^T) / |theta - s_j| = (I - c c^T) R_j / |theta - s_j|, c = R_j d."""
        c, distance = _directions(x, anchors)
        R = rotations_for(x, anchors.rotation)
        d = (c[..., None, :] @ R)[..., 0, :]  # back in the global frame
        return into_state((R - c[..., :, None] * d[..., None, :]) / distance[..., None, None], x.shape[-1])

    def covariance(self, x: Array, anchors: Anchors, quality: Array) -> Array:
        """1 / kappa (R, ..., 3B), whatever x."""
        return per_step(quality, x)

    def loglik(self, x: Array, anchors: Anchors, y: Array, quality: Array) -> Array:
        """VMF log likelihood (R, ...) of directions y (R, 3B); anchors with NaN are left out."""
        chord2 = (per_step(y, x) - self.predict(x, anchors)) ** 2
        half = 0.5 * (chord2[..., 0::3] + chord2[..., 1::3] + chord2[..., 2::3])
        kappa = 1.0 / per_step(quality, x)[..., 0::3]
        return np.nansum(vmf_log_peak(kappa) - kappa * half, axis=-1)


def _directions(x: Array, anchors: Anchors) -> tuple[Array, Array]:
    """Unit vectors (R, ..., B, 3) in the anchors' frames and distances (R, ..., B) m."""
    p = in_frames(x[..., :3], anchors.position, anchors.rotation)
    distance = np.sqrt(p[..., 0] ** 2 + p[..., 1] ** 2 + p[..., 2] ** 2)
    distance = np.maximum(distance, 1e-12)
    return p / distance[..., None], distance
