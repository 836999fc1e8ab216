"""Data types of all modules: anchors, measurements, batches, estimates.

Axes: R replications, T steps (or points), B anchors, n state dimensions, m = B x d measurement
components. SI units and radians unless a name says otherwise. NaN means "not measured".
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from enum import IntEnum

import numpy as np

from aoabench.maths.geometry import Array
from aoabench.maths.shown import shown


class Outcome(IntEnum):
    """Outcome of one fix; a replication's outcome is the worst (largest) of its fixes."""

    OK = 0
    REJECTED = 1  # the method declined to give a position
    OSCILLATED = 2  # an iteration ran into its limit; a position is given
    DIVERGED = 3  # an iteration or a filter left every bound; a position is given
    FAILED = 4  # no position: NaN


class Reason(IntEnum):
    """Why the outcome of a fix is not OK; SENTENCES has a sentence for each."""

    NONE = 0
    NO_MEASUREMENT = 1
    TOO_FEW_ANCHORS = 2
    ONE_PLACE = 3
    UNDETERMINED = 4
    BEHIND = 5
    TOO_FAR = 6
    NO_CONVERGENCE = 7
    NO_DESCENT = 8
    NO_AGREEMENT = 9
    INNOVATIONS = 10
    COVARIANCE = 11
    NO_LIKELIHOOD = 12
    NOT_A_NUMBER = 13
    EXCEPTION = 14
    NOT_STATED = 15


SENTENCES = {
    Reason.NONE: "",
    Reason.NO_MEASUREMENT: "no anchor measured anything that the method uses",
    Reason.TOO_FEW_ANCHORS: "fewer anchors measured than the method needs",
    Reason.ONE_PLACE: "all anchors that measured stand in one place",
    Reason.UNDETERMINED: "the measurements do not determine a position",
    Reason.BEHIND: "the position lies behind an anchor that it uses",
    Reason.TOO_FAR: "the position left its bounds around the anchors",
    Reason.NO_CONVERGENCE: "the iteration reached its limit of steps",
    Reason.NO_DESCENT: "the iteration met a singular or indefinite normal matrix",
    Reason.NO_AGREEMENT: "fewer than two anchors agree",
    Reason.INNOVATIONS: "normalised innovations exceeded their bound for several steps",
    Reason.COVARIANCE: "the covariance is zero or not positive definite",
    Reason.NO_LIKELIHOOD: "the likelihood is zero at every particle",
    Reason.NOT_A_NUMBER: "the estimator returned NaN",
    Reason.EXCEPTION: "the estimator raised an exception",
    Reason.NOT_STATED: "the estimator states no reason",
}


