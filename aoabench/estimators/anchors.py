"""One anchor, one position: its ray meets the plane of the node's known height [Boquet 2024,
2.2.1]; and what naive methods make of several such positions: choose one anchor, or take the mean
[Boquet 2024, 4.2 and Table 1].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from aoabench.geometry import Array, to_unit
from aoabench.streams import Streams
from aoabench.types import Anchors, BadValue, Batch, Estimates, Outcome, UserError, check_number


def directions(batch: Batch) -> Array:
    """Measured directions (R, T, B, 3), unit vectors in the global frame; NaN where an angle is not
    measured.
    """
    u = to_unit(batch.azimuth, batch.elevation)
    return (u[..., None, :] @ batch.anchors.rotation[:, None])[..., 0, :]


def on_plane(u: Array, anchors: Anchors, height: float, horizon: float) -> Array:
    """Where rays along unit vectors u (R, T, B, 3) from the anchors meet the plane z = height: (R,
    T, B, 2) m.

    A ray that would meet it further than `horizon` rad below the horizon allows, or never, is
    turned down (or up, towards the plane) to that angle; an exactly vertical one meets it at the
    anchor.
    """
    s = anchors.position[:, None]
    h = height - s[..., 2]
    flat = np.hypot(u[..., 0], u[..., 1])
    towards = np.maximum(u[..., 2] * np.sign(h), flat * np.tan(horizon))
    with np.errstate(invalid="ignore", divide="ignore"):
        reach = np.where(flat > 0, np.abs(h) / towards, 0.0)
    return s[..., :2] + np.where(np.isfinite(flat), reach, np.nan)[..., None] * u[..., :2]


def known_height(scenario: Any) -> float | None:
    """The height m at which the scenario says that its target is; None where it says none, or no
    single one.
    """
    height = getattr(scenario, "height_m", None)
    return height if isinstance(height, int | float) else None


def plane_of(height_m: float | None, scenario: Any) -> float:
    """The height m that a method was given, or else the scenario's. BadValue where none is, or an
    anchor in it.
    """
    height = known_height(scenario) if height_m is None else height_m
    if height is None:
        raise BadValue(
            "height_m",
            None,
            "a number of m: the scenario does not say at which height its target is",
        )
    level = np.abs(scenario.known_anchors.position[..., 2] - height) < 1e-9
    if level.any():
        raise BadValue(
            "height_m",
            height,
            f"a height other than that of anchor {np.flatnonzero(level.any(0))[0] + 1}",
        )
    return float(height)


def clipped(xy: Array, scenario: Any, clip: bool) -> Array:
    """Points (..., 2) m moved into the scenario's bounds, if it has any and `clip` says so."""
    bounds = getattr(scenario, "bounds_m", None)
    return xy if bounds is None or not clip else np.clip(xy, *np.asarray(bounds))


def in_plane(xy: Array, score: Array | None, used: Array) -> Estimates:
    """Estimates from positions (R, T, 2) m: `failed` where they are NaN; z is NaN."""
    position = np.concatenate([xy, np.full((*xy.shape[:2], 1), np.nan)], axis=-1)
    outcome = np.where(np.isfinite(xy).all(-1), Outcome.OK, Outcome.FAILED).astype(np.int8)
    return Estimates(position, None, None, outcome, score, used)


@dataclass(frozen=True)
class _OnPlane:
    """height_m: of the plane, null for the scenario's; horizon_deg (0, 90): rays look at least this
    far towards it; clip: positions are moved into the scenario's bounds."""

    height_m: float | None = None
    horizon_deg: float = 1.0
    clip: bool = True
    tile: ClassVar[int] = 8

    def __post_init__(self) -> None:
        check_number("height_m", self.height_m, optional=True)
        check_number("horizon_deg", self.horizon_deg, above=0, most=89)
        if not isinstance(self.clip, bool):
            raise BadValue("clip", self.clip, "true or false")

    def check(self, scenario: Any) -> None:
        """Raise BadValue where the scenario leaves the plane open."""
        plane_of(self.height_m, scenario)

    def each(self, batch: Batch, scenario: Any) -> Array:
        """The position (R, T, B, 2) m from each anchor by itself; NaN where it did not measure."""
        height = plane_of(self.height_m, scenario)
        return clipped(
            on_plane(directions(batch), batch.anchors, height, np.deg2rad(self.horizon_deg)),
            scenario,
            self.clip,
        )


