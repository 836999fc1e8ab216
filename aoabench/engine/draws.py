"""Simulated replications: truth, measurements, prior and known anchors of a tile."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from aoabench.engine import recording
from aoabench.engine.start import prior_of
from aoabench.maths.geometry import Array
from aoabench.maths.places import at_anchors, at_places
from aoabench.roles import Noise, Scenario
from aoabench.streams import ANCHORS, ESTIMATOR, MEASUREMENT, PRIOR, TRUTH, Streams, generators
from aoabench.types import Anchors, Batch, Measurements, Tracks

_EMPTY = {"position": np.zeros(3), "rotation": np.eye(3), "position_sigma": np.zeros(3)}


@dataclass(frozen=True)
class Drawn:
    """A tile of simulated replications, or a recorded track; all arrays are read-only.

    truth (R, T, n); measured (R, T, K); known: all B anchors as known in each replication; prior
    (R, n) and (n, n), or None; time (1, T) s, None where unknown. columns (C,): the number of the
    anchor behind each place of `measured` and `known` where one may have several, else None.
    """

    truth: Array
    measured: Measurements
    known: Anchors
    prior: tuple[Array, Array] | None
    time: Array | None
    columns: np.ndarray | None = None

    @cached_property
    def heard(self) -> Batch:
        """The batch of the anchors heard at each step, or of all if the noise measures all."""
        numbers = self.measured.anchor_id
        if numbers is None:
            places = None if self.columns is None else self.columns[None, None]
            return self._batch(self.measured.arrays, self.known, places)
        known = {
            name: at_places(array, numbers, _EMPTY[name])
            for name, array in self.known.arrays.items()
        }
        return self._batch(self.measured.arrays, Anchors(**known), numbers, self.known)

    @cached_property
    def whole(self) -> Batch:
        """The batch of all anchors."""
        numbers, count = self.measured.anchor_id, self.known.count
        if numbers is None:
            return self.heard
        arrays = self.measured.arrays.items()
        measured = {name: at_anchors(array, numbers, count) for name, array in arrays}
        return self._batch(measured, self.known, None)

    def _batch(
        self,
        measured: dict[str, Array],
        anchors: Anchors,
        numbers: np.ndarray | None,
        known: Anchors | None = None,
    ) -> Batch:
        mean, cov = self.prior or (None, None)
        batch = Batch(
            anchors=anchors,
            anchor_id=numbers,
            known=known,
            prior_mean=mean,
            prior_cov=cov,
            time=self.time,
            **measured,
        )
        for array in (cov, *batch.arrays.values(), *anchors.arrays.values()):
            if array is not None:
                array.setflags(write=False)  # all estimators see the same
        return batch

    def placed(self, at: np.ndarray) -> Drawn:
        """A tile whose place i holds the data of the replication at index `at[i]` of this one."""
        measured = {name: taken(array, at) for name, array in self.measured.arrays.items()}
        numbers = self.measured.anchor_id
        return replace(
            self,
            truth=taken(self.truth, at),
            measured=Measurements(
                **measured, anchor_id=None if numbers is None else taken(numbers, at)
            ),
            known=placed_anchors(self.known, at),
            prior=None if self.prior is None else (taken(self.prior[0], at), self.prior[1]),
        )


class Draws:
    """Simulated replications or recorded tracks of one cell; the last tile is cached for the next
    estimator. A tile of a recording is one track.

    With `only`, no other replications are simulated, apart from a second one if a tile has one of
    them: the first of these in a tile fills the places of the others.
    """

    def __init__(
        self, scenario: Scenario, noise: Noise, seed: int, only: range | None = None
    ) -> None:
        self.scenario, self.noise, self.seed, self.only = scenario, noise, seed, only
        self.tracks = scenario.tracks
        self._last: tuple[tuple[int, int], Drawn] | None = None

    def tile(self, start: int, size: int, heard_only: bool = False) -> tuple[np.ndarray, Batch]:
        """Truth (size, T, n) and batch of the replications from `start` on, of all anchors or of
        those heard at each step.
        """
        drawn = self.drawn(start, size)
        return drawn.truth, drawn.heard if heard_only else drawn.whole

    def drawn(self, start: int, size: int) -> Drawn:
        """The replications from `start` on."""
        if self._last is None or self._last[0] != (start, size):
            self._last = None  # frees its memory
            self._last = (start, size), self._simulated(start, size)
        return self._last[1]

    def streams(self, replications: tuple[int, ...]) -> Streams:
        """The estimators' random streams in some replications."""
        if self.tracks is not None:
            replications = tuple(recording.random_number(self.tracks, r) for r in replications)
        return Streams(self.seed, self.scenario.name, replications)

    def _simulated(self, start: int, size: int) -> Drawn:
        if self.tracks is not None:
            if size != 1:
                raise ValueError(f"a tile of a recording is one track, not {size}")
            return self._recorded(self.tracks, start)
        numbers = range(start, start + size)
        wanted = self._wanted(numbers)
        drawn = self.simulate(wanted)
        if len(wanted) == size:
            return drawn
        return drawn.placed(
            np.array([wanted.index(n if n in wanted else wanted[0]) for n in numbers])
        )

    def _wanted(self, numbers: range) -> range:
        """The replications of a tile to simulate. Two at least, if the tile has two: arrays that
        differ between replications are recognised by that.
        """
        if self.only is None:
            return numbers
        start, stop = max(numbers[0], self.only.start), min(numbers[-1] + 1, self.only.stop)
        if stop - start < 2 <= len(numbers):
            start = min(start, numbers[-1] - 1)
            stop = start + 2
        return range(start, stop)

    def simulate(self, numbers: range) -> Drawn:
        """Simulate the replications `numbers`."""
        truth = self._truth(numbers)
        measured = self._measured(numbers, truth)
        priors = [
            self.scenario.prior(rng, states)
            for rng, states in zip(self._rngs(numbers, ESTIMATOR, PRIOR), truth)
        ]
        given = [prior for prior in priors if prior is not None]
        known = [
            self.noise.known_anchors(rng, self.scenario) for rng in self._rngs(numbers, ANCHORS)
        ]
        all_anchors = together(known)
        for array in (truth, *all_anchors.arrays.values()):
            array.setflags(write=False)
        return Drawn(
            truth=truth,
            measured=measured,
            known=all_anchors,
            prior=(np.stack([mean for mean, _ in given]), given[0][1]) if given else None,
            time=self.scenario.times(truth.shape[1])[None],
        )

    def _recorded(self, tracks: Tracks, track: int) -> Drawn:
        """One track of the recording."""
        some, columns = recording.fixes_of(tracks, track), recording.columns_of(tracks, track)
        truth, time = tracks.truth[some][None], tracks.time[some][None]
        number = (recording.random_number(tracks, track),)
        (rng,), (other,) = self._rngs(number, ANCHORS), self._rngs(number, ESTIMATOR, PRIOR)
        anchors, anchor = self.noise.known_anchors(rng, self.scenario), tracks.columns[columns]
        several = not np.array_equal(anchor, np.arange(anchors.count))
        known = recording.anchors_of(anchors, tracks, track, columns)
        for array in (truth, *known.arrays.values()):
            array.setflags(write=False)
        drawn = Drawn(
            truth=truth,
            measured=recording.measured_by(tracks, track, columns),
            known=known,
            prior=None,
            time=time if np.isfinite(time).any() else None,
            columns=anchor if several else None,
        )
        return replace(drawn, prior=self._start(drawn, other))

    def _start(self, drawn: Drawn, rng: np.random.Generator) -> tuple[Array, Array] | None:
        """The prior (1, n) and (n, n) of a recorded track: the scenario's own, or from the track's
        first fix; None where fixes are independent.
        """
        place = self.scenario
        prior = place.prior(rng, drawn.truth[0])
        if prior is None and place.motion is not None:
            sigma, height = place.start_sigma_m, place.known_height_m
            prior = prior_of(drawn.whole, place.motion, sigma, height)
        return None if prior is None else (prior[0][None], prior[1])

    def _truth(self, numbers: range) -> Array:
        """True states (R, T, n), a view of one array if they are equal in all replications, as they
        are in a scenario that `shares_positions`.
        """
        drawn = range(1) if self.scenario.shares_positions else numbers
        each = [self.scenario.truth(rng) for rng in self._rngs(drawn, TRUTH)]
        if all(np.array_equal(states, each[0]) for states in each[1:]):
            return np.broadcast_to(each[0], (len(numbers), *each[0].shape))
        return np.stack(each)

    def _measured(self, numbers: range, truth: Array) -> Measurements:
        """The noise's measurements (R, T, K)."""
        rngs = self._rngs(numbers, MEASUREMENT)
        measured = _sampler(self.noise)(rngs, self.scenario, truth)
        ids = measured.anchor_id
        return measured if ids is None or ids.ndim == 3 else replace(measured, anchor_id=ids[None])

    def _rngs(
        self, numbers: Sequence[int], role: int, purpose: int = 0
    ) -> Sequence[np.random.Generator]:
        return generators(self.seed, self.scenario.name, numbers, role, purpose)


