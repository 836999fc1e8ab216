"""The types that everything shares: anchors, batches, estimates, the protocols, and checks of
parameters.

Axes: R replications, T steps (or points), B anchors, n state dimensions, m = B x d measurement
components. SI units and radians unless a name says otherwise. NaN means "not measured".
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Protocol

import numpy as np

from aoabench.geometry import Array
from aoabench.streams import Streams


class Outcome(IntEnum):
    """What became of one fix; a replication's outcome is the worst (largest) of its fixes."""

    OK = 0
    REJECTED = 1  # the method declined to give a position
    OSCILLATED = 2  # an iteration ran into its limit; a position is given
    DIVERGED = 3  # an iteration or a filter left every bound; a position is given
    FAILED = 4  # no position: NaN


class UserError(Exception):
    """A mistake that only the user can mend: one clear line, exit status 2."""


class RunError(Exception):
    """What stopped a run and no check of its input could foresee: one clear line, exit status 1."""


class BadValue(UserError, ValueError):
    """A parameter out of range: `key`, the `value` given and what is `allowed`."""

    def __init__(self, key: str, value: object, allowed: str) -> None:
        self.key, self.value, self.allowed = key, value, allowed
        super().__init__(f"{key}={value!r} is not allowed; allowed: {allowed}")

    def __reduce__(self) -> tuple[type, tuple[str, object, str]]:  # so that a worker can raise it
        return type(self), (self.key, self.value, self.allowed)


def check_number(
    key: str,
    value: object,
    *,
    above: float = -math.inf,
    least: float = -math.inf,
    most: float = math.inf,
    integer: bool = False,
    optional: bool = False,
) -> None:
    """Raise BadValue unless `value` is a finite number in (above, most] and [least, most] (or None
    if optional).
    """
    kind = "an integer" if integer else "a number"
    bounds = (
        [f"> {above:g}"] if above > -math.inf else [f">= {least:g}"] if least > -math.inf else []
    )
    bounds += [f"<= {most:g}"] if most < math.inf else []
    allowed = " ".join([kind, " and ".join(bounds)]).strip() + (", or null" if optional else "")
    if value is None and optional:
        return
    good = isinstance(
        value, (int, np.integer) if integer else (int, float, np.integer, np.floating)
    )
    if (
        not good
        or isinstance(value, bool)
        or (isinstance(value, float) and not math.isfinite(value))
    ):
        raise BadValue(key, value, allowed)
    if not (above < value and least <= value <= most):  # type: ignore[operator]
        raise BadValue(key, value, allowed)


def check_choice(key: str, value: object, choices: Sequence[str]) -> None:
    """Raise BadValue unless `value` is one of `choices`."""
    if value not in choices:
        raise BadValue(key, value, "one of " + ", ".join(choices))


def check_array(key: str, value: object, shape: tuple[int | None, ...]) -> Array:
    """`value` as a finite float array of `shape` (None: any length >= 1); else raise BadValue."""
    wanted = " x ".join("N" if s is None else str(s) for s in shape) + " finite numbers"
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError):
        raise BadValue(key, value, wanted) from None
    fits = array.ndim == len(shape) and all(
        a == s if s else a > 0 for a, s in zip(array.shape, shape)
    )
    if not fits or not np.all(np.isfinite(array)):
        raise BadValue(key, value, wanted)
    return array


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


class Motion(Protocol):
    """A linear motion model x_k = F x_{k-1} + w, w ~ N(0, Q)."""

    def matrices(self, dt: float) -> tuple[Array, Array]:
        """F (n, n) and Q (n, n) for a step of dt s."""
        ...


class Scenario(Protocol):
    """Where things are and how the target moves. `name` keys the random streams; state[:3] is the
    position in m.

    Optional: `same_truth` (all replications share their true positions), `files` (paths that it
    read: results are keyed on their content), `reported(points (T, 3)) -> (T, B)` (which anchors
    measure), `height_m` (the target's known z), `bounds_m` ((2, 2): lower and upper corner in x and
    y, outside of which no target can be), `days_of (T,)` (which day each step is of), `recorded` (a
    Measurements that takes the place of the noise's), `replications` (how many there are, for what
    cannot be drawn again), `notes` (lines for whoever runs it).
    """

    @property
    def name(self) -> str: ...
    @property
    def dt(self) -> float: ...
    @property
    def motion(self) -> Motion | None: ...
    @property
    def known_anchors(self) -> Anchors: ...

    def truth(self, rng: np.random.Generator) -> Array:
        """The true states (T, n) of one replication."""
        ...

    def prior(self, rng: np.random.Generator, truth: Array) -> tuple[Array, Array] | None:
        """Mean (n,) and covariance (n, n) that filters start from; None for snapshot scenarios."""
        ...


class Noise(Protocol):
    """How true geometry becomes measurements.

    An optional method `known_anchors(rng, scenario) -> Anchors` (1, B, ...) says how an estimator
    knows the anchors in one replication; without it they are the scenario's `known_anchors`.
    """

    def sample(self, rng: np.random.Generator, scenario: Any, truth: Array) -> Measurements:
        """Measurements of one replication from its true states (T, n)."""
        ...


class Measurement(Protocol):
    """What a filter believes of the measurements; written for one point, broadcasting over leading
    axes.

    x (R, ..., n); m = B d components in anchor order. `quality` (R, m) are the nominal variances of
    one step. A class whose likelihood and derivatives are one of the compiled kernels' names it in
    its own attribute `kernel`.
    """

    def observe(self, batch: Batch) -> tuple[Array, Array]:
        """Measured values (R, T, m), NaN = not measured, and their nominal variances (R, T, m)."""
        ...

    def predict(self, x: Array, anchors: Anchors) -> Array:
        """Expected values (R, ..., m)."""
        ...

    def residual(self, y: Array, expected: Array) -> Array:
        """y - expected (..., m); angles wrapped into (-pi, pi]."""
        ...

    def jacobian(self, x: Array, anchors: Anchors) -> Array:
        """Derivative (R, ..., m, n) of `predict`."""
        ...

    def covariance(self, x: Array, anchors: Anchors, quality: Array) -> Array:
        """Variances (R, ..., m) of the components, which are uncorrelated."""
        ...

    def loglik(self, x: Array, anchors: Anchors, y: Array, quality: Array) -> Array:
        """Log likelihood (R, ...) of one step's y (R, m); components that are NaN are left out."""
        ...


class Estimator(Protocol):
    """The one plug that recursive filters and snapshot estimators share.

    An optional class attribute `tile` says how many replications it wants at once (always exactly
    that many). An optional method `prepare(say)` is called once before others work in parallel, to
    compile something, say. An optional `check(scenario)` raises BadValue or UserError where the two
    do not fit. One whose `sees_truth` is true is defined by the truth, no method for a device: it
    is called with the true states (R, T, n) as a fourth argument. An optional method `trace(batch,
    scenario, streams) -> {name: (R, T)}` gives what a replay shows beyond the estimates.
    """

    def __call__(self, batch: Batch, scenario: Any, streams: Streams) -> Estimates: ...
