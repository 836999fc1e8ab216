"""One estimator in a small simulation."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NoReturn

import numpy as np

from aoabench.engine.draws import Draws
from aoabench.engine.tiles import call, checked
from aoabench.maths.geometry import Array, euler
from aoabench.roles import Estimator, Noise, Scenario
from aoabench.testing import worlds
from aoabench.testing.copies import with_members
from aoabench.testing.rules import NotTried
from aoabench.types import Anchors, Batch, Estimates, Measurements, Outcome

REPLICATIONS, STEPS = 3, 16
TOLERANCE_M = 1e-5  # per metre of distance from the anchors, at least per metre


@dataclass(frozen=True)
class Uneven(Noise):
    """A noise whose anchors are known differently in each replication, in every field."""

    inner: Noise

    def offers(self) -> frozenset[str] | None:
        return self.inner.offers()

    def sample(self, rng: np.random.Generator, scenario: Scenario, truth: Array) -> Measurements:
        return self.inner.sample(rng, scenario, truth)

    def known_anchors(self, rng: np.random.Generator, scenario: Scenario) -> Anchors:
        known = self.inner.known_anchors(rng, scenario)
        position = known.position + 0.2 * rng.standard_normal(known.position.shape)
        turn = euler(np.radians([1.0, 5.0, 10.0]) * rng.standard_normal(3))
        sigma = np.broadcast_to(rng.uniform(0.05, 0.5), known.position.shape)
        return Anchors(position, turn.T @ known.rotation, sigma)


@dataclass(frozen=True)
class Trial:
    """An estimator, and the simulation that it is tried in."""

    estimator: Estimator
    scenario: Scenario
    noise: Noise

    @cached_property
    def draws(self) -> Draws:
        return Draws(self.scenario, self.noise, 1)

    @cached_property
    def given(self) -> tuple[Array, Batch]:
        """Truth (R, T, n) and batch of the first steps of some replications, without bounds."""
        truth, batch = self.draws.tile(0, REPLICATIONS)
        some = slice(0, STEPS)
        return truth[:, some], worlds.steps(batch, some)

    @property
    def truth(self) -> Array:
        return self.given[0]

    @property
    def batch(self) -> Batch:
        return self.given[1]

    @cached_property
    def uneven(self) -> tuple[Array, Batch]:
        """Truth and batch whose anchors are known differently in each replication."""
        truth, batch = Draws(self.scenario, Uneven(self.noise), 1).tile(0, REPLICATIONS)
        some = slice(0, STEPS)
        return truth[:, some], worlds.steps(batch, some)

    @cached_property
    def sealed(self) -> Scenario:
        """The scenario, which refuses to tell the truth and tells wrong true anchors."""
        at = self.scenario.true_anchors
        wrong = replace(at, position=at.position + [0.3, -0.2, 0.1])
        return with_members(
            self.scenario, truth=_refuse_truth, true_anchors=property(lambda _: wrong)
        )

    @cached_property
    def open_space(self) -> Scenario:
        """The scenario without bounds and walls, which would not turn with the world."""
        nothing = property(lambda _: None)
        return with_members(self.scenario, bounds_m=nothing, wall_segments=nothing)

    @cached_property
    def found(self) -> Estimates:
        """The estimates of the batch."""
        return self.run(self.batch)

    @cached_property
    def free(self) -> Estimates:
        """The estimates of the batch in the open space."""
        return self.run(self.batch, scenario=self.open_space)

    def raw(
        self,
        batch: Batch,
        truth: Array | None = None,
        numbers: tuple[int, ...] = tuple(range(REPLICATIONS)),
        **changed: Any,
    ) -> Estimates:
        """The estimates of a batch, as returned; `changed`: scenario, seed or estimator in place of
        the own ones.
        """
        scenario, seed = changed.get("scenario", self.scenario), changed.get("seed", 1)
        draws = self.draws if not changed else Draws(scenario, self.noise, seed)
        truth = self.truth[:, : batch.azimuth.shape[1]] if truth is None else truth
        return call(changed.get("estimator", self.estimator), batch, draws, numbers, truth)

    def run(self, batch: Batch, *given: Any, **changed: Any) -> Estimates:
        """The estimates of a batch as a run takes them, arguments as for `raw`: fixes that claim a
        position and give NaN are FAILED. Raises UserError for arrays of a wrong shape.
        """
        found = self.raw(batch, *given, **changed)
        return checked(found, batch.azimuth.shape[:2], self.estimator.label)

    @cached_property
    def is_random(self) -> bool:
        """Whether the estimates depend on the random streams."""
        other = self.run(self.batch, seed=2)
        return not np.array_equal(self.found.position, other.position, equal_nan=True)

    def require_exact(self) -> None:
        """Raise NotTried for an estimator that draws random numbers."""
        if self.is_random:
            raise NotTried("it draws random numbers, and other draws are other positions")

    def apart(self, one: Estimates, other: Estimates) -> str:
        """How estimates differ that have to be the same, in words; '' if they do not."""
        different = one.outcome != other.outcome
        if different.any():
            r, k = np.argwhere(different)[0]
            names = [Outcome(int(e.outcome[r, k])).name.lower() for e in (one, other)]
            count = int(different.sum())
            return f"changes the outcome of {count} fixes, such as {names[0]} to {names[1]}"
        a, b = (np.nan_to_num(e.position) for e in (one, other))
        far = np.linalg.norm(a - self.batch.anchors.position.mean(axis=(0, 1, 2)), axis=-1)
        off = np.linalg.norm(a - b, axis=-1)
        if np.any(off > TOLERANCE_M * np.maximum(far, 1.0)):
            return f"changes the position by up to {off.max():.3g} m"
        if (one.covariance is None) != (other.covariance is None):
            return "decides whether there is a covariance"
        if one.covariance is None or other.covariance is None:
            return ""
        P, Q = one.covariance, other.covariance
        close = np.isclose(P, Q, rtol=1e-5, atol=1e-12, equal_nan=True)
        return (
            ""
            if close.all()
            else f"changes the covariance by up to {np.nanmax(np.abs(P - Q)):.3g} m^2"
        )


def taken_back(found: Estimates, turn: Array, by: Array) -> Estimates:
    """Estimates of a world that was turned by (3, 3) and then moved by (3,) m, in the axes before;
    a plane's position keeps z = NaN.
    """
    known = found.position - by
    flat = np.isnan(known[..., 2])
    p = np.where(np.isnan(known), 0.0, known) @ turn
    p[flat, 2] = np.nan
    p[np.isnan(known[..., 0])] = np.nan
    return replace(found, position=p, covariance=None)


def _refuse_truth(*_: object) -> NoReturn:
    raise PermissionError("it calls scenario.truth, which no estimator knows in the field")
