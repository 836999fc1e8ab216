"""Roles of plug-ins: scenario, noise, motion model, measurement model, estimator, filter.

Each role is a plain base class, in which optional attributes and methods have a default. The base
classes are not dataclasses: each plug-in declares its own fields.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from aoabench.errors import BadValue, Unfit
from aoabench.maths.geometry import Array
from aoabench.params import CheckedParams
from aoabench.streams import Streams
from aoabench.types import Anchors, Batch, Calibration, Estimates, Measurements, Tracks

# needs of estimators: the config group that offers each, and its description
NEEDS = {
    "motion": ("scenario", "one with a motion model"),
    "prior": ("scenario", "one with a prior"),
    "height": ("scenario", "one whose target has a known height, or a height_m of the estimator"),
    "several_anchors": ("scenario", "one in which two or more anchors measure at a time"),
    "truth": ("scenario", "one whose true positions are known"),
    "elevation": ("noise", "one that measures elevations"),
    "delay": ("noise", "one that measures times of arrival, such as ofdm_crlb"),
    "rssi": ("noise", "one that measures signal strengths, such as ble_multipath"),
    "stated_sigma": ("noise", "one whose measurements state their deviations"),
}


class Motion(CheckedParams):
    """A linear motion model x_k = F x_{k-1} + w, w ~ N(0, Q)."""

    def matrices(self, dt: float | Array) -> tuple[Array, Array]:
        """F and Q (..., n, n) for steps of dt (...) s; an axis has the length 1 where F or Q are
        the same for all steps.
        """
        raise NotImplementedError

    def start(self) -> Array:
        """Standard deviations (n - 3,) of the state's components after the position, whose means
        are 0, where a recorded track starts.
        """
        return np.ones(np.shape(self.matrices(1.0)[0])[-1] - 3)


class Scenario(CheckedParams):
    """Positions of the anchors and movement of the target.

    name: key of the random streams. dt: time step in s. start_s: time of the prior in s; None: that
    of a track's first step. motion: the motion model of the filters, None where each fix is
    independent. start_sigma_m: deviation in m that the prior of a recorded track has beyond that of
    its first fix. shares_positions: whether all replications have the same true positions.
    replications: number of replications, None for any number. least_heard: share of the steps with
    a measurement below which a run prints a warning.
    """

    name: str
    dt: float = 1.0
    start_s: float | None = 0.0
    motion: Motion | None = None
    start_sigma_m: float = 1.0
    shares_positions: bool = False
    replications: int | None = None
    least_heard: float = 0.1

    @property
    def true_anchors(self) -> Anchors:
        """The true anchors (1, T|1, B, ...)."""
        raise NotImplementedError

    @property
    def tracks(self) -> Tracks | None:
        """Recorded tracks, whose measurements replace those of the noise and of which each is a
        replication, or None.
        """
        return None

    @property
    def notes(self) -> tuple[str, ...]:
        """Lines to print when the scenario is run."""
        return ()

    @property
    def bounds_m(self) -> ArrayLike | None:
        """Lower and upper corner (2, 2) m, in x and y, of the target's area, or None."""
        return None

    @property
    def known_height_m(self) -> float | None:
        """The known constant height z of the target in m, or None."""
        return None

    @property
    def wall_segments(self) -> Array | None:
        """Walls (W, 2, 2) m seen from above, or None."""
        return None

    def truth(self, rng: np.random.Generator) -> Array:
        """The true states (T, n) of one replication; the first three are the position in m."""
        raise NotImplementedError

    def prior(self, rng: np.random.Generator, truth: Array) -> tuple[Array, Array] | None:
        """Mean (n,) and covariance (n, n) at a filter's start; None if fixes are independent."""
        return None

    def hears(self, points: Array) -> np.ndarray | None:
        """Mask (T, B) of the anchors that measure a target at points (T, 3) m; None for all."""
        return None

    def unheard(self) -> BadValue:
        """The error for a run in which no anchor measures anything; its key is a parameter."""
        return BadValue("name", self.name, "a scenario in which an anchor measures at some step")

    def day_of(self, steps: int) -> np.ndarray:
        """The number (T,) of the day that each step belongs to, from 0."""
        return np.zeros(steps, dtype=int)

    def times(self, steps: int) -> Array:
        """The time (T,) s of each step."""
        return self.dt * np.arange(1.0, steps + 1)

    def offers(self) -> frozenset[str]:
        """Names of the NEEDS of estimators that the scenario offers."""
        found = {"motion", "prior"} if self.motion is not None else set()
        found |= {"height"} if self.known_height_m is not None else set()
        found |= {"several_anchors"} if self.true_anchors.count > 1 else set()
        tracks = self.tracks
        if tracks is None:
            return frozenset(found | {"truth"})
        known = bool(np.isfinite(tracks.truth[:, :2]).any())
        return frozenset(found | ({"truth"} if known else set()) | tracks.measured.offers())


