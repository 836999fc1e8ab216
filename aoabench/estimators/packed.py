"""Arrays of a tile as kernels take them: padded, without NaN arithmetic, replication after
replication.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

import numpy as np

from aoabench.estimators.rays import is_deviation
from aoabench.maths.geometry import Array
from aoabench.roles import Scenario
from aoabench.types import Batch


def padded(a: Array, lanes: int, by: Literal["constant", "edge"] = "constant") -> Array:
    """The array with its last axis padded to a multiple of `lanes`, by zeros or by repeating the
    last element.
    """
    missing = -a.shape[-1] % lanes
    return np.ascontiguousarray(
        np.pad(a, [(0, 0)] * (a.ndim - 1) + [(0, missing)], by) if missing else a
    )


def padded_anchors(position: Array, rotation: Array, lanes: int) -> tuple[Array, Array]:
    """Positions (R|1, T|1, 3, B) and rotations (R|1, T|1, 3, 3, B), the last anchor repeated: an
    anchor of zeros would have angles of NaN.
    """
    s = padded(np.swapaxes(position, 2, 3), lanes, "edge")
    return s, padded(np.moveaxis(rotation, 2, -1), lanes, "edge")


def measured_rays(batch: Batch, lanes: int) -> tuple[int, tuple[Array, ...]]:
    """How many of the two angles have stated deviations (0, 1 or 2; 1: the azimuth), and azimuths,
    elevations, NaN where not measured, and their variances, padded (R, T, B).
    """
    angles, variances, missing = [], [], -batch.azimuth.shape[-1] % lanes
    for y, sigma in (
        (batch.azimuth, batch.azimuth_sigma),
        (batch.elevation, batch.elevation_sigma),
    ):
        y = np.where(np.isfinite(y) & is_deviation(sigma), y, np.nan)
        y = np.pad(y, ((0, 0), (0, 0), (0, missing)), constant_values=np.nan) if missing else y
        y = np.ascontiguousarray(y)
        angles.append(y)
        variances.append(y if sigma is None else padded(np.square(sigma), lanes))
    stated = 0 if batch.azimuth_sigma is None else 1 if batch.elevation_sigma is None else 2
    return stated, (*angles, *variances)


def corners(scenario: Scenario, clip: bool = True) -> Array:
    """The scenario's bounds (2, 2) m, infinite without bounds and without `clip`."""
    bounds = scenario.bounds_m if clip else None
    return np.array([[-np.inf] * 2, [np.inf] * 2] if bounds is None else bounds, dtype=float)


def calls(
    measured: tuple[Array, ...], anchors: tuple[Array, Array], into: tuple[np.ndarray, ...]
) -> Iterator[tuple[np.ndarray, ...]]:
    """Arguments (N, ...) of a kernel's calls: for all fixes at once where the anchors are the same,
    else for each replication. measured, into: arrays (R, T, ...); anchors (R|1, T|1, ...).
    """
    if all(a.shape[:2] == (1, 1) for a in anchors):
        measured, into = (
            tuple(a.reshape(1, -1, *a.shape[2:]) for a in group) for group in (measured, into)
        )
    for i in range(len(into[0])):
        yield (
            *(a[i] for a in measured),
            *(a[min(i, len(a) - 1)] for a in anchors),
            *(a[i] for a in into),
        )
