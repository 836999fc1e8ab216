"""The data that everything shares: anchors, batches, estimates.

Axes: R replications, T steps (or points), B anchors, n state dimensions, m = B x d measurement
components. SI units and radians unless a name says otherwise. NaN means "not measured".
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from aoabench.maths.geometry import Array


class Outcome(IntEnum):
    """What became of one fix; a replication's outcome is the worst (largest) of its fixes."""

    OK = 0
    REJECTED = 1  # the method declined to give a position
    OSCILLATED = 2  # an iteration ran into its limit; a position is given
    DIVERGED = 3  # an iteration or a filter left every bound; a position is given
    FAILED = 4  # no position: NaN


@dataclass(frozen=True)
class Anchors:
    """Anchors as an estimator knows them: position (R|1, B, 3) m, rotation (R|1, B, 3, 3) global ->
    anchor frame.

    position_sigma (R|1, B, 3) m: stated deviations of the positions; None where they are exact.
    """

    position: Array
    rotation: Array
    position_sigma: Array | None = None

    def of(self, i: int) -> Anchors:
        """The anchors (1, B, ...) of the i-th replication."""

        def one(a: Array) -> Array:
            return a if len(a) == 1 else a[i : i + 1]

        sigma = None if self.position_sigma is None else one(self.position_sigma)
        return Anchors(one(self.position), one(self.rotation), sigma)


@dataclass(frozen=True)
class Measurements:
    """What a noise model makes of one replication; every array (T, B) or None, NaN = not measured.

    azimuth in (-pi, pi] and elevation rad in the anchor's frame, delay s, rssi dBm; the sigmas are
    the qualities that the device itself would state (rad, s).
    """

    azimuth: Array
    elevation: Array
    delay: Array | None = None
    rssi: Array | None = None
    azimuth_sigma: Array | None = None
    elevation_sigma: Array | None = None
    delay_sigma: Array | None = None


@dataclass(frozen=True)
class Batch:
    """What an estimator gets: the measurements of a tile of replications, each array (R, T, B) or
    None.

    prior_mean (R, n) and prior_cov (n, n) describe the state before the first step (None for
    snapshot scenarios); truth is not in here.
    """

    azimuth: Array
    elevation: Array
    anchors: Anchors
    delay: Array | None = None
    rssi: Array | None = None
    azimuth_sigma: Array | None = None
    elevation_sigma: Array | None = None
    delay_sigma: Array | None = None
    prior_mean: Array | None = None
    prior_cov: Array | None = None


@dataclass(frozen=True)
class Estimates:
    """position (R, T, 3) m, covariance (R, T, 3, 3) m^2 | None, iterations (R, T) | None, outcome
    (R, T) of Outcome.

    z is NaN where a method works in the plane alone. score (R, T): how badly the measurements of a
    fix agree, the larger the worse, in a unit of the method's own, NaN = cannot tell; anchors_used
    (R, T): how many it rests on.
    """

    position: Array
    covariance: Array | None
    iterations: Array | None
    outcome: np.ndarray
    score: Array | None = None
    anchors_used: Array | None = None