@dataclass(frozen=True)
class Anchors:
    """Positions and orientations of B anchors, the same or different in each replication and step.

    position (R|1, T|1, B, 3) m; rotation (R|1, T|1, B, 3, 3) from the global to the anchor's frame;
    position_sigma (R|1, T|1, B, 3) m, the stated deviations of the positions, None where they are
    exact. Arrays without a step axis, (R|1, B, ...), or without both axes, (B, ...), get axes of
    length 1. Raises ValueError for other shapes.
    """

    position: Array
    rotation: Array
    position_sigma: Array | None = None

    def __post_init__(self) -> None:
        for name, inner in (("position", (3,)), ("rotation", (3, 3)), ("position_sigma", (3,))):
            value = getattr(self, name)
            if value is None:
                continue
            array = np.asarray(value, dtype=float)
            missing = 3 + len(inner) - array.ndim
            if missing not in (0, 1, 2) or array.shape[-len(inner) :] != inner:
                wanted = ", ".join(("R|1", "T|1", "B", *map(str, inner)))
                raise ValueError(
                    f"Anchors.{name} must have the shape ({wanted}), not {array.shape}"
                )
            full = array[:, None] if missing == 1 else array[None, None] if missing else array
            object.__setattr__(self, name, full)

    @property
    def count(self) -> int:
        """The number of anchors B."""
        return self.position.shape[2]

    @property
    def moving(self) -> bool:
        """Whether a field has more than one step (T > 1)."""
        return any(array.shape[1] > 1 for array in self.arrays.values())

    @property
    def arrays(self) -> dict[str, Array]:
        """The fields that are not None."""
        named = {f.name: getattr(self, f.name) for f in fields(self)}
        return {name: array for name, array in named.items() if array is not None}

    @property
    def frames(self) -> tuple[Array, Array]:
        """Positions (R|1, B, 3) m and rotations (R|1, B, 3, 3) at one step; ValueError for more."""
        if self.position.shape[1] > 1 or self.rotation.shape[1] > 1:
            raise ValueError("Anchors.frames needs the anchors of one step; use Anchors.at(k)")
        return self.position[:, 0], self.rotation[:, 0]

    def of(self, i: int) -> Anchors:
        """The anchors (1, T|1, B, ...) of the replication at index `i` of the first axis."""
        return Anchors(**{n: a if len(a) == 1 else a[i : i + 1] for n, a in self.arrays.items()})

    def at(self, steps: int | np.ndarray) -> Anchors:
        """The anchors (R|1, 1, B, ...) at one step, or (R|1, K|1, B, ...) at K steps."""
        if not self.moving:
            return self
        index = np.atleast_1d(steps)
        arrays = self.arrays.items()
        return Anchors(**{name: a if a.shape[1] == 1 else a[:, index] for name, a in arrays})

    def those(self, index: np.ndarray) -> Anchors:
        """The anchors (R|1, T|1, K, ...) at the indices (K,) of the anchor axis, in that order."""
        return Anchors(**{name: a[:, :, index] for name, a in self.arrays.items()})

    def __repr__(self) -> str:
        return shown(self)


@dataclass(frozen=True)
class Measurements:
    """Measurements of one replication, every array (T, B) or None, or of a tile of replications,
    every array (R, T, B) or None; NaN = not measured.

    azimuth in (-pi, pi] and elevation in rad in the anchor's frame, delay in s, rssi in dBm; the
    sigmas are the standard deviations that the device itself states, in rad and s. With anchor_id
    (R|1, T, K), the last axis of a tile's arrays holds the anchors heard at each step only, at most
    K: their numbers in the scenario from 0, ascending, and -1 for an empty place, where every array
    is NaN. None: all anchors.
    """

    azimuth: Array
    elevation: Array
    delay: Array | None = None
    rssi: Array | None = None
    azimuth_sigma: Array | None = None
    elevation_sigma: Array | None = None
    delay_sigma: Array | None = None
    anchor_id: np.ndarray | None = None

    @property
    def arrays(self) -> dict[str, Array]:
        """The measured arrays that are not None."""
        named = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "anchor_id"}
        return {name: array for name, array in named.items() if array is not None}

    @classmethod
    def stacked(cls, each: Sequence[Measurements]) -> Measurements:
        """The measurements (R, T, B) of a tile from those (T, B) of its replications."""
        return cls(**{n: np.stack([one.arrays[n] for one in each]) for n in each[0].arrays})

    def offers(self) -> frozenset[str]:
        """Names of the needs of estimators (roles.NEEDS) that are measured."""
        found = {"elevation"} if np.isfinite(self.elevation).any() else set()
        found |= {name for name in ("delay", "rssi") if getattr(self, name) is not None}
        return frozenset(found | ({"stated_sigma"} if self.azimuth_sigma is not None else set()))

    def __repr__(self) -> str:
        return shown(self)


