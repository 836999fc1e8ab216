"""A route through waypoints whose corners are rounded to arcs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from aoabench.errors import BadValue, check_array
from aoabench.maths.geometry import Array, wrap

BACK = 1e-3  # rad; a turn by less than this from half a turn is a turn on the spot


@dataclass(frozen=True)
class RoundedRoute:
    """Pieces of constant curvature, P straight lines and arcs in turn.

    start (P, 2) m and heading (P,) rad (counter-clockwise from +x) at the start of each piece;
    curvature (P,) 1/m, > 0 to the left; begin (P,) m along the route; length m of the whole route.
    """

    start: Array
    heading: Array
    curvature: Array
    begin: Array
    length: float

    @classmethod
    def through(
        cls, route: Sequence[Sequence[float]] | Array, radius_m: float, smaller: bool = False
    ) -> RoundedRoute:
        """The route through waypoints (K, 2) m with corners of this radius, or, with `smaller`, of
        the largest one up to it for which a corner cuts off at most half of each of its legs.

        Where it turns straight back, the target turns on the spot. Raises BadValue for fewer than
        two waypoints, for equal ones in a row and, without `smaller`, for too tight a corner.
        """
        points = check_array("route", route, (None, 2))
        if len(points) < 2:
            raise BadValue("route", route, "two or more waypoints [x, y] in m")
        legs = np.diff(points, axis=0)
        lengths = np.hypot(*legs.T)
        for i in np.flatnonzero(lengths < 1e-9):
            raise BadValue(
                f"route[{i + 1}]", points[i + 1].tolist(), "a waypoint other than the one before"
            )
        heading = np.arctan2(legs[:, 1], legs[:, 0])
        turn = wrap(np.diff(heading))
        turn[np.abs(turn) > np.pi - BACK] = 0.0  # on the spot: no arc
        cut = np.tan(np.abs(turn) / 2)  # of each leg of a corner, per m of radius
        share = np.ones(len(turn))  # of the radius
        if smaller:
            half = np.minimum(lengths[:-1], lengths[1:]) / 2
            share = np.minimum(1, half / np.maximum(radius_m * cut, 1e-12))
        cut = np.concatenate([[0.0], cut * share, [0.0]])
        if not smaller:
            _check_radius(radius_m, cut[:-1] + cut[1:], lengths)
        ahead = legs / lengths[:, None]
        line = lengths - radius_m * (cut[:-1] + cut[1:])
        # line, arc, line, ..., line; the last arc has length 0
        from_corner, to_corner = (radius_m * c[:, None] * ahead for c in (cut[:-1], cut[1:]))
        start = np.stack([points[:-1] + from_corner, points[1:] - to_corner], 1)
        turns, radii = np.append(turn, 0.0), radius_m * np.append(share, 1.0)
        pieces = np.stack([np.maximum(line, 0), radii * np.abs(turns)], axis=1).ravel()
        return cls(
            start=start.reshape(-1, 2),
            heading=np.repeat(heading, 2),
            curvature=np.stack([np.zeros_like(turns), np.sign(turns) / radii], axis=1).ravel(),
            begin=np.concatenate([[0.0], np.cumsum(pieces)[:-1]]),
            length=float(pieces.sum()),
        )

    @property
    def waypoints(self) -> Array:
        """The lengths (K,) m along the route at which the waypoints are passed, at the middles of
        their arcs.
        """
        ends = np.append(self.begin[2::2], self.length)
        return np.concatenate([[0.0], (self.begin[1::2] + ends)[:-1] / 2, [self.length]])

    def at(self, arc_m: Array) -> tuple[Array, Array, Array]:
        """Positions (N, 2) m, directions (N, 2) and curvatures (N,) 1/m at lengths (N,) m from the
        start.
        """
        piece = np.searchsorted(self.begin, arc_m, side="right") - 1
        s, k, h = arc_m - self.begin[piece], self.curvature[piece], self.heading[piece]
        chord, middle = s * np.sinc(k * s / (2 * np.pi)), h + k * s / 2
        position = self.start[piece] + chord[:, None] * np.stack(
            [np.cos(middle), np.sin(middle)], axis=-1
        )
        return position, np.stack([np.cos(h + k * s), np.sin(h + k * s)], axis=-1), k


def states(
    path: RoundedRoute, arc_m: Array, speed_m_s: float, height_m: Sequence[float] | Array
) -> Array:
    """Position m, velocity m/s and acceleration m/s^2 (T, 9) at lengths (T,) m along a path that is
    followed at a constant horizontal speed. The heights are those at the start and at the end, or
    at the waypoints (K,), linear between.
    """
    position, ahead, curvature = path.at(arc_m)
    left = np.stack([-ahead[:, 1], ahead[:, 0]], axis=-1)
    marks = np.array([0.0, path.length]) if len(height_m) == 2 else path.waypoints
    heights = np.asarray(height_m, dtype=float)
    leg = np.clip(np.searchsorted(marks, arc_m, side="right") - 1, 0, len(marks) - 2)
    climb = (np.diff(heights) / np.diff(marks))[leg]
    found = np.zeros((len(arc_m), 9))
    found[:, :2], found[:, 2] = position, heights[leg] + climb * (arc_m - marks[leg])
    found[:, 3:5], found[:, 5] = speed_m_s * ahead, speed_m_s * climb
    found[:, 6:8] = speed_m_s**2 * curvature[:, None] * left
    return found


def _check_radius(radius_m: float, cut: Array, lengths: Array) -> None:
    """Raise BadValue if the corners of a leg cut off more than its length; `cut` is the length cut
    off each leg per m of radius.
    """
    if not np.any(radius_m * cut > lengths + 1e-9):
        return
    most = lengths / np.maximum(cut, 1e-12)
    least = int(np.argmin(most))
    way = f"the way from waypoint {least} to {least + 1} is {lengths[least]:.4g} m long"
    allowed = f"a number <= {np.floor(most[least] * 1e4) / 1e4:g}; {way}"
    raise BadValue("corner_radius_m", radius_m, allowed)
