"""Limits of accuracy: Fisher information, Cramér-Rao bound, geometric dilution of precision.

All functions take points (..., 3) m and anchors (1, 1, B, ...), and broadcast.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from aoabench.maths.geometry import Array, in_frames
from aoabench.types import Anchors

SINGULAR = 1e-12  # ratio of the eigenvalues up to which an information matrix is singular
POLE = 1e-5  # rad: a point whose direction is this close to an anchor's z axis is on the pole


def azel_information(
    point: Array, anchors: Anchors, azimuth_sigma: float | Array, elevation_sigma: float | Array
) -> Array:
    """Fisher information (..., 3, 3) 1/m^2 of independent normal azimuths and elevations, G^T C^-1
    G [Le 2021, (30)].

    The deviations in rad are arrays (B,) or one number for all anchors. At an anchor's pole, the
    entries across its z axis are infinite on the diagonal and NaN beside it, where they have no
    limit; the others are the limits. NaN at the anchor itself.
    """
    p = np.asarray(point, dtype=float)
    local = _local(p, anchors)
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
        at_pole = (rho == 0) & (r > 0)
        G[at_pole] = 0.0
        J = np.einsum("nbmi,nbmj->nij", G, G)
    for n, b in np.argwhere(at_pole):
        across = np.flatnonzero(1 - anchors.rotation[0, 0, b, 2] ** 2 > 1e-12)
        J[n][np.ix_(across, across)] += np.where(np.eye(len(across)) > 0, np.inf, np.nan)
    return np.asarray(J.reshape(*p.shape[:-1], 3, 3))


def _local(point: Array, anchors: Anchors) -> Array:
    """Offsets (N, B, 3) m of points (..., 3) m from the anchors, in the anchors' frames."""
    return np.stack(in_frames(point.reshape(1, -1, 3), *anchors.frames), axis=-1)[0]


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
    information is singular or not finite (at a pole it has no limit; `gdop` has one).
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
    A.1]; the axes are then x and y. NaN where the information is singular.

    At an anchor's pole, exactly above or below an upright one, this is the largest limit over all
    directions of approach. Let a be the anchor's z axis, r its distance, and u across a the
    direction of approach. As the angle to the axis shrinks, the information of the azimuth grows
    without limit along a x u, that of the elevation goes to u u^T / r^2, and the other anchors' J
    stays. The bound goes to the inverse of J + u u^T / r^2 on the complement of a x u, which
    depends on u through J alone. A single upright anchor gives r with a known height.
    """
    p = np.asarray(point, dtype=float)
    kept = (0, 1) if known_z else tuple(axes)
    information = azel_information(p, anchors, 1.0, 1.0)
    bound = crb(information[..., :2, :2] if known_z else information)
    found = np.sqrt(sum(bound[..., i, i] for i in kept))
    local = _local(p, anchors)
    r = np.linalg.norm(local, axis=-1)
    poles = (np.hypot(local[..., 0], local[..., 1]) <= POLE * r) & (r > 0).all(axis=1)[:, None]
    flat = np.atleast_1d(found).ravel()
    for n in np.flatnonzero(poles.any(axis=1)):
        flat[n] = _gdop_at_pole(p.reshape(-1, 3)[n], anchors, poles[n], kept, known_z)
    return flat.reshape(np.shape(found))[()]


def _gdop_at_pole(
    point: Array, anchors: Anchors, poles: np.ndarray, kept: Sequence[int], known_z: bool
) -> float:
    """The largest limit of `gdop` at a point (3,) m on the z axes of the anchors `poles` (B,), over
    directions of approach: horizontal ones with `known_z`, else those across the first of the axes.
    """
    others = anchors.those(np.flatnonzero(~poles))
    J = azel_information(point, others, 1.0, 1.0)
    axis = anchors.rotation[0, 0, poles, 2]  # (K, 3)
    r = np.linalg.norm(point - anchors.position[0, 0, poles], axis=-1)
    plane = np.eye(3)[:2] if known_z else np.linalg.svd(axis[:1])[2][1:]  # two directions (2, 3)

    def limits(turn: Array) -> Array:
        """The limits for directions at the angles `turn` (D,) in the plane; -inf along an axis."""
        d = np.cos(turn)[:, None] * plane[0] + np.sin(turn)[:, None] * plane[1]
        u = d[:, None] - (d @ axis.T)[..., None] * axis  # (D, K, 3)
        length = np.linalg.norm(u, axis=-1, keepdims=True)
        u = u / np.maximum(length, POLE)
        total = J + np.einsum("dki,dkj->dij", u / r[:, None], u / r[:, None])
        endless = np.cross(axis, u)
        if known_z:
            total, endless = total[:, :2, :2], endless[..., :2]
        trace = _trace_without(total, endless, kept)
        return np.where((length[..., 0] > POLE).all(axis=1), np.sqrt(trace), -np.inf)

    middle, width = 0.0, np.pi / 2
    for _ in range(6):  # each round keeps 1/32 of the range about the best direction
        turn = middle + width * np.linspace(-1, 1, 129)
        found = limits(turn)
        middle, width = turn[int(np.argmax(found))], width / 32
    return float(found.max())


def _trace_without(information: Array, endless: Array, kept: Sequence[int]) -> Array:
    """Trace over the axes `kept` of the inverse of information (D, n, n) on the complement of the
    directions `endless` (D, K, n), along which the information is infinite; NaN if singular.
    """
    size, basis = np.linalg.eigh(np.einsum("dki,dkj->dij", endless, endless))
    trace = np.zeros(len(size))
    free = (size < POLE).sum(axis=1)  # eigenvalues ascend
    for m in np.unique(free[free > 0]):
        some = free == m
        N = basis[some][..., :m]
        bound = N @ crb(N.swapaxes(1, 2) @ information[some] @ N) @ N.swapaxes(1, 2)
        trace[some] = sum(bound[:, i, i] for i in kept)
    return trace


def _column(sigma: float | Array) -> Array:
    return np.asarray(sigma, dtype=float)[..., None]
