"""The roles that plug-ins play: scenario, noise, measurement model, motion model, estimator."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from aoabench.maths.geometry import Array
from aoabench.streams import Streams
from aoabench.types import Anchors, Batch, Estimates, Measurements


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
