"""Geometry of the links between the target and the anchors that hear it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from aoabench.maths.geometry import Array, in_frames, to_azel
from aoabench.maths.places import at_places, numbers_of
from aoabench.roles import Scenario


@dataclass(frozen=True)
class Links:
    """The links at T points of the target, each array (R|1, T, K).

    numbers: of the anchors that hear the target, -1 for none; distance m; azimuth and elevation rad
    in the anchor's frame.
    """

    numbers: np.ndarray
    distance: Array
    azimuth: Array
    elevation: Array

    def normals(self, rngs: Sequence[np.random.Generator], first: int) -> Array:
        """Normal numbers (3, N, T, K) of N replications, from the `first` on, of the tile; 0 where
        there is no link.
        """
        e = np.zeros((len(rngs), 3, *self.numbers.shape[1:]))
        for i, rng in enumerate(rngs):
            there = self.numbers[first + i if len(self.numbers) > 1 else 0] >= 0
            if there.all():
                rng.standard_normal(out=e[i])
            else:
                e[i][:, there] = rng.standard_normal((3, int(there.sum())))
        return np.swapaxes(e, 0, 1)


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
    """The links at points (R|1, T, 3) m; the last ones are kept, as all replications of a route
    have the same.
    """
    return _links(_Place(scenario, points.copy()))


@lru_cache(maxsize=1)
def _links(at: _Place) -> Links:
    anchors, each = at.scenario.true_anchors, [at.scenario.hears(p) for p in at.points]
    masks = [mask for mask in each if mask is not None]
    every = np.ones((*at.points.shape[:2], anchors.count), dtype=bool)
    numbers = numbers_of(np.stack(masks) if masks else every)
    places = (at_places(a, numbers, 0.0) for a in (anchors.position, anchors.rotation))
    x, y, z = in_frames(at.points, *places)
    return Links(numbers, np.sqrt(x * x + y * y + z * z), *to_azel(x, y, z))
