"""Several tracks that a Kalman filter goes on with, filtered at once as one tile.

A tile has one prior covariance, but each track has its own. So the tile's is 0, and the covariance
P that a track has reached is part of the process noise of its first step: F P F^T + Q.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from aoabench.filters.divergence import Filtered
from aoabench.filters.recursion import GaussianFilter
from aoabench.maths.geometry import Array
from aoabench.roles import Motion
from aoabench.scenarios.recorded import Recorded
from aoabench.types import Batch, Tracks


@dataclass(frozen=True)
class Reached:
    """What tracks have reached: means (R, n), covariances (R, n, n), and times (R,) s."""

    mean: Array
    covariance: Array
    time: Array


class _Resumed(Motion):
    """A motion model whose first step starts from normal distributions of the covariances
    (R, n, n).
    """

    def __init__(self, motion: Motion, covariance: Array) -> None:
        self.motion, self.covariance = motion, covariance

    def matrices(self, dt: float | Array) -> tuple[Array, Array]:
        """F and Q (R, T, n, n) for steps of dt (R, T) s."""
        shape = *np.shape(dt), *self.covariance.shape[1:]
        F, Q = (np.broadcast_to(A, shape) for A in self.motion.matrices(dt))
        first, Q = F[:, 0], Q.copy()
        Q[:, 0] += first @ self.covariance @ np.swapaxes(first, -1, -2)
        return F, Q


def fits(method: GaussianFilter, tracks: Tracks, reached: Reached) -> bool:
    """Whether several tracks can be filtered at once: each anchor stands still and has one column,
    and all times are known.
    """
    columns, times = tracks.columns, (tracks.time, reached.time)
    each = len(np.unique(columns)) == len(columns) and tracks.poses is None
    known = all(np.isfinite(time).all() for time in times)
    return method.by_replication and len(reached.time) > 1 and each and known


def resumed(
    method: GaussianFilter,
    scenario: Recorded,
    tracks: Tracks,
    batch: Batch,
    some: Sequence[int],
    reached: Reached,
) -> list[Filtered]:
    """The filter's states (1, T, n) in the fixes of `some` of the tracks, from where they were.

    batch: the measurements (1, F, B) of all tracks, one after the other.
    """
    count = tracks.counts[list(some)]
    step = np.minimum(np.arange(count.max()), count[:, None] - 1)  # the last one fills up
    place, real = tracks.starts[list(some)][:, None] + step, np.arange(count.max()) < count[:, None]
    measured = {
        name: np.where(real[..., None], array[0][place], np.nan)
        for name, array in batch.arrays.items()
        if array is not None and array.ndim == 3 and name != "anchor_id"
    }
    n = reached.mean.shape[1]
    tile = Batch(
        anchors=batch.anchors,
        prior_mean=reached.mean,
        prior_cov=np.zeros((n, n)),
        time=tracks.time[place] - reached.time[:, None],
        **measured,  # type: ignore[arg-type]
    )
    assert scenario.motion is not None
    moving = scenario.with_tracks(tracks, 0.0, _Resumed(scenario.motion, reached.covariance))
    found, _ = method.recursion(tile, moving, whole=True)
    return [
        Filtered(*(None if a is None else a[i : i + 1, :T] for a in found))  # type: ignore[arg-type]
        for i, T in enumerate(count.tolist())
    ]
