"""Lines of sight between points and anchors, seen from above.

A wall that meets the straight line from a point to an anchor hides the anchor; touching is meeting.
An anchor stands on a wall if it is less than ON_WALL times the longer side of all walls' box away
from it. Such a wall does not hide the anchor. Instead, the walls that the anchor stands on divide
the directions around it into sectors, and it sees into the sector that it faces:

    on a wall            the half-plane that it faces
    in a corner          the room or the outside, whichever it faces
    at a wall's end      all directions but that of the wall

An anchor that faces along such a wall (within ALONG) has two sectors beside it. It sees into the
narrower one; if they are equally wide, into both, but only ahead of it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from aoabench.maths.geometry import Array

ON_WALL = 1e-4
ALONG = math.radians(0.1)
_AT_ONCE = 1 << 16  # number of sight lines in memory at a time
_TURN = 2 * math.pi


def in_sight(
    points: Array,
    anchors: Array,
    segments: Array | None,
    facing: Array | None = None,
    asked: np.ndarray | None = None,
) -> np.ndarray:
    """Mask (N, B) of the anchors (B, 2+) m in line of sight of each point (N, 2+) m, among those
    `asked` (N, B) for; None: all.

    No wall (W, 2, 2) m meets the line from point to anchor. `facing` (B,) rad are the directions
    that the anchors face, counter-clockwise from +x; without it, an anchor on a wall is hidden.
    """
    clear = np.ones((len(points), len(anchors)), dtype=bool) if asked is None else asked.copy()
    if segments is None or not clear.size:
        return clear
    own = np.zeros((len(anchors), len(segments)), dtype=bool)
    if facing is not None:
        own = on_walls(anchors, segments)
    for point, anchor in _hidden(points, anchors, segments, own, clear):
        clear[point, anchor] = False
    if facing is not None:
        for j in np.flatnonzero(own.any(axis=1)):
            ends = wall_directions(anchors[j, :2], segments[own[j]], _reach(segments))
            clear[:, j] &= _in_sector(points[:, :2] - anchors[j, :2], float(facing[j]), ends)
    return clear


def on_walls(anchors: Array, segments: Array) -> np.ndarray:
    """Mask (B, W) of the walls (W, 2, 2) m that each anchor (B, 2+) m stands on."""
    start, way = segments[:, 0], segments[:, 1] - segments[:, 0]
    d = anchors[:, None, :2] - start
    along = np.clip((d * way).sum(axis=-1) / (way**2).sum(axis=-1), 0, 1)
    off = d - along[..., None] * way
    return np.asarray(np.hypot(off[..., 0], off[..., 1]) < _reach(segments))


def wall_directions(anchor: Array, walls: Array, reach: float) -> Array:
    """Directions (K,) rad in which walls (W, 2, 2) m lead away from an anchor (2,) m on them: one
    for a wall that ends less than `reach` m from the anchor, else two.
    """
    found = [
        math.atan2(*(other - end)[::-1])
        for wall in walls
        for end, other in (wall, wall[::-1])
        if math.hypot(*(other - anchor)) >= reach
    ]
    return np.array(found)


def faces_along(anchors: Array, segments: Array, facing: Array) -> list[int]:
    """Indices of the anchors on a wall that see both sides of it, because they face along it."""
    own, reach = on_walls(anchors, segments), _reach(segments)
    found = []
    for j in np.flatnonzero(own.any(axis=1)):
        ends = wall_directions(anchors[j, :2], segments[own[j]], reach)
        left, right, along = _sector(float(facing[j]), ends)
        if along and left == right:
            found.append(int(j))
    return found


def _reach(segments: Array) -> float:
    """The distance in m up to which an anchor stands on a wall."""
    corners = segments.reshape(-1, 2)
    return ON_WALL * float((corners.max(axis=0) - corners.min(axis=0)).max())


def _sector(facing: float, directions: Array) -> tuple[float, float, bool]:
    """Widths in rad to the left and to the right of `facing`, up to the next wall, and whether the
    anchor faces along a wall that parts the two; widths that then differ by rounding are equal.
    """
    turn = (directions - facing) % _TURN
    along = np.minimum(turn, _TURN - turn) < ALONG
    others = turn[~along]
    if not len(others):
        return _TURN, _TURN, False
    left, right = float(others.min()), float(_TURN - others.max())
    if along.any() and abs(left - right) < 2 * ALONG:
        left = right = max(left, right)
    return left, right, bool(along.any())


def _in_sector(d: Array, facing: float, directions: Array) -> np.ndarray:
    """Mask (N,) of the ways d (N, 2) m that lead into the sector that an anchor faces."""
    left, right, along = _sector(facing, directions)
    turn = np.arctan2(d[:, 1], d[:, 0]) - facing
    turn = turn - _TURN * np.rint(turn / _TURN)
    here = (d == 0).all(axis=1)
    if not along:
        inside = ((turn >= 0) & (turn < left)) | ((turn < 0) & (turn > -right))
        inside |= (turn + _TURN < left) | (_TURN - turn < right)
    elif left == right:
        inside = np.abs(turn) < min(left, math.pi / 2)
    elif left < right:
        inside = (turn > 0) & (turn < left)
    else:
        inside = (turn < 0) & (turn > -right)
    return np.asarray(inside | here)


def _hidden(
    points: Array, anchors: Array, segments: Array, own: np.ndarray, asked: np.ndarray
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield indices of points and anchors, of those `asked` (N, B) for, that a wall hides from each
    other; a wall of `own` (B, W) hides its anchor from no point.
    """
    import shapely

    order = np.argsort(-np.hypot(*(segments[:, 1] - segments[:, 0]).T), kind="stable")
    groups = np.split(
        order, [len(order) // 8]
    )  # the longest walls first: they block most lines, which halves the work
    trees = [shapely.STRtree(shapely.linestrings(segments[group])) for group in groups]
    points_asked, anchors_asked = np.nonzero(asked)
    for first in range(0, len(points_asked), _AT_ONCE):
        some = slice(first, first + _AT_ONCE)
        point, anchor = points_asked[some], anchors_asked[some]
        lines = shapely.linestrings(np.stack([points[point, :2], anchors[anchor, :2]], axis=1))
        left = np.arange(len(lines))
        for group, tree in zip(groups, trees):
            way, wall = tree.query(lines[left], predicate="intersects")
            if own.any():
                way = way[~own[anchor[left[way]], group[wall]]]
            hidden = np.zeros(len(left), dtype=bool)
            hidden[way] = True
            yield point[left[hidden]], anchor[left[hidden]]
            left = left[~hidden]
