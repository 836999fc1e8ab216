"""Weighted centroid geometric (WCG) positioning: each access node (AN) gives a position [Lu 2019,
(12)-(14)].

    p_m = s_m + c tau_m R_m^T (cos e cos a, cos e sin a, sin e)
    p   = sum w_m p_m / sum w_m,    w_m = 1 / var(tau_m)
"""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass

import numpy as np

from aoabench.errors import Unfit
from aoabench.estimators.places import anchors_used, several
from aoabench.estimators.rays import is_deviation, judged, measured_reason
from aoabench.kernels.loading import Compiled, engine_param
from aoabench.maths.geometry import LIGHT, Array, to_unit
from aoabench.params import param
from aoabench.roles import NEEDS, Estimator, Scenario
from aoabench.streams import Streams
from aoabench.types import Batch, Estimates


@dataclass(frozen=True)
class WeightedCentroid(Compiled, Estimator):
    """The mean of the ANs' positions of the target, weighted by the inverse variances of the times.

    The covariance follows from the stated deviations of times, angles and ANs' positions; None if
    the measurements do not state them. A fix behind an AN that it uses is DIVERGED.
    """

    as_printed: bool = param(
        False,
        "whether (12) runs as printed: the array's orientation stays in the measured azimuth [U5]",
    )
    _: KW_ONLY
    engine: str = engine_param()
    tile = 32
    by_replication = True
    heard_only = True
    kernels = "kernels.centroid"
    per_step = True
    uses = frozenset({"elevation", "delay", "stated_sigma"})

    @property
    def needs(self) -> frozenset[str]:
        return frozenset({"elevation", "delay", "stated_sigma"})

    def __call__(self, batch: Batch, scenario: Scenario, streams: Streams) -> Estimates:
        """One position per fix; outcome FAILED if no AN measured a time and both angles."""
        if batch.delay is None or batch.delay_sigma is None:
            raise Unfit(*NEEDS["delay"])
        compiled = self.compiled(batch.anchors)
        if compiled is None:
            return self._estimates(batch, batch.delay, batch.delay_sigma)
        position, P, used, outcome, reason = compiled.run(batch, self.as_printed)
        if several(batch):  # the kernel counts columns
            used = anchors_used(batch, _usable(batch, batch.delay, batch.delay_sigma))
        stated = batch.azimuth_sigma is not None and batch.elevation_sigma is not None
        return Estimates(position, P if stated else None, None, outcome, None, used, reason)

    def _estimates(self, batch: Batch, delay: Array, delay_sigma: Array) -> Estimates:
        """The kernel's estimates in NumPy."""
        R, T, B = batch.azimuth.shape
        usable = _usable(batch, delay, delay_sigma)
        r, k, b = np.nonzero(usable)
        azimuth = batch.azimuth[r, k, b]
        s, rotation = (
            np.broadcast_to(a, (R, T, *a.shape[2:]))[r, k, b]
            for a in (batch.anchors.position, batch.anchors.rotation)
        )
        if self.as_printed:  # the orientation is applied to the azimuth and to the unit vector
            azimuth = azimuth + np.arctan2(rotation[:, 0, 1], rotation[:, 0, 0])
        elevation = batch.elevation[r, k, b]
        distance = LIGHT * delay[r, k, b]
        local = distance[:, None] * to_unit(azimuth, elevation)
        along = (local[:, None, :] @ rotation)[:, 0]
        w = 1.0 / np.square(delay_sigma[r, k, b])
        fix = r * T + k
        total = np.asarray(np.bincount(fix, w, R * T), dtype=float)
        sums = [np.bincount(fix, w * x, R * T) for x in (s + along).T]
        with np.errstate(invalid="ignore"):
            position = np.stack(sums, axis=-1) / total[:, None]
        back = np.bincount(fix, (along * (position[fix] - s)).sum(axis=-1) < 0, R * T) > 0
        found: np.ndarray = np.asarray(np.isfinite(position).all(-1)).reshape(R, T)
        outcome, reason = judged(found, back.reshape(R, T), measured_reason(usable, 1))
        P = None
        if batch.azimuth_sigma is not None and batch.elevation_sigma is not None:
            stated = delay_sigma, batch.azimuth_sigma, batch.elevation_sigma
            given = tuple(x[r, k, b] for x in stated)
            axes = _axes((distance, azimuth, elevation), given, rotation)
            own = batch.anchors.position_sigma
            own = None if own is None else np.broadcast_to(own, (R, T, B, 3))[r, k, b].T
            P = _weighted(axes, own, w, fix, total).reshape(R, T, 3, 3)
        used, position = anchors_used(batch, usable), position.reshape(R, T, 3)
        return Estimates(position, P, None, outcome, None, used, reason)


def _usable(batch: Batch, delay: Array, delay_sigma: Array) -> np.ndarray:
    """Mask (R, T, B) of the ANs that measured a time and both angles."""
    usable = np.isfinite(batch.azimuth) & is_deviation(batch.azimuth_sigma)
    usable &= np.isfinite(batch.elevation) & is_deviation(batch.elevation_sigma)
    return np.asarray(usable & np.isfinite(delay) & is_deviation(delay_sigma))


def _axes(at: tuple[Array, ...], sigmas: tuple[Array, ...], rotation: Array) -> Array:
    """Errors (3, 3, N) m, in x, y and z, of points at distance m, azimuth and elevation rad (N,) in
    frames `rotation` (N, 3, 3): one deviation of the delay s, azimuth or elevation rad each.
    """
    r, (ca, sa, ce, se) = at[0], (f(angle) for angle in at[1:] for f in (np.cos, np.sin))
    x, y, z = np.moveaxis(rotation, 0, -1)  # the frames' axes, (3, N) each
    out, left = ca * x + sa * y, ca * y - sa * x
    scale = LIGHT * sigmas[0], sigmas[1] * r * ce, sigmas[2] * r
    units = ce * out + se * z, left, ce * z - se * out
    return np.stack([s * u for s, u in zip(scale, units)])


def _weighted(axes: Array, own: Array | None, w: Array, fix: np.ndarray, total: Array) -> Array:
    """Covariances (F, 3, 3) m^2 of weighted means, from independent errors (3, 3, N) m of the
    points, deviations (3, N) m of the ANs' positions, weights and numbers of fixes (N,), and the
    fixes' sums of weights (F,).
    """
    found, squared = np.empty((len(total), 3, 3)), w * w
    for i in range(3):
        for j in range(i + 1):
            each = axes[0, i] * axes[0, j] + axes[1, i] * axes[1, j] + axes[2, i] * axes[2, j]
            if i == j and own is not None:
                each += own[i] ** 2
            found[:, i, j] = found[:, j, i] = np.bincount(fix, squared * each, len(total))
    with np.errstate(invalid="ignore"):
        return found / (total**2)[:, None, None]
