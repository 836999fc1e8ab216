"""Rays and the plane of a known height [Boquet 2024, 2.2.1]; shared by the methods in the plane."""

from __future__ import annotations

import numpy as np

from aoabench.errors import BadValue
from aoabench.maths.geometry import Array, to_unit
from aoabench.roles import Scenario
from aoabench.types import Anchors, Batch, Estimates, Outcome


def directions(batch: Batch) -> Array:
    """Measured directions (R, T, B, 3), unit vectors in the global frame; NaN where an angle is not
    measured.
    """
    u = to_unit(batch.azimuth, batch.elevation)
    return (u[..., None, :] @ batch.anchors.rotation)[..., 0, :]


def on_plane(u: Array, anchors: Anchors, height: float, horizon: float) -> Array:
    """Points (R, T, B, 2) m where rays along unit vectors u (R, T, B, 3) from the anchors meet the
    plane z = height.

    A ray less than `horizon` rad from the horizon on the plane's side, or on the other side, is
    turned towards the plane to that angle. A vertical ray meets the plane at the anchor's x and y.
    """
    s = anchors.position
    h = height - s[..., 2]
    flat = np.hypot(u[..., 0], u[..., 1])
    towards = np.maximum(u[..., 2] * np.sign(h), flat * np.tan(horizon))
    with np.errstate(invalid="ignore", divide="ignore"):
        reach = np.where(flat > 0, np.abs(h) / towards, 0.0)
    return s[..., :2] + np.where(np.isfinite(flat), reach, np.nan)[..., None] * u[..., :2]


def plane_of(height_m: float | None, scenario: Scenario) -> float:
    """Return `height_m`, or else the scenario's known height, in m.

    Raises BadValue if neither is given, and if an anchor lies at this height.
    """
    height = scenario.known_height_m if height_m is None else height_m
    if height is None:
        raise BadValue(
            "height_m",
            None,
            "a number of m, because the scenario states no known height of its target",
        )
    level = np.abs(scenario.true_anchors.position[..., 2] - height) < 1e-9
    if level.any():
        raise BadValue(
            "height_m",
            height,
            f"a height other than that of anchor {np.flatnonzero(level.any((0, 1)))[0] + 1}",
        )
    return float(height)


def clipped(xy: Array, scenario: Scenario, clip: bool) -> Array:
    """Points (..., 2) m moved into the scenario's bounds if `clip` and the scenario has bounds."""
    bounds = scenario.bounds_m
    return xy if bounds is None or not clip else np.clip(xy, *np.asarray(bounds))


def in_plane(xy: Array, score: Array | None, used: Array) -> Estimates:
    """Estimates from positions (R, T, 2) m: z is NaN, and the outcome FAILED for a NaN position."""
    position = np.concatenate([xy, np.full((*xy.shape[:2], 1), np.nan)], axis=-1)
    outcome = np.where(np.isfinite(xy).all(-1), Outcome.OK, Outcome.FAILED).astype(np.int8)
    return Estimates(position, None, None, outcome, score, used)