def _sampler(noise: Noise) -> Callable[..., Measurements]:
    """The noise's `sample_tile`, or a loop over `sample` if its class overrides `sample` alone."""
    defined = ({"sample", "sample_tile"} & vars(base).keys() for base in type(noise).__mro__)
    last = next(names for names in defined if names)
    return noise.sample_tile if "sample_tile" in last else partial(Noise.sample_tile, noise)


def together(each: Sequence[Anchors]) -> Anchors:
    """The anchors (R|1, T|1, B, ...) of several replications; arrays equal in all are kept once."""
    arrays = {}
    for name, first in each[0].arrays.items():
        values = [anchors.arrays[name] for anchors in each]
        same = all(value is first or np.array_equal(value, first) for value in values)
        arrays[name] = first if same else np.concatenate(values)
    return Anchors(**arrays)


def placed(batch: Batch, at: np.ndarray) -> Batch:
    """A batch whose place i holds the data of the tile's replication `at[i]`."""
    each = {name: a if a is None else taken(a, at) for name, a in batch.arrays.items()}
    known = None if batch.known is None else placed_anchors(batch.known, at)
    return replace(
        batch,
        anchors=placed_anchors(batch.anchors, at),
        known=known,
        **each,  # type: ignore[arg-type]
    )


def placed_anchors(anchors: Anchors, at: np.ndarray) -> Anchors:
    """Anchors whose place i holds those of the tile's replication `at[i]`."""
    return Anchors(**{name: taken(array, at) for name, array in anchors.arrays.items()})


def taken(array: Array, at: np.ndarray) -> Array:
    """The read-only rows `at` of an array; one that is the same in all replications is kept."""
    if len(array) == 1:
        return array
    found: Array = array[at]
    found.setflags(write=False)
    return found
