"""Methods that go on from piece to piece of a stream: snapshot estimators, and Kalman filters,
which keep the state of each track.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import NamedTuple

import numpy as np

from aoabench.deployment.resumed import Reached, fits, resumed
from aoabench.deployment.solving import Solved, joined, residuals_of, solve
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
from aoabench.types import Anchors, Batch, Estimates, Tracks


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
        whole = replace(tracks, tags=("",), counts=np.array([len(tracks.fix)]))
        alone = self.scenario.with_tracks(whole)
        if not isinstance(self.method, GaussianFilter):
            return solve(alone, RecordedNoise(), self.method, whole.counts)
        batch = Draws(alone, RecordedNoise(), seed=0).drawn(0, 1).whole
        steps = self._steps(self.method, tracks, batch, numbers.tolist())
        each = [
            self._noted(self.method, tracks, i, number, *steps[i])
            for i, number in enumerate(numbers.tolist())
        ]
        estimates = checked(joined(each), (1, len(tracks.fix)), self.method.label)
        return Solved(estimates, residuals_of(batch, estimates.position), {})

    def _steps(
        self, method: GaussianFilter, tracks: Tracks, batch: Batch, numbers: list[int]
    ) -> dict[int, tuple[Filtered, Belief]]:
        """The states in the fixes of each track, and the prior of the track. Tracks that go on are
        filtered together, where that is possible.
        """
        old = [i for i, number in enumerate(numbers) if number in self.states]
        states = [self.states[numbers[i]] for i in old]
        found: dict[int, tuple[Filtered, Belief]] = {}
        if states:
            means, covariances, times = zip(*((s.mean[0], s.covariance, s.time) for s in states))
            reached = Reached(np.stack(means), np.stack(covariances), np.array(times))
            if fits(method, tracks, reached):
                steps = resumed(method, self.scenario, tracks, batch, old, reached)
                found = {i: (step, s.prior) for i, step, s in zip(old, steps, states)}
        for i in (i for i in range(len(numbers)) if i not in found):
            found[i] = self._alone(method, tracks, i, self.states.get(numbers[i]))
        return found

    def _alone(
        self, method: GaussianFilter, tracks: Tracks, i: int, state: State | None
    ) -> tuple[Filtered, Belief]:
        """The states in the fixes of one track, and its prior."""
        motion, start_s = self.scenario.motion, None if state is None else state.time
        some = self.scenario.with_tracks(tracks, start_s, motion)
        drawn = some if state is None else some.with_tracks(tracks)  # which computes no prior
        batch = Draws(drawn, RecordedNoise(), seed=0).drawn(i, 1).whole
        if state is not None:
            batch = replace(batch, prior_mean=state.mean, prior_cov=state.covariance)
        found, belief = method.recursion(batch, some, whole=True)
        return found, belief if state is None else state.prior

    def _noted(
        self,
        method: GaussianFilter,
        tracks: Tracks,
        i: int,
        number: int,
        found: Filtered,
        prior: Belief,
    ) -> Estimates:
        """The estimates of the fixes of one track, whose state is kept."""
        state, some = self.states.get(number), slice(*tracks.starts[i : i + 2])
        seen = found._replace(
            position=found.position[..., :3], covariance=found.covariance[..., :3, :3]
        )
        if state is not None:
            seen = _after(state.last, seen)
        T, before = tracks.counts[i], np.nan if state is None else state.time
        layout = self.scenario.true_anchors
        if tracks.poses is not None:
            layout = _longer(tracks.poses.at(np.arange(some.start, some.stop)), seen)
        estimates = _last(method.outcomes(seen, None, layout, prior), T)
        self.states[number] = State(
            mean=found.position[:, -1],
            covariance=found.covariance[0, -1],
            time=float(np.fmax.reduce(tracks.time[some], initial=before)),
            prior=prior,
            last=Filtered(*(_cut(a, method.innovation_steps) for a in seen)),
        )
        return estimates


def _after(before: Filtered, now: Filtered) -> Filtered:
    """The results of steps (1, H, ...), then of steps (1, T, ...)."""
    pairs = [(a, b) for a, b in zip(before, now) if a is not None and b is not None]
    return Filtered(*(np.concatenate(pair, axis=1) for pair in pairs))


def _cut(array: np.ndarray | None, count: int) -> np.ndarray:
    """The last steps of an array (1, T, ...)."""
    assert array is not None
    return np.asarray(array[:, -count:])


def _longer(anchors: Anchors, seen: Filtered) -> Anchors:
    """The anchors (1, T, ...) of the last steps, from the first of them also in those before."""
    count, T = anchors.position.shape[1], seen.position.shape[1]
    return anchors.at(np.maximum(np.arange(T) - (T - count), 0))


def _last(estimates: Estimates, T: int) -> Estimates:
    """The estimates of the last T steps."""
    given = {f.name: getattr(estimates, f.name) for f in fields(Estimates)}
    cut = {name: None if a is None else a[:, -T:] for name, a in given.items()}
    return Estimates(**cut)  # type: ignore[arg-type]
