"""What a file of walls contains, in the file's own coordinates, before it becomes walls in m."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from aoabench.maths.geometry import Array

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254, "ft": 0.3048}  # in m
DOORS = frozenset(("door", "doors", "doorway", "opening", "openings", "entrance", "gate"))


@dataclass(frozen=True)
class Door:
    """An opening in walls: a point (1, 2) with a width in m or None, a line (K, 2), or the ring
    (K, 2) of an area if `area`.
    """

    points: Array
    area: bool = False
    width_m: float | None = None


@dataclass(frozen=True)
class Drawing:
    """Walls as lines (K, 2); doors; the rings of each visited area, the outer one first; the unit
    and the reference system that the file states, or None; the unit that holds where none is
    declared, None for m; how often each kind of content is ignored; and remarks to print.
    """

    lines: Sequence[Array]
    doors: Sequence[Door] = ()
    visited: Sequence[Sequence[Array]] = ()
    unit: str | None = None
    crs: str | None = None
    default_unit: str | None = None
    ignored: Counter[str] = field(default_factory=Counter)
    notes: tuple[str, ...] = ()

    @cached_property
    def segments(self) -> Array:
        """The lines' segments (W, 2, 2), without those of length 0."""
        if not self.lines:
            return np.empty((0, 2, 2))
        points = np.concatenate(self.lines)
        found = np.stack([points[:-1], points[1:]], axis=1)
        inner = np.ones(len(found), dtype=bool)
        inner[np.cumsum([len(line) for line in self.lines])[:-1] - 1] = False
        return np.asarray(found[inner & (found[:, 0] != found[:, 1]).any(axis=-1)])

    def mapped(self, change: Callable[[Array], Array]) -> Drawing:
        """The drawing with all points (K, 2) changed to points (K, 2)."""
        visited = [ring for rings in self.visited for ring in rings]
        parts = [*self.lines, *(door.points for door in self.doors), *visited]
        ends = np.cumsum([len(part) for part in parts])
        new = iter(np.split(change(np.concatenate(parts)), ends[:-1])) if parts else iter(())
        return replace(
            self,
            lines=[next(new) for _ in self.lines],
            doors=[replace(door, points=next(new)) for door in self.doors],
            visited=[[next(new) for _ in rings] for rings in self.visited],
        )

    @property
    def others(self) -> str:
        """What the file contains besides walls and doors, counted; an empty text for nothing."""
        return ", ".join(f"{n} {kind}" for kind, n in sorted(self.ignored.items())[:10])
