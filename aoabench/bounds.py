"""Limits of accuracy: Fisher information, Cramér-Rao bound, geometric dilution of precision.

All functions take points (..., 3) m and anchors (1, 1, B, ...), and broadcast.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from aoabench.maths.geometry import Array, in_frames
from aoabench.types import Anchors

SINGULAR = 1e-12  # ratio of the eigenvalues up to which an information matrix is singular


def azel_information(
    point: Array, anchors: Anchors, azimuth_sigma: float | Array, elevation_sigma: float | Array
) -> Array:
    """Fisher information (..., 3, 3) 1/m^2 of independent normal azimuths and elevations, G^T C^-1
    G [Le 2021, (30)].

    The deviations in rad are arrays (B,) or one number for all anchors. The azimuth's part is
    infinite at an anchor's pole, and NaN at the anchor itself.
    """
    p = np.asarray(point, dtype=float)
    local = np.stack(in_frames(p.reshape(1, -1, 3), *anchors.frames), axis=-1)[0]  # (N, B, 3)
    x, y, z = local[..., 0], local[..., 1], local[..., 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        rho = np.hypot(x, y)
        r = np.hypot(rho, z)
        azimuth = np.stack([-y, x, np.zeros_like(x)], axis=-1) / (rho**2)[..., None]
        elevation = np.stack([-x * z / rho, -y * z / rho, rho], axis=-1) / (r**2)[..., None]
        rows = np.stack(
            [azimuth / _column(azimuth_sigma), elevation / _column(elevation_sigma)], axis=-2
        )
        G = rows @ anchors.rotation[0, 0]  # (N, B, 2, 3), whitened
        return np.einsum("nbmi,nbmj->nij", G, G).reshape(*p.shape[:-1], 3, 3)


def direction_information(point: Array, anchors: Anchors, kappa: float | Array) -> Array:
    """Fisher information (..., 3, 3) 1/m^2 of von Mises-Fisher directions: sum of A kappa (I - d
    d^T) / r^2.

    A = coth(kappa) - 1 / kappa is the mean resultant length; kappa is an array (B,) or one number
    for all anchors. No direction is singular.
    """
    p = np.asarray(point, dtype=float)
    offset = p[..., None, :] - anchors.position[0, 0]
    r = np.linalg.norm(offset, axis=-1, keepdims=True)
    k = np.asarray(kappa, dtype=float)
    weight = k / np.tanh(k) - 1.0
    with np.errstate(divide="ignore", invalid="ignore"):
        d = offset / r
        across = (np.eye(3) - d[..., :, None] * d[..., None, :]) / (r**2)[..., None]
        return (weight[..., None, None] * across).sum(axis=-3)


def crb(information: Array) -> Array:
    """Lower bound (..., n, n) m^2 on the covariance of unbiased estimators; NaN where the
    information is singular.
    """
    J = np.asarray(information, dtype=float)
    whole = np.isfinite(J).all((-1, -2))
    one = np.eye(J.shape[-1])
    J = np.where(whole[..., None, None], J, one)
    spread = np.linalg.eigvalsh(J)
    whole &= spread[..., 0] > SINGULAR * spread[..., -1]
    J = np.where(whole[..., None, None], J, one)
    return np.where(whole[..., None, None], np.linalg.inv(J), np.nan)


def gdop(
    point: Array, anchors: Anchors, axes: Sequence[int] = (0, 1, 2), known_z: bool = False
) -> Array:
    """Position error (...) in m per rad of equal angular deviations: sqrt(tr CRB) at sigma = 1 rad
    over these axes.

    With `known_z`, the third row and column of the information are left out [Boquet 2024, (28) and
    A.1]; the axes are then x and y.
    """
    information = azel_information(point, anchors, 1.0, 1.0)
    bound = crb(information[..., :2, :2] if known_z else information)
    return np.sqrt(sum(bound[..., i, i] for i in ((0, 1) if known_z else axes)))


def _column(sigma: float | Array) -> Array:
    return np.asarray(sigma, dtype=float)[..., None]
