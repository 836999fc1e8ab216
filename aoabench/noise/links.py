"""Geometry of the links between the target and the anchors that hear it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from aoabench.maths.geometry import Array, in_frames, to_azel
from aoabench.maths.places import at_places, numbers_of
from aoabench.roles import Scenario


@dataclass(frozen=True)
class Links:
    """The links at T points of the target, each array (R|1, T, K).

    numbers: of the anchors that hear the target, -1 for none; where K is the number of all anchors,
    each has the place of its number. distance m; azimuth and elevation rad in the anchor's frame.
    """

    numbers: np.ndarray
    distance: Array
    azimuth: Array
    elevation: Array

    def normals(self, rngs: Sequence[np.random.Generator], first: int) -> Array:
        """Normal numbers (3, N, T, K) of N replications, from the `first` on, of the tile; 0 where
        there is no link.
        """
        shape = self.numbers.shape[1:]
        e = np.zeros((len(rngs), 3, shape[0] * shape[1]))
        for i, rng in enumerate(rngs):
            there = self._there[first + i if len(self.numbers) > 1 else 0]
            if len(there) == e.shape[2]:
                rng.standard_normal(out=e[i])
            else:  # row by row: five times as fast as all rows at once
                for row, values in zip(e[i], rng.standard_normal((3, len(there)))):
                    row[there] = values
        return np.swapaxes(e.reshape(len(rngs), 3, *shape), 0, 1)

    @cached_property
    def _there(self) -> list[np.ndarray]:
        """The places of the links among the T K ones, by replication (R|1)."""
        return [np.flatnonzero(numbers >= 0) for numbers in self.numbers]


@dataclass(frozen=True, eq=False)
class _Place:
    """Points (R|1, T, 3) m in a scenario; equal to the same points in the same object."""

    scenario: Scenario
    points: Array

    def __hash__(self) -> int:
        return hash((id(self.scenario), self.points.shape))

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, _Place) or other.scenario is not self.scenario:
            return False
        return np.array_equal(other.points, self.points)


def links_of(scenario: Scenario, points: Array) -> Links:
    """The links at points (R|1, T, 3) m. Those of points that all replications share are kept until
    the next ones, as a route has the same in all tiles.
    """
    if len(points) > 1:
        return _links(scenario, points)
    return _kept(_Place(scenario, points.copy()))


@lru_cache(maxsize=1)
def _kept(at: _Place) -> Links:
    return _links(at.scenario, at.points)


def _links(scenario: Scenario, points: Array) -> Links:
    anchors, each = scenario.true_anchors, [scenario.hears(p) for p in points]
    heard = [mask for mask in each if mask is not None]
    position, rotation = anchors.position, anchors.rotation
    if heard:
        numbers = numbers_of(np.stack(heard))
        position, rotation = (at_places(a, numbers, 0.0) for a in (position, rotation))
    else:
        numbers = np.tile(np.arange(anchors.count), (1, points.shape[1], 1))
    x, y, z = in_frames(points, position, rotation)
    return Links(numbers, np.sqrt(x * x + y * y + z * z), *to_azel(x, y, z))


def shared(points: Array) -> Array:
    """The points (1, T, 3) if they are the same in all replications, else the points (R, T, 3)."""
    same = points.strides[0] == 0 or all(np.array_equal(one, points[0]) for one in points[1:])
    return points[:1] if same else points
