"""Openings that doors cut into walls, all in m and seen from above."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from aoabench.devices.plans.drawing import Door
from aoabench.maths.geometry import Array

REACH_M = 0.3  # a door drawn this far beside a wall opens it
WIDTH_M = 0.9  # of a point without a width
_ALONG = np.cos(np.deg2rad(20))  # a line opens the walls that run along it within 20 deg
_SEAM_M = 0.02  # an area opens the walls on its outline too
_REST_M = 1e-6  # shorter remains are no walls


def cut(walls: Array, doors: Sequence[Door]) -> tuple[Array, int]:
    """The walls (K, 2, 2) that doors leave of walls (W, 2, 2), and the number of doors that open
    none. Walls without a door stay as they are and in their order.
    """
    import shapely

    if not doors:
        return walls, 0
    lines = shapely.linestrings(walls)
    tree = shapely.STRtree(lines)
    cuts: dict[int, list[Any]] = {}
    unused = 0
    for door in doors:
        hit = False
        for shape, direction in _shapes(door, walls, tree):
            for j in sorted(tree.query(shape, predicate="intersects").tolist()):
                way = walls[j, 1] - walls[j, 0]
                if direction is None or abs(way @ direction) >= _ALONG * np.hypot(*way):
                    opened = lines[j].intersection(shape).length > _REST_M
                    hit = hit or opened
                    cuts.setdefault(j, []).extend([shape] * opened)
        unused += not hit
    rest = {j: _rest(lines[j], areas) for j, areas in cuts.items()}
    counts = np.ones(len(walls), dtype=int)
    counts[list(rest)] = [len(pieces) for pieces in rest.values()]
    left, first = np.repeat(walls, counts, axis=0), np.cumsum(counts) - counts
    for j, pieces in rest.items():
        left[first[j] : first[j] + len(pieces)] = pieces
    return left, unused


def _shapes(door: Door, walls: Array, tree: Any) -> list[tuple[Any, Array | None]]:
    """The areas that a door opens, each with the direction (2,) of the walls, None for all."""
    import shapely

    if door.area:
        area = shapely.Polygon(door.points)
        return [(area.buffer(_SEAM_M, cap_style="flat", join_style="mitre"), None)]
    ends = door.points
    if len(ends) == 1:
        near = tree.query_nearest(shapely.Point(ends[0]), max_distance=REACH_M, all_matches=False)
        if not len(near):
            return []
        way = walls[near[0], 1] - walls[near[0], 0]
        half = way / np.hypot(*way) * (door.width_m or WIDTH_M) / 2
        ends = np.stack([ends[0] - half, ends[0] + half])
    found: list[tuple[Any, Array | None]] = []
    for start, end in pairwise(ends):
        length = np.hypot(*(end - start))
        if length > 0:
            area = shapely.LineString([start, end]).buffer(REACH_M, cap_style="flat")
            found.append((area, (end - start) / length))
    return found


def _rest(wall: Any, areas: Sequence[Any]) -> Array:
    """The pieces (K, 2, 2) of a wall outside of areas."""
    import shapely

    left = shapely.difference(wall, shapely.union_all(areas))
    pieces = [p for p in shapely.get_parts(left) if p.length > _REST_M]
    return np.array([np.asarray(p.coords)[[0, -1]] for p in pieces]).reshape(-1, 2, 2)
