"""The places in which anchors have measured, and how many of them a fix uses."""

from __future__ import annotations

import numpy as np

from aoabench.maths.geometry import Array
from aoabench.types import Batch

SAME_M = 0.5  # m; an anchor that has moved by less stands in one place


def places(batch: Batch) -> np.ndarray:
    """A number (R|1, T|1, B) that columns share if one anchor measured them in one place: that of
    the anchor, or of the first column of the place where an anchor has several columns.
    """
    numbers = batch.numbers
    position = batch.anchors.position
    if batch.known is not None or len(np.unique(numbers[0, 0])) == numbers.shape[2]:
        return numbers
    each = [position[:, :, numbers[0, 0] == b] for b in np.unique(numbers)]
    if all((one == one[:, :, :1]).all() for one in each):
        return numbers
    found = np.full(np.broadcast_shapes(numbers.shape, position.shape[:3]), -1)
    for b in range(numbers.shape[2]):
        near = ((position - position[:, :, b : b + 1]) ** 2).sum(axis=-1) <= SAME_M**2
        near &= (numbers == numbers[..., b : b + 1]) & (found < 0) & (found[..., b : b + 1] < 0)
        found[near] = b
    return found


def distinct_places(used: np.ndarray, place: np.ndarray) -> np.ndarray:
    """The number (...,) of different places among those used (..., B), by their numbers (..., B) of
    at least 0.
    """
    mine = np.sort(np.where(used, place, -1), axis=-1)
    return np.asarray((np.diff(mine, axis=-1, prepend=-1) > 0).sum(axis=-1))


def several(batch: Batch) -> bool:
    """Whether an anchor may have several columns: one for each of its packets in a fix."""
    return batch.known is None and batch.anchor_id is not None


def anchors_used(batch: Batch, used: np.ndarray) -> Array:
    """The number (R, T) of different anchors among the columns that are used (R, T, B); an anchor
    that moves counts once for each place.
    """
    if not several(batch):
        return used.sum(axis=-1).astype(float)
    return distinct_places(used, places(batch)).astype(float)
