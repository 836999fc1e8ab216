"""Times of steps."""

from __future__ import annotations

import numpy as np

from aoabench.maths.geometry import Array


def elapsed(time: Array, start: float | None = 0.0) -> Array:
    """Time (R, T) s between each step and the last one before it, for times (R, T) s.

    It is 0 at a step whose time is NaN; such a step counts as part of the one before it. `start` is
    the time before the first step; None: the first step's own. Raises ValueError if a time is less
    than one before it.
    """
    first = np.full((len(time), 1), np.nan if start is None else start)
    latest = np.fmax.accumulate(np.concatenate([first, time], axis=1), axis=1)[:, :-1]
    with np.errstate(invalid="ignore"):
        between = time - latest
    if (between < 0).any():
        r, k = np.argwhere(between < 0)[0]
        raise ValueError(
            f"the times of a track must not decrease: {time[r, k]} s after {latest[r, k]} s"
        )
    return np.where(np.isnan(between), 0.0, between)
