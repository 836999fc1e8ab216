"""Methods that go on from piece to piece of a stream: snapshot estimators, and Kalman filters,
which keep the state of each track.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import NamedTuple

import numpy as np

from aoabench.deployment.solving import Residuals, Solved, joined, residuals_of, solve
from aoabench.engine.draws import Draws
from aoabench.engine.tiles import checked
from aoabench.errors import UserError
from aoabench.filters.belief import Belief
from aoabench.filters.divergence import Filtered
from aoabench.filters.recursion import GaussianFilter
from aoabench.maths.geometry import Array
from aoabench.noise.recorded import Recorded as RecordedNoise
from aoabench.roles import Estimator
from aoabench.scenarios.recorded import Recorded
from aoabench.types import Batch, Estimates, Tracks


class State(NamedTuple):
    """A filter's state after a fix: mean (1, n), covariance (n, n), time in s; the prior of the
    track, and the results of its last fixes, from which outcomes follow.
    """

    mean: Array
    covariance: Array
    time: float
    prior: Belief
    last: Filtered


@dataclass
class Method:
    """A method for a stream; `states` are those of a filter's tracks, by the number of the track.

    Raises UserError for a method that needs later fixes, or a state that is not kept here.
    """

    scenario: Recorded
    method: Estimator
    states: dict[int, State] = field(default_factory=dict)

    def __post_init__(self) -> None:
        kept = isinstance(self.method, GaussianFilter) or "motion" not in self.method.needs
        if not (kept and self.method.causal):
            raise UserError(
                f"LOG=-: {self.method.label} does not run on a stream; allowed: an estimator, an "
                "EKF or a UKF, or a log in a file"
            )

    def forget(self, number: int) -> None:
        """Forget the state of a track that has ended."""
        self.states.pop(number, None)

    def solve(self, tracks: Tracks, numbers: np.ndarray) -> Solved:
        """The fixes of tracks with `numbers` (R,), which go on where the last call ended."""
        if isinstance(self.method, GaussianFilter):
            each = [self._step(self.method, tracks, i, int(n)) for i, n in enumerate(numbers)]
            pairs = zip(tracks.starts, (found.residuals for found in each))
            residuals = [replace(one, fix=one.fix + start) for start, one in pairs]
            estimates = joined([found.estimates for found in each])
            return Solved(estimates, Residuals.joined(residuals), {})
        whole = replace(tracks, tags=("",), counts=np.array([len(tracks.fix)]))
        alone = self.scenario.with_tracks(whole)
        return solve(alone, RecordedNoise(), self.method, whole.counts)

    def _step(self, method: GaussianFilter, tracks: Tracks, i: int, number: int) -> Solved:
        """The fixes of one track by a Kalman filter."""
        state = self.states.get(number)
        motion, start_s = self.scenario.motion, None if state is None else state.time
        some = self.scenario.with_tracks(tracks, start_s, motion)
        drawn = some if state is None else some.with_tracks(tracks)  # which computes no prior
        batch = Draws(drawn, RecordedNoise(), seed=0).drawn(i, 1).whole
        if state is not None:
            batch = replace(batch, prior_mean=state.mean, prior_cov=state.covariance)
        found, belief = method.recursion(batch, some, whole=True)
        seen = found._replace(
            position=found.position[..., :3], covariance=found.covariance[..., :3, :3]
        )
        if state is not None:
            belief = belief._replace(mean=state.prior.mean, covariance=state.prior.covariance)
            seen = _after(state.last, seen)
        estimates = _last(method.outcomes(seen, None, batch.layout, belief), batch)
        times = tracks.time[tracks.starts[i] : tracks.starts[i + 1]]
        before = np.nan if state is None else state.time
        self.states[number] = State(
            mean=found.position[:, -1],
            covariance=found.covariance[0, -1],
            time=float(np.fmax.reduce(times, initial=before)),
            prior=belief,
            last=Filtered(*(_cut(a, method.innovation_steps) for a in seen)),
        )
        residuals = residuals_of(batch, estimates.position)
        return Solved(estimates, residuals, {})


def _after(before: Filtered, now: Filtered) -> Filtered:
    """The results of steps (1, H, ...), then of steps (1, T, ...)."""
    pairs = [(a, b) for a, b in zip(before, now) if a is not None and b is not None]
    return Filtered(*(np.concatenate(pair, axis=1) for pair in pairs))


def _cut(array: np.ndarray | None, count: int) -> np.ndarray:
    """The last steps of an array (1, T, ...)."""
    assert array is not None
    return np.asarray(array[:, -count:])


def _last(estimates: Estimates, batch: Batch) -> Estimates:
    """The estimates of the batch's steps, which are the last ones."""
    T = batch.azimuth.shape[1]
    given = {f.name: getattr(estimates, f.name) for f in fields(Estimates)}
    cut = {name: None if a is None else a[:, -T:] for name, a in given.items()}
    return checked(Estimates(**cut), (1, T), "filter")  # type: ignore[arg-type]
