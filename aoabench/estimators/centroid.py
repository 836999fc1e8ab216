"""Weighted centroid geometric (WCG) positioning: each access node (AN) gives a position [Lu 2019,
(12)-(14)].

    p_m = s_m + c tau_m R_m^T (cos e cos a, cos e sin a, sin e)
    p   = sum w_m p_m / sum w_m,    w_m = 1 / var(tau_m)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aoabench.errors import Unfit
from aoabench.maths.geometry import LIGHT, to_unit
from aoabench.params import param
from aoabench.roles import NEEDS, Estimator, Scenario
from aoabench.streams import Streams
from aoabench.types import Batch, Estimates, Outcome


@dataclass(frozen=True)
class WeightedCentroid(Estimator):
    """The mean of the ANs' positions, weighted by the inverse variances of their times."""

    as_printed: bool = param(
        False,
        "whether (12) runs as printed: the array's orientation stays in the measured azimuth [U5]",
    )
    tile = 8

    @property
    def needs(self) -> frozenset[str]:
        return frozenset({"elevation", "delay", "stated_sigma"})

    def __call__(self, batch: Batch, scenario: Scenario, streams: Streams) -> Estimates:
        """One position per fix; outcome FAILED if no AN measured a time and both angles."""
        if batch.delay is None or batch.delay_sigma is None:
            raise Unfit(*NEEDS["delay"])
        R, T, B = batch.azimuth.shape
        usable = (
            np.isfinite(batch.azimuth) & np.isfinite(batch.elevation) & np.isfinite(batch.delay)
        )
        r, k, b = np.nonzero(usable & (batch.delay_sigma > 0))
        azimuth = batch.azimuth[r, k, b]
        s, rotation = (
            np.broadcast_to(a, (R, T, *a.shape[2:]))[r, k, b]
            for a in (batch.anchors.position, batch.anchors.rotation)
        )
        if (
            self.as_printed
        ):  # the orientation is applied twice: to the azimuth and to the unit vector
            azimuth = azimuth + np.arctan2(rotation[:, 0, 1], rotation[:, 0, 0])
        local = LIGHT * batch.delay[r, k, b, None] * to_unit(azimuth, batch.elevation[r, k, b])
        p = s + (local[:, None, :] @ rotation)[:, 0]
        w = 1.0 / np.square(batch.delay_sigma[r, k, b])
        fix = r * T + k
        total = np.bincount(fix, w, R * T)
        sums = np.stack([np.bincount(fix, w * p[:, i], R * T) for i in range(3)], axis=-1)
        with np.errstate(invalid="ignore"):
            position = (sums / total[:, None]).reshape(R, T, 3)
        outcome = np.where(np.isfinite(position).all(-1), Outcome.OK, Outcome.FAILED).astype(
            np.int8
        )
        return Estimates(position, None, None, outcome)