class Noise(CheckedParams):
    """Measurements from the true geometry."""

    @property
    def calibration(self) -> Calibration | None:
        """Deviations of the noise that azimuth-elevation filters may use, or None."""
        return None

    def sample(self, rng: np.random.Generator, scenario: Scenario, truth: Array) -> Measurements:
        """Measurements (T, B) of one replication from its true states (T, n)."""
        raise NotImplementedError

    def sample_tile(
        self, rngs: Sequence[np.random.Generator], scenario: Scenario, truth: Array
    ) -> Measurements:
        """Measurements (R, T, K) of replications with generators `rngs` from true states (R, T, n):
        the bits of `sample`, of all anchors or of those heard.
        """
        each = [self.sample(rng, scenario, states) for rng, states in zip(rngs, truth)]
        return Measurements.stacked(each)

    def known_anchors(self, rng: np.random.Generator, scenario: Scenario) -> Anchors:
        """The anchors (1, T|1, B, ...) as estimators know them in one replication."""
        return scenario.true_anchors

    def information(self, point: Array, anchors: Anchors) -> Array | None:
        """Fisher information (..., 3, 3) 1/m^2 of one set of measurements at points (..., 3) m."""
        return None

    def offers(self) -> frozenset[str] | None:
        """Names of the NEEDS of estimators that the noise measures; None: not stated."""
        return None


class Measurement(CheckedParams):
    """A filter's model of the measurements; written for one point, broadcasting over leading axes.

    x (R, ..., n) are states; m = B d components in anchor order; `anchors` are those of one step.
    `quality` (R, m) are the nominal variances of one step. `kernel` names the compiled likelihood
    and derivatives that equal the methods of the class itself; a subclass does not inherit it.
    `uses` is that of the filters with the model.
    """

    kernel: str | None = None
    uses: frozenset[str] | None = None

    @property
    def needs(self) -> frozenset[str]:
        """Names of the NEEDS that scenario and noise must offer to the model."""
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
    """Positions from measurements: the common role of recursive filters and snapshot estimators.

    tile: exact number of replications per call; None: the largest power of two up to 128 for which
    an array (R, T, B) has at most 2^20 elements. by_replication: whether the estimates of a
    replication depend on its own data and the size of the tile alone; then a run simulates no
    other replications than it stores. An estimator that needs `truth` is called with the
    true states (R, T, n) as a fourth argument; such an estimator cannot run on a device.
    heard_only: whether it takes batches of the anchors heard alone (see `Batch`): K is then B.
    causal: whether the estimate of a step uses no later measurements, as live positioning requires.
    uses: the NEEDS of the group noise that estimates depend on where they are measured, required or
    not; None: not stated.
    """

    tile: int | None = None
    by_replication: bool = False
    heard_only: bool = False
    causal: bool = True
    uses: frozenset[str] | None = None

    @property
    def needs(self) -> frozenset[str]:
        """Names of the NEEDS that scenario and noise must offer to the estimator."""
        return frozenset()

    def __call__(self, batch: Batch, scenario: Scenario, streams: Streams) -> Estimates:
        """Positions (R, T, 3) m and outcomes (R, T) of the fixes."""
        raise NotImplementedError

    @property
    def label(self) -> str:
        """Name of the estimator in messages."""
        return type(self).__name__

    def check(self, scenario: Scenario, noise: Noise) -> None:
        """Raise Unfit if scenario and noise do not offer all `needs`."""
        offered = noise.offers()
        if offered is None:  # a noise that does not state its offers
            offered = frozenset(need for need, (group, _) in NEEDS.items() if group == "noise")
        for need in sorted(self.needs - scenario.offers() - offered):
            raise Unfit(*NEEDS[need])

    def prepare(self, say: Callable[[str], None]) -> None:
        """Compile or load the kernels, once, before the workers start; `say` prints a line."""

    def trace(self, batch: Batch, scenario: Scenario, streams: Streams) -> dict[str, Array]:
        """Columns (R, T) that a replay shows in addition to the estimates."""
        return {}


@dataclass(frozen=True)
class PlainEstimator(Estimator):
    """A bare callable (batch, scenario, streams) -> Estimates in the role of an estimator."""

    function: Callable[..., Estimates]
    files = ()
    needs = frozenset()
    label = "estimator"

    def __call__(
        self, batch: Batch, scenario: Scenario, streams: Streams, *truth: Array
    ) -> Estimates:
        return self.function(batch, scenario, streams, *truth)


class Filter(Estimator):
    """A recursive estimator with a measurement model and the scenario's motion model and prior."""

    measurement: Measurement

    @property
    def needs(self) -> frozenset[str]:
        return frozenset({"motion", "prior"}) | self.measurement.needs

    @property
    def uses(self) -> frozenset[str] | None:  # type: ignore[override]
        return self.measurement.uses
