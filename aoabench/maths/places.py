"""Places of the anchors heard at each step: arrays over all B anchors and over the K heard ones.

`numbers` (..., T, K) are the anchors' numbers, ascending, -1 for an empty place.
"""

from __future__ import annotations

import numpy as np

from aoabench.maths.geometry import Array


def numbers_of(heard: np.ndarray) -> np.ndarray:
    """Numbers (..., T, K) of the anchors in a mask (..., T, B); K >= 1 is the most at a step. If
    that is B, each anchor has the place of its number.
    """
    K, B = max(int(heard.sum(axis=-1).max(initial=0)), 1), heard.shape[-1]
    if K == B:
        return np.where(heard, np.arange(B), -1)
    first = np.argsort(~heard, axis=-1, kind="stable")[..., :K]
    return np.where(np.take_along_axis(heard, first, axis=-1), first, -1)


def at_places(array: Array, numbers: np.ndarray, empty: Array | float) -> Array:
    """Values (R|1, T, K, ...) at numbers (R|1, T, K) from those (R|1, T|1, B, ...) of all anchors;
    `empty` (...) in empty places.
    """
    given = np.maximum(numbers, 0)
    if len(numbers) == 1 and array.shape[1] == 1:
        found = np.take(array[:, 0], given[0], axis=1)
    else:
        replication = np.arange(len(array))[:, None, None]
        step = np.arange(array.shape[1])[:, None]
        found = array[replication, step, given]
    free = np.asarray(numbers < 0)
    if free.any():
        found[np.broadcast_to(free, found.shape[:3])] = empty
    return found


def at_anchors(values: Array, numbers: np.ndarray, count: int) -> Array:
    """Values (R, T, count) of all anchors, NaN if not heard, from those (R, T, K) at numbers
    (R|1, T, K).
    """
    found = np.full((*values.shape[:2], count), np.nan)
    if len(numbers) == 1:
        step, place = np.nonzero(numbers[0] >= 0)
        found[:, step, numbers[0, step, place]] = values[:, step, place]
    else:
        each, step, place = np.nonzero(numbers >= 0)
        found[each, step, numbers[each, step, place]] = values[each, step, place]
    return found
