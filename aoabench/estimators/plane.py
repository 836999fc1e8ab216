"""Rays and the plane of a known height [Boquet 2024, 2.2.1]; shared by the methods in the plane."""

from __future__ import annotations

import numpy as np

from aoabench.errors import BadValue
from aoabench.estimators.rays import Rays, behind, judged, measured_reason
from aoabench.maths.geometry import Array
from aoabench.roles import Scenario
from aoabench.types import Anchors, Estimates


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


def ray_covariances(xy: Array, anchors: Anchors, height: float, variance: Array) -> Array:
    """Covariances (R, T, B, 2, 2) m^2 of points xy (R, T, B, 2) m, where rays with isotropic
    angular variances (R, T, B) rad^2 meet the plane: var r^2 (I + c c^T / u_z^2), with the unit
    vector (c, u_z) of the ray and the distance r from the anchor.
    """
    s = anchors.position
    d, h = xy - s[..., :2], height - s[..., 2]
    r2 = (d**2).sum(axis=-1) + h**2
    slope = d / h[..., None]
    across = np.eye(2) + slope[..., :, None] * slope[..., None, :]
    return (variance * r2)[..., None, None] * across


def in_plane(
    xy: Array, covariance: Array | None, score: Array | None, r: Rays, s: Array, height: float
) -> Estimates:
    """Estimates in the plane z = height from positions (R, T, 2) m, NaN for none, their covariances
    (R, T, 2, 2) m^2, the rays that they use and the anchors s (R|1, T|1, B, 3) m; z is NaN.
    """
    nothing = np.full((*xy.shape[:2], 1), np.nan)
    solved: np.ndarray = np.asarray(np.isfinite(xy).all(-1))
    level = np.concatenate([xy, np.full_like(nothing, height)], axis=-1)
    back = behind(r.ahead, s, level)
    outcome, reason = judged(solved, back, measured_reason(r.used, 1))
    P = None
    if covariance is not None:
        P = np.full((*xy.shape[:2], 3, 3), np.nan)
        P[..., :2, :2] = covariance
    position = np.concatenate([xy, nothing], axis=-1)
    used = r.used.sum(axis=-1).astype(float)
    return Estimates(position, P, None, outcome, score, used, reason)
