"""Anchors and walls of a floor plan, read together and checked against each other and a route."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from aoabench.devices.anchors import AnchorsFile, read_anchors
from aoabench.devices.plans.drawing import UNITS
from aoabench.devices.plans.extent import Box, Thing, check_anchors, check_walls
from aoabench.devices.plans.plan import Frame, Plan, read_plan
from aoabench.devices.plans.sight import faces_along, in_sight, on_walls
from aoabench.errors import BadValue, listed
from aoabench.maths.geometry import Array


@dataclass(frozen=True)
class FloorPlan:
    """The content of the files: anchors, and the plan of walls or None."""

    known: AnchorsFile
    plan: Plan | None

    @classmethod
    def read(cls, files: Sequence[Path], frame: Frame | None = None) -> FloorPlan:
        """The plan in the files of anchors and, as a second one, of walls, whose coordinates
        `frame` declares.

        Without an origin in `frame`, the centroid of anchors in degrees is the origin. Raises
        BadValue, with the keys `anchors`, `walls`, `walls_crs`, `walls_unit` and `origin_deg`, for
        mistakes.
        """
        frame = frame or Frame()
        known = read_anchors("anchors", str(files[0]), frame.origin)
        if len(files) == 1:
            return cls(known, None)
        walls = read_plan("walls", files[1], frame._replace(origin=known.origin))
        if not walls.geodetic:
            known.check_local(f"{files[1].name} has local coordinates")
        return cls(known, walls)

    @property
    def walls(self) -> Array | None:
        """Walls (W, 2, 2) m, or None."""
        return None if self.plan is None else self.plan.walls

    @property
    def area_m2(self) -> float | None:
        """The visited area in m^2, or None."""
        return None if self.plan is None else self.plan.area_m2

    @property
    def position(self) -> Array:
        """Positions (B, 3) m of the anchors."""
        return self.known.anchors.position[0, 0]

    def check(self, names: Sequence[object], route: Array, wanders: bool) -> None:
        """Raise BadValue unless anchors, walls and route (K, 2) m share one place and one unit, and
        for anchors on walls in a file that does not state which side they face.

        `names` are the files of anchors and walls as the user calls them; `wanders` is whether the
        target leaves the route.
        """
        nodes = Thing("access nodes", "anchors", names[0], self.position)
        target = Thing("the route", "route", route.tolist(), route)
        if self.plan is None:
            check_anchors(nodes, target)
            return
        walls = Thing("walls", "walls", names[1], self.plan.walls)
        check_anchors(nodes, target, walls)
        check_walls(walls, nodes, target, UNITS, self.plan.unit, sights=not wanders)
        if self.known.facing is None and on_walls(self.position, self.plan.walls).any():
            allowed = (
                "a file with the column facing_deg, because access nodes stand on walls: "
                "they see into the side that they face"
            )
            raise BadValue("anchors", names[0], allowed)

    def in_sight(self, points: Array, asked: np.ndarray | None = None) -> np.ndarray:
        """Mask (N, B) of the anchors in line of sight of each point (N, 2+) m, among those `asked`
        (N, B) for, see `sight`.
        """
        return in_sight(points, self.position, self.walls, self.known.facing, asked)

    def nearest_in_sight(self, points: Array, count: int) -> np.ndarray:
        """Mask (N, B) of the `count` nearest anchors in line of sight of each point (N, 3) m; of
        equally near ones the first in the file.

        Sight is computed from the nearest anchors on, until enough are seen.
        """
        apart = sum((points[:, None, i] - self.position[:, i]) ** 2 for i in range(3))
        order = np.argsort(apart, axis=1, kind="stable")
        seen, todo = np.zeros(order.shape, dtype=bool), np.arange(len(points))
        for first in range(0, order.shape[1], 2 * count):
            asked = np.zeros((len(todo), order.shape[1]), dtype=bool)
            np.put_along_axis(asked, order[todo, first : first + 2 * count], True, axis=1)
            seen[todo] |= self.in_sight(points[todo], asked)
            todo = todo[seen[todo].sum(axis=1) < count]
        ranked = np.take_along_axis(seen, order, axis=1)
        ranked &= np.cumsum(ranked, axis=1) <= count
        chosen = np.zeros_like(seen)
        np.put_along_axis(chosen, order, ranked, axis=1)
        return chosen

    @property
    def notes(self) -> tuple[str, ...]:
        """Remarks to print."""
        if self.plan is None:
            return self.known.notes
        box, flat = Box.around(self.plan.walls), self.position[:, :2]
        outside = ((flat < box.low) | (flat > box.high)).any(axis=1)
        outside &= ~on_walls(flat, self.plan.walls).any(axis=1)
        found = [*self.known.notes, *self.plan.notes]
        if outside.any():
            line = (
                f"outside the walls, which lie within {box} m; are x_m and y_m those of the plan?"
            )
            found.append(f"access nodes {self._ids(np.flatnonzero(outside))} stand {line}")
        if self.known.facing is not None:
            both = faces_along(self.position, self.plan.walls, self.known.facing)
            line = "stand on a wall and face along it, so they see both sides"
            if both:
                found.append(f"access nodes {self._ids(both)} {line}; facing_deg decides the side")
        return tuple(found)

    def crossings(self, path: Array) -> tuple[str, ...]:
        """A remark on the walls that a path (N, 2) m goes through or touches, if any."""
        import shapely

        if self.plan is None or len(path) < 2:
            return ()
        way, walls = shapely.LineString(path), shapely.linestrings(self.plan.walls)
        through = walls[shapely.STRtree(walls).query(way, predicate="intersects")]
        if not len(through):
            return ()
        places = shapely.points(shapely.get_coordinates(shapely.intersection(through, way)))
        first = places[int(np.argmin(shapely.line_locate_point(way, places)))]
        where = f"at {len(places)} places, first near ({first.x:.4g}, {first.y:.4g})"
        line = f"the route goes through or touches walls {where}"
        return (f"{line}: walls hide access nodes, not the way",)

    def _ids(self, which: Sequence[int] | np.ndarray) -> str:
        """The ids of some anchors, at most ten of them."""
        return listed([self.known.ids[j] for j in which], most=10)
