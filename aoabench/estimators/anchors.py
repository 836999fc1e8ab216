"""Positions from single anchors, where a ray meets the plane of the node's known height [Boquet
2024, 2.2.1], and the naive methods that choose one anchor or take the mean [Boquet 2024, 4.2 and
Table 1].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from aoabench.errors import BadValue, Unfit, check_number
from aoabench.estimators.parameters import clip_param, height_param, horizon_param
from aoabench.estimators.places import anchors_used
from aoabench.estimators.plane import clipped, in_plane, on_plane, plane_of, ray_covariances
from aoabench.estimators.rays import Rays, angular_variance, rays
from aoabench.maths.geometry import Array
from aoabench.params import param
from aoabench.roles import NEEDS, Estimator, Noise, Scenario
from aoabench.streams import Streams
from aoabench.types import Batch, Estimates

DIFFERENT = "a list of different anchor numbers >= 1, or null for all anchors"


class Points(NamedTuple):
    """Points where the rays of single anchors meet the plane z = height m.

    xy (R, T, B, 2) m, NaN where the anchor did not measure; covariance (R, T, B, 2, 2) m^2 from the
    stated deviations, None if there are none; the rays, and the anchors' positions
    (R|1, T|1, B, 3) m.
    """

    xy: Array
    covariance: Array | None
    rays: Rays
    anchors: Array
    height: float


@dataclass(frozen=True)
class _OnPlane(Estimator):
    """Intersections of the rays of single anchors with the plane of the known height."""

    height_m: float | None = height_param()
    horizon_deg: float = horizon_param()
    clip: bool = clip_param()
    tile = 8
    by_replication = True
    uses = frozenset({"elevation", "stated_sigma"})

    @property
    def needs(self) -> frozenset[str]:
        return frozenset({"elevation"} | ({"height"} if self.height_m is None else set()))

    def check(self, scenario: Scenario, noise: Noise) -> None:
        """Raise Unfit as all estimators do, and UserError if an anchor lies in the plane."""
        super().check(scenario, noise)
        plane_of(self.height_m, scenario)

    def each(self, batch: Batch, scenario: Scenario) -> Points:
        """The points that each anchor alone gives."""
        height, r = plane_of(self.height_m, scenario), rays(batch)
        r = r.of(r.line)
        ahead = np.where(r.line[..., None], r.ahead, np.nan)
        met = on_plane(ahead, batch.anchors, height, np.deg2rad(self.horizon_deg))
        variance = angular_variance(batch, r)
        spread = None
        if variance is not None:
            spread = ray_covariances(met, batch.anchors, height, variance)
        return Points(clipped(met, scenario, self.clip), spread, r, batch.anchors.position, height)


@dataclass(frozen=True)
class SingleAnchor(_OnPlane):
    """The position from one given anchor alone."""

    anchor: int = param(1, "number of the anchor, counted from 1", least=1)

    def check(self, scenario: Scenario, noise: Noise) -> None:
        super().check(scenario, noise)
        check_number(
            "anchor",
            self.anchor,
            least=1,
            most=scenario.true_anchors.count,
            integer=True,
        )
        tracks = scenario.tracks
        if tracks is not None:
            heard = np.unique(tracks.columns[np.isfinite(tracks.measured.azimuth).any(axis=0)])
            if self.anchor - 1 not in heard:
                numbers = ", ".join(str(j + 1) for j in heard)
                raise BadValue("anchor", self.anchor, f"an anchor that measured: {numbers}")

    def __call__(self, batch: Batch, scenario: Scenario, streams: Streams) -> Estimates:
        return _selected(self.each(batch, scenario), batch.numbers == self.anchor - 1)


@dataclass(frozen=True)
class BestAnchor(_OnPlane):
    """The position nearest to the truth among those of single anchors, for each fix.

    Its error is that of a perfect choice of the anchor.
    """

    @property
    def needs(self) -> frozenset[str]:
        return super().needs | {"truth"}

    def __call__(
        self, batch: Batch, scenario: Scenario, streams: Streams, truth: Array | None = None
    ) -> Estimates:
        """Positions (R, T, 3) m, given the true states `truth` (R, T, n)."""
        assert truth is not None
        found = self.each(batch, scenario)
        away = found.xy - truth[:, :, None, :2]
        return _selected(found, -np.hypot(*np.moveaxis(away, -1, 0)))


@dataclass(frozen=True)
class RssiAnchor(_OnPlane):
    """The position from the anchor that received the strongest signal."""

    uses = _OnPlane.uses | {"rssi"}

    @property
    def needs(self) -> frozenset[str]:
        return super().needs | {"rssi"}

    def __call__(self, batch: Batch, scenario: Scenario, streams: Streams) -> Estimates:
        if batch.rssi is None:
            raise Unfit(*NEEDS["rssi"])
        return _selected(self.each(batch, scenario), batch.rssi)


def _selected(found: Points, merit: np.ndarray) -> Estimates:
    """Estimates from the points with the largest merit (R|1, T|1, B).

    An anchor without a position, or with a merit of NaN or False, is not chosen.
    """
    xy = found.xy
    given = merit if merit.dtype == bool else np.isfinite(merit)
    merit = np.where(given & np.isfinite(xy[..., 0]), merit, -np.inf)
    best = merit.argmax(axis=-1)[..., None, None]
    known: np.ndarray = np.asarray(np.isfinite(merit).any(axis=-1))
    chosen = np.where(known[..., None], np.take_along_axis(xy, best, axis=2)[:, :, 0], np.nan)
    P = found.covariance
    if P is not None:
        P = np.take_along_axis(P, best[..., None], axis=2)[:, :, 0]
    one = (np.arange(xy.shape[2]) == best[..., 0]) & known[..., None]
    return in_plane(chosen, P, None, found.rays.of(one), found.anchors, found.height)


@dataclass(frozen=True)
class AnchorMean(_OnPlane):
    """The mean of the positions from all anchors that measured, or from some of them.

    Each position is moved into the bounds first, because the intersection of the plane with a ray
    near the horizon has an infinite variance. The score is the root mean square distance in m of
    the positions from their mean. The covariance follows from the stated deviations, or else from
    the positions' spread about their mean (NaN for one anchor).
    """

    anchors: Sequence[int] | None = param(
        None, "numbers of the anchors, counted from 1; null: all", least=1, allowed=DIFFERENT
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        given = self.anchors
        if given is not None and (not given or len(set(given)) < len(given)):
            raise BadValue("anchors", given, DIFFERENT)

    def check(self, scenario: Scenario, noise: Noise) -> None:
        super().check(scenario, noise)
        for number in self.anchors or ():
            check_number("anchors", number, most=scenario.true_anchors.count)

    def __call__(self, batch: Batch, scenario: Scenario, streams: Streams) -> Estimates:
        found = self.each(batch, scenario)
        xy = found.xy
        known = np.isfinite(xy[..., 0])
        if self.anchors is not None:
            known &= np.isin(batch.numbers, np.array(self.anchors) - 1)
        n = known.sum(axis=-1)
        with np.errstate(invalid="ignore", divide="ignore"):
            mean = np.where(known[..., None], xy, 0.0).sum(axis=2) / n[..., None]
            apart = np.where(known[..., None], xy - mean[:, :, None], 0.0)
            score = np.where(n > 1, np.sqrt((apart**2).sum(axis=(2, 3)) / n), np.nan)
            if found.covariance is None:
                P = np.swapaxes(apart, -1, -2) @ apart / (n * (n - 1))[..., None, None]
                P = np.where((n > 1)[..., None, None], P, np.nan)
            else:
                P = np.where(known[..., None, None], found.covariance, 0.0).sum(axis=2)
                P = P / (n**2)[..., None, None]
        used = found.rays.of(known)
        estimates = in_plane(mean, P, score, used, found.anchors, found.height)
        return replace(estimates, anchors_used=anchors_used(batch, used.used))
