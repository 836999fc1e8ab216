"""Whether anchors, walls and target share one place and one unit, judged by boxes around them.

Boxes are seen from above, with sides along x and y. A thing is taken to be in another unit if its
box, converted to m, overlaps that of the others and is at most SAME_SIZE times longer or shorter.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from aoabench.errors import BadValue
from aoabench.maths.geometry import Array

SAME_SIZE = 4.0
APART = 0.25  # walls further from the rest, in spans of the larger one, belong to another place
FAR_M, FAR_SPANS = 1000.0, 20.0  # anchors further from the target than both do not belong to it
GUESSED = ("m", "cm", "mm")  # units that walls in another one are taken to be in
DEGREES = 1e-2  # anchors that span less than this, and not 0, may be longitudes and latitudes


class Box(NamedTuple):
    """Lower and upper corner (2,) m."""

    low: Array
    high: Array

    @staticmethod
    def around(*points: Array) -> Box:
        """The box around arrays (..., 2+) m of points."""
        flat = np.concatenate([p[..., :2].reshape(-1, 2) for p in points])
        return Box(flat.min(axis=0), flat.max(axis=0))

    @property
    def span(self) -> float:
        """The longer side in m."""
        return float((self.high - self.low).max())

    def gap(self, other: Box) -> float:
        """The distance in m between two boxes, 0 if they meet."""
        apart = np.maximum(np.maximum(self.low - other.high, other.low - self.high), 0)
        return float(np.hypot(*apart))

    def scaled(self, factor: float) -> Box:
        """The box of the points times `factor` > 0."""
        return Box(self.low * factor, self.high * factor)

    def fits(self, other: Box) -> bool:
        """Whether two boxes meet and are of similar size, neither of them shorter than 1 m."""
        least = min(self.span, other.span)
        return (
            least >= 1 and max(self.span, other.span) <= SAME_SIZE * least and not self.gap(other)
        )

    def __str__(self) -> str:
        (x0, y0), (x1, y1) = self
        return f"x {x0:.7g} to {x1:.7g}, y {y0:.7g} to {y1:.7g}"


class Thing(NamedTuple):
    """A set of points (..., 2+) m in a scenario: what messages call it, its key and its value."""

    words: str
    key: str
    value: object
    points: Array


def check_walls(
    walls: Thing,
    anchors: Thing,
    target: Thing,
    units: Mapping[str, float],
    unit: str | None,
    sights: bool,
) -> None:
    """Raise BadValue for walls in another unit or in another place than anchors and target.

    `units` are the known units in m, `unit` that of the walls, None for m by default. `sights`:
    whether all lines of sight lie within the box of anchors and target. If m is declared, units are
    taken as given.
    """
    box, rest = Box.around(walls.points), Box.around(anchors.points, target.points)
    names = " and ".join(dict.fromkeys((anchors.words, target.words)))
    spans = f"walls span {box.span:.6g} m, {names} {rest.span:.6g} m"
    others = [] if unit == "m" else [one for one in GUESSED if one != (unit or "m")]
    for other in others:
        factor = units[other] / units[unit or "m"]
        if box.scaled(factor).fits(rest):
            if unit is not None:
                raise BadValue("walls_unit", unit, f"perhaps {other}; {spans}")
            allowed = f"walls of the size of {names}; {spans}: scenario.walls_unit={other}? (or m)"
            raise BadValue(walls.key, walls.value, allowed)
        nodes, way = Box.around(anchors.points), Box.around(target.points)
        if unit is None and all(one.scaled(factor).fits(way) for one in (box, nodes)):
            allowed = (
                f"walls of the size of {target.words}; walls span {box.span:.6g} m, "
                f"{anchors.words} {nodes.span:.6g} m, {target.words} {way.span:.6g} m: "
                f"walls and {anchors.words} in {other}? (scenario.walls_unit=m if in m)"
            )
            raise BadValue(walls.key, walls.value, allowed)
    if sights and box.gap(rest) > APART * max(box.span, rest.span):
        allowed = (
            f"walls in the coordinates of {names}; walls lie within {box} m, "
            f"{names} within {rest} m"
        )
        raise BadValue(walls.key, walls.value, allowed)


def check_anchors(anchors: Thing, target: Thing, walls: Thing | None = None) -> None:
    """Raise BadValue for anchors that are far from the target, or in another unit."""
    near = [target] if walls is None else [target, walls]
    for thing, others in ((anchors, near), (target, [anchors, *near[1:]])):
        box, rest = (Box.around(*(o.points for o in some)) for some in ([thing], others))
        if box.scaled(1e-3).fits(rest):
            names = " and ".join(o.words for o in others)
            allowed = (
                f"coordinates in m; {thing.words}: {box.span:.6g} m across, "
                f"{names}: {rest.span:.6g} m; {thing.words} in mm?"
            )
            raise BadValue(thing.key, thing.value, allowed)
    box, way = Box.around(anchors.points), Box.around(target.points)
    both = f"{anchors.words} lie within {box} m, {target.words} within {way} m"
    if box.gap(way) > max(FAR_M, FAR_SPANS * box.span, FAR_SPANS * way.span):
        allowed = f"{anchors.words} and {target.words} in the same coordinates; {both}"
        raise BadValue(anchors.key, anchors.value, allowed)
    if 0 < box.span < DEGREES and way.span > 1000 * box.span and box.gap(way) > 0:
        hint = "perhaps these are degrees: call the columns lat_deg and lon_deg"
        allowed = f"coordinates in m, {hint}; {both}"
        raise BadValue(anchors.key, anchors.value, allowed)