@dataclass(frozen=True)
class SingleAnchor(_OnPlane):
    """The position from anchor number `anchor`, counted from 1, whatever the others say."""

    anchor: int = 1

    def __post_init__(self) -> None:
        super().__post_init__()
        check_number("anchor", self.anchor, least=1, integer=True)

    def check(self, scenario: Any) -> None:
        super().check(scenario)
        check_number(
            "anchor",
            self.anchor,
            least=1,
            most=scenario.known_anchors.position.shape[1],
            integer=True,
        )

    def __call__(self, batch: Batch, scenario: Any, streams: Streams) -> Estimates:
        xy = self.each(batch, scenario)[:, :, self.anchor - 1]
        return in_plane(xy, None, np.isfinite(xy[..., 0]).astype(float))


@dataclass(frozen=True)
class BestAnchor(_OnPlane):
    """Fix by fix the single anchor whose position is nearest to the truth: what a perfect selector
    would reach.
    """

    sees_truth: ClassVar[bool] = True

    def __call__(self, batch: Batch, scenario: Any, streams: Streams, truth: Array) -> Estimates:
        xy = self.each(batch, scenario)
        return _selected(xy, -np.hypot(*np.moveaxis(xy - truth[:, :, None, :2], -1, 0)))


@dataclass(frozen=True)
class RssiAnchor(_OnPlane):
    """The single anchor that received the strongest signal."""

    def __call__(self, batch: Batch, scenario: Any, streams: Streams) -> Estimates:
        if batch.rssi is None:
            raise UserError(
                "rssi_anchor needs signal strengths; "
                "choose a noise that makes them, e.g. noise=ble_multipath"
            )
        return _selected(self.each(batch, scenario), batch.rssi)


def _selected(xy: Array, merit: Array) -> Estimates:
    """The one of positions (R, T, B, 2) with the largest merit (R, T, B), among those that have
    both.
    """
    merit = np.where(np.isfinite(merit) & np.isfinite(xy[..., 0]), merit, -np.inf)
    best = merit.argmax(axis=-1)[..., None, None]
    found: np.ndarray = np.asarray(np.isfinite(merit).any(axis=-1))
    chosen = np.take_along_axis(xy, best, axis=2)[:, :, 0]
    return in_plane(np.where(found[..., None], chosen, np.nan), None, found.astype(float))


@dataclass(frozen=True)
class AnchorMean(_OnPlane):
    """The mean of the positions from all anchors that measured, or from those numbered in `anchors`
    (from 1).

    Each is moved into the bounds first: the variance of where a ray near the horizon meets a plane
    is infinite. The score is the root mean square distance in m of the positions from their mean.
    """

    anchors: Sequence[int] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.anchors is not None:
            if (
                not isinstance(self.anchors, Sequence)
                or not self.anchors
                or len(set(self.anchors)) < len(self.anchors)
            ):
                raise BadValue(
                    "anchors", self.anchors, "a list of different anchors' numbers, or null for all"
                )
            for number in self.anchors:
                check_number("anchors", number, least=1, integer=True)

    def check(self, scenario: Any) -> None:
        super().check(scenario)
        for number in self.anchors or ():
            check_number("anchors", number, most=scenario.known_anchors.position.shape[1])

    def __call__(self, batch: Batch, scenario: Any, streams: Streams) -> Estimates:
        xy = self.each(batch, scenario)
        if self.anchors is not None:
            xy = xy[:, :, np.array(self.anchors) - 1]
        known = np.isfinite(xy[..., 0])
        n = known.sum(axis=-1)
        with np.errstate(invalid="ignore", divide="ignore"):
            mean = np.where(known[..., None], xy, 0.0).sum(axis=2) / n[..., None]
            spread = np.where(known[..., None], xy - mean[:, :, None], 0.0)
            score = np.sqrt((spread**2).sum(axis=(2, 3)) / n)
        return in_plane(mean, np.where(n > 1, score, np.nan), n.astype(float))