@dataclass(frozen=True)
class Tracks:
    """Recorded tracks: each has the fixes of one tag in the order of time.

    The arrays hold the F fixes of all tracks, one track after the other. tags (R,): the name of
    each track's tag, "" in a log without tags; several tracks may have the same tag. counts (R,):
    the number of each track's fixes. time (F,) s, NaN = unknown; fix (F,): their names as recorded;
    truth (F, 3) m, NaN = unknown; measured: arrays (F, B); packets (F,): the packets in each fix.
    columns (B,): the number of each column's anchor; several columns may have the same. poses:
    those (1, F|1, B, ...) of the columns' anchors in each fix, None where anchors stand still.
    """

    tags: tuple[str, ...]
    counts: np.ndarray
    time: Array
    fix: np.ndarray
    truth: Array
    measured: Measurements
    packets: np.ndarray
    columns: np.ndarray
    poses: Anchors | None = None

    @property
    def starts(self) -> np.ndarray:
        """The index (R + 1,) of each track's first fix, and F."""
        return np.concatenate([[0], np.cumsum(self.counts)])


@dataclass(frozen=True)
class Calibration:
    """Known deviations of an angular noise.

    sigma: the nominal one in rad; fitted: returns those (azimuth, elevation) in rad that fit best
    over uniform directions; printed_fit_deg: those that a paper prints for sigma = 10 deg.
    """

    sigma: float
    fitted: Callable[[], tuple[float, float]]
    printed_fit_deg: tuple[float, float] | None = None


@dataclass(frozen=True)
class Batch:
    """Input of an estimator: measurements of a tile of replications, each array (R, T, B) or None.

    anchors: the anchors as known to the estimator, in the order of the last axis; anchor_id
    (R|1, T|1, B): their numbers in the scenario, from 0, -1 for an empty place, None for 0, 1, ...
    B-1. A batch of the anchors heard has the places of `Measurements.anchor_id` and anchors
    (R|1, T, K, ...); an empty place measures nothing and holds finite anchors. `known` are all
    anchors of the scenario as known to the estimator, None if `anchors` are. time (R|1, T) s; None
    for steps of the scenario's dt. prior_mean (R, n) and prior_cov (n, n) describe the state before
    the first step (None for snapshot scenarios). A batch does not contain the truth.
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
    time: Array | None = None
    anchor_id: np.ndarray | None = None
    known: Anchors | None = None

    def of(self, i: int) -> Batch:
        """Return the batch (1, ...) of the replication at index `i` of the first axis."""
        each = self.arrays.items()
        one = {n: a if a is None or len(a) == 1 else a[i : i + 1] for n, a in each}
        known = None if self.known is None else self.known.of(i)
        return replace(self, anchors=self.anchors.of(i), known=known, **one)  # type: ignore[arg-type]

    @property
    def arrays(self) -> dict[str, np.ndarray | None]:
        """The fields whose first axis is the replication."""
        others = ("anchors", "known", "prior_cov")
        return {f.name: getattr(self, f.name) for f in fields(self) if f.name not in others}

    @property
    def layout(self) -> Anchors:
        """All anchors (R|1, T|1, B, ...) as known to the estimator, heard or not."""
        return self.anchors if self.known is None else self.known

    @property
    def numbers(self) -> np.ndarray:
        """The anchors' numbers (R|1, T|1, B) in the scenario, from 0; -1 where a place is empty."""
        in_order = np.arange(self.azimuth.shape[2])[None, None]
        return in_order if self.anchor_id is None else self.anchor_id

    def __repr__(self) -> str:
        return shown(self)


@dataclass(frozen=True)
class Estimates:
    """Output of an estimator for a tile of replications.

    position (R, T, 3) m, with z NaN for a method in the plane; covariance (R, T, 3, 3) m^2 or None;
    iterations (R, T) or None; outcome (R, T) of Outcome. score (R, T): disagreement of the
    measurements of a fix in the method's own unit, larger is worse, NaN = unknown; anchors_used
    (R, T): number of anchors that the fix uses. reason (R, T) of Reason: why a fix is not OK; None
    is NOT_STATED wherever the outcome is not OK.
    """

    position: Array
    covariance: Array | None
    iterations: Array | None
    outcome: np.ndarray
    score: Array | None = None
    anchors_used: Array | None = None
    reason: np.ndarray | None = None

    def __repr__(self) -> str:
        return shown(self, {"outcome": Outcome, "reason": Reason})
