"""Roles that plug-ins play: scenario, noise, motion model, measurement model, estimator, filter.

Each role is a plain base class. What a plug-in may leave out is an attribute or a method with a
default here, so that a type checker sees it. The base classes are no dataclasses: the fields of a
plug-in are its own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from aoabench.errors import BadValue, Unfit
from aoabench.maths.geometry import Array
from aoabench.params import CheckedParams
from aoabench.streams import Streams
from aoabench.types import Anchors, Batch, Estimates, Measurements

# what an estimator may need: the group that offers it, and in words
NEEDS = {
    "motion": ("scenario", "one with a motion model"),
    "prior": ("scenario", "one with a prior"),
    "height": ("scenario", "one whose target has a known height, or a height_m of the estimator"),
    "several_anchors": ("scenario", "one with two or more anchors"),
    "truth": ("scenario", "one whose true positions are known"),
    "elevation": ("noise", "one that measures elevations"),
    "delay": ("noise", "one that measures times of arrival, such as ofdm_crlb"),
    "rssi": ("noise", "one that measures signal strengths, such as ble_multipath"),
    "stated_sigma": ("noise", "one whose measurements state their deviations"),
}


class Motion(CheckedParams):
    """A linear motion model x_k = F x_{k-1} + w, w ~ N(0, Q)."""

    def matrices(self, dt: float) -> tuple[Array, Array]:
        """F (n, n) and Q (n, n) for a step of dt s."""
        raise NotImplementedError


class Scenario(CheckedParams):
    """Where the anchors are and how the target moves.

    name: keys the random streams. dt: s from step to step. motion: what filters believe of the
    target's way, None where fixes stand alone. shares_positions: all replications have the same
    true positions. replications: how many there are, None for any number.
    """

    name: str
    dt: float = 1.0
    motion: Motion | None = None
    shares_positions: bool = False
    replications: int | None = None

    @property
    def true_anchors(self) -> Anchors:
        """The anchors as they are."""
        raise NotImplementedError

    @property
    def recorded(self) -> Measurements | None:
        """Measurements (T, B) that take the place of the noise's."""
        return None

    @property
    def files(self) -> tuple[Path, ...]:
        """The files that the scenario was read from; results are keyed on their content."""
        return ()

    @property
    def notes(self) -> tuple[str, ...]:
        """Lines for whoever runs the scenario."""
        return ()

    @property
    def bounds_m(self) -> ArrayLike | None:
        """Lower and upper corner (2, 2) m, in x and y, of where the target can be."""
        return None

    @property
    def known_height_m(self) -> float | None:
        """The one height z in m that the target is known to have."""
        return None

    @property
    def wall_segments(self) -> Array | None:
        """Walls (W, 2, 2) m seen from above."""
        return None

    def truth(self, rng: np.random.Generator) -> Array:
        """The true states (T, n) of one replication; the first three are the position in m."""
        raise NotImplementedError

    def prior(self, rng: np.random.Generator, truth: Array) -> tuple[Array, Array] | None:
        """Mean (n,) and covariance (n, n) that filters start from; None where fixes stand alone."""
        return None

    def hears(self, points: Array) -> np.ndarray | None:
        """Which anchors measure a target at points (T, 3) m, (T, B); None: all of them."""
        return None

    def day_of(self, steps: int) -> np.ndarray:
        """The number (T,) of the day that each step belongs to, from 0."""
        return np.zeros(steps, dtype=int)

    def times(self, steps: int) -> Array:
        """The time (T,) s of each step."""
        return self.dt * np.arange(1.0, steps + 1)

    def offers(self) -> frozenset[str]:
        """What the scenario has of the things that estimators may need (see NEEDS)."""
        found = {"motion", "prior"} if self.motion is not None else set()
        found |= {"height"} if self.known_height_m is not None else set()
        found |= {"several_anchors"} if self.true_anchors.count > 1 else set()
        if self.recorded is None:
            return frozenset(found | {"truth"})
        known = bool(np.isfinite(self.truth(np.random.default_rng(0))[:, :2]).any())
        return frozenset(found | ({"truth"} if known else set()) | self.recorded.offers())


@dataclass(frozen=True)
class Calibration:
    """What is known of an angular noise: `sigma` rad, its nominal deviation; `fitted` returns the
    deviations (azimuth, elevation) rad that fit it best over uniform directions; `printed_fit_deg`
    are those that a paper prints for sigma = 10 deg.
    """

    sigma: float
    fitted: Callable[[], tuple[float, float]]
    printed_fit_deg: tuple[float, float] | None = None


class Noise(CheckedParams):
    """How true geometry becomes measurements."""

    @property
    def files(self) -> tuple[Path, ...]:
        """The files that the noise was read from; results are keyed on their content."""
        return ()

    @property
    def calibration(self) -> Calibration | None:
        """What azimuth-elevation filters may know of the noise."""
        return None

    def sample(self, rng: np.random.Generator, scenario: Scenario, truth: Array) -> Measurements:
        """Measurements of one replication from its true states (T, n)."""
        raise NotImplementedError

    def known_anchors(self, rng: np.random.Generator, scenario: Scenario) -> Anchors:
        """The anchors (1, T|1, B, ...) as estimators know them in one replication."""
        return scenario.true_anchors

    def information(self, point: Array, anchors: Anchors) -> Array | None:
        """Fisher information (..., 3, 3) 1/m^2 of one set of measurements at points (..., 3) m."""
        return None

    def offers(self) -> frozenset[str] | None:
        """What it measures of the things that estimators may need (see NEEDS); None: not stated."""
        return None


class Measurement(CheckedParams):
    """What a filter believes of the measurements; written for one point, broadcasting over leading
    axes.

    x (R, ..., n); m = B d components in anchor order; anchors are those of one step. `quality`
    (R, m) are the nominal variances of one step. `kernel` names the compiled likelihood and
    derivatives that equal the methods of the class itself; a subclass does not inherit it.
    """

    kernel: str | None = None

    @property
    def needs(self) -> frozenset[str]:
        """What it needs of scenario and noise (see NEEDS)."""
        return frozenset()

    def observe(self, batch: Batch) -> tuple[Array, Array]:
        """Measured values (R, T, m), NaN = not measured, and their nominal variances (R, T, m)."""
        raise NotImplementedError

    def predict(self, x: Array, anchors: Anchors) -> Array:
        """Expected values (R, ..., m)."""
        raise NotImplementedError

    def residual(self, y: Array, expected: Array) -> Array:
        """y - expected (..., m); angles wrapped into (-pi, pi]."""
        raise NotImplementedError

    def jacobian(self, x: Array, anchors: Anchors) -> Array:
        """Derivative (R, ..., m, n) of `predict`."""
        raise NotImplementedError

    def covariance(self, x: Array, anchors: Anchors, quality: Array) -> Array:
        """Variances (R, ..., m) of the components, which are uncorrelated."""
        raise NotImplementedError

    def loglik(self, x: Array, anchors: Anchors, y: Array, quality: Array) -> Array:
        """Log likelihood (R, ...) of one step's y (R, m); components that are NaN are left out."""
        raise NotImplementedError

    def variances(self) -> Array:
        """Variances (181, 2) rad^2 of azimuth and elevation at -90, -89 ... 90 degrees, for a model
        whose variances depend on the elevation.
        """
        return np.ones((181, 2))


class Estimator(CheckedParams):
    """Positions from measurements: the one plug that recursive filters and snapshot estimators
    share.

    tile: how many replications it takes at once, always exactly that many; None: the largest power
    of two up to 128 for which an array (R, T, B) has at most 2^20 elements. An estimator that needs
    `truth` is defined by the truth and no method for a device: it is called with the true states
    (R, T, n) as a fourth argument.
    """

    tile: int | None = None

    @property
    def needs(self) -> frozenset[str]:
        """What it needs of scenario and noise (see NEEDS)."""
        return frozenset()

    def __call__(self, batch: Batch, scenario: Scenario, streams: Streams) -> Estimates:
        """Positions (R, T, 3) m, and what became of each fix."""
        raise NotImplementedError

    @property
    def label(self) -> str:
        """What messages call it."""
        return type(self).__name__

    def check(self, scenario: Scenario, noise: Noise) -> None:
        """Raise Unfit where scenario and noise do not offer what it needs."""
        offered = noise.offers()
        if offered is None:  # a noise that does not say what it measures
            offered = frozenset(need for need, (group, _) in NEEDS.items() if group == "noise")
        for need in sorted(self.needs - scenario.offers() - offered):
            raise Unfit(*NEEDS[need])

    def prepare(self, say: Callable[[str], None]) -> None:
        """Compile or load what is needed, once, before others work in parallel."""

    def trace(self, batch: Batch, scenario: Scenario, streams: Streams) -> dict[str, Array]:
        """Columns (R, T) that a replay shows beyond the estimates."""
        return {}


@dataclass(frozen=True)
class PlainEstimator(Estimator):
    """A bare callable (batch, scenario, streams) -> Estimates in the role of an estimator."""

    function: Callable[..., Estimates]
    needs = frozenset()
    label = "estimator"

    def __call__(
        self, batch: Batch, scenario: Scenario, streams: Streams, *truth: Array
    ) -> Estimates:
        return self.function(batch, scenario, streams, *truth)


class Filter(Estimator):
    """A recursive estimator: believes a measurement model and the scenario's motion and prior."""

    measurement: Measurement

    @property
    def needs(self) -> frozenset[str]:
        return frozenset({"motion", "prior"}) | self.measurement.needs


class Belief(NamedTuple):
    """What a filter believes before the first step, and of each step."""

    mean: Array  # (R, n)
    covariance: Array  # (n, n)
    F: Array  # (n, n)
    Q: Array  # (n, n)


def believed(batch: Batch, scenario: Scenario) -> Belief:
    """The prior of the batch and the motion of the scenario; BadValue where one is missing."""
    if scenario.motion is None or batch.prior_mean is None or batch.prior_cov is None:
        raise BadValue("scenario", type(scenario).__name__, "one with a motion model and a prior")
    return Belief(batch.prior_mean, batch.prior_cov, *scenario.motion.matrices(scenario.dt))
