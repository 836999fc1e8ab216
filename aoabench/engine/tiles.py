"""One tile of replications: truth, measurements and the estimates of an estimator.

Estimators see tiles of a fixed number of replications, aligned on the replication number, so that a
replication gives the same bits however the work is divided.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from enum import IntEnum
from typing import cast

import numpy as np

from aoabench.engine.metrics import reasons
from aoabench.errors import UserError
from aoabench.roles import Estimator, Noise, Scenario
from aoabench.streams import ANCHORS, ESTIMATOR, MEASUREMENT, PRIOR, TRUTH, Streams, generator
from aoabench.types import Anchors, Batch, Estimates, Measurements, Outcome, Reason

_MOST_ELEMENTS = 2**20


def tile_of(estimator: Estimator, scenario: Scenario) -> int:
    """Number of replications that an estimator takes at once: its own `tile`, or one derived from
    the size of a replication; at most the number that the scenario has.
    """
    tile = estimator.tile or _derived_tile(scenario)
    return min(tile, scenario.replications or tile)


def _derived_tile(scenario: Scenario) -> int:
    """The largest power of two up to 128 for which an array (R, T, B) has at most 2^20 elements."""
    steps = len(scenario.truth(generator(0, scenario.name, 0, TRUTH)))
    most = max(_MOST_ELEMENTS // (steps * scenario.true_anchors.count), 1)
    return min(1 << (most.bit_length() - 1), 128)


def simulate(
    scenario: Scenario, noise: Noise, seed: int, replication: int
) -> tuple[np.ndarray, Measurements, tuple[np.ndarray, np.ndarray] | None]:
    """Truth (T, n), measurements and prior (mean, covariance) of one replication.

    A scenario that `shares_positions` has one truth for all replications.
    """
    name, of_truth = scenario.name, 0 if scenario.shares_positions else replication
    truth = scenario.truth(generator(seed, name, of_truth, TRUTH))
    measured = scenario.recorded
    if measured is None:
        measured = noise.sample(generator(seed, name, replication, MEASUREMENT), scenario, truth)
    prior = scenario.prior(generator(seed, name, replication, ESTIMATOR, PRIOR), truth)
    return truth, measured, prior


class Draws:
    """Simulated replications of one cell; the last tile is cached for the next estimator.

    With `only`, no other replications are simulated, apart from a second one if a tile has one of
    them: the first of these in a tile fills the places of the others.
    """

    def __init__(
        self, scenario: Scenario, noise: Noise, seed: int, only: range | None = None
    ) -> None:
        self.scenario, self.noise, self.seed, self.only = scenario, noise, seed, only
        self._last: tuple[tuple[int, int], tuple[np.ndarray, Batch]] | None = None

    def tile(self, start: int, size: int) -> tuple[np.ndarray, Batch]:
        """Truth (size, T, n) and batch of the replications from `start` on."""
        if self._last is None or self._last[0] != (start, size):
            self._last = (start, size), self._simulated(start, size)
        return self._last[1]

    def _simulated(self, start: int, size: int) -> tuple[np.ndarray, Batch]:
        numbers = range(start, start + size)
        wanted = self._wanted(numbers)
        truth, batch = self._drawn(wanted)
        if len(wanted) == size:
            return truth, batch
        at = np.array([wanted.index(n if n in wanted else wanted[0]) for n in numbers])
        truth = truth[at]
        truth.setflags(write=False)
        return truth, placed(batch, at)

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

    def _drawn(self, numbers: range) -> tuple[np.ndarray, Batch]:
        """Truth (R, T, n) and batch of the replications `numbers`."""
        drawn = [simulate(self.scenario, self.noise, self.seed, r) for r in numbers]
        measured = {
            f.name: None
            if getattr(drawn[0][1], f.name) is None
            else np.stack([getattr(d[1], f.name) for d in drawn])
            for f in fields(Measurements)
        }
        priors = [prior for _, _, prior in drawn if prior is not None]
        truth = np.stack([d[0] for d in drawn])
        batch = Batch(
            anchors=self._known_anchors(numbers),
            prior_mean=np.stack([mean for mean, _ in priors]) if priors else None,
            prior_cov=priors[0][1] if priors else None,
            time=self.scenario.times(truth.shape[1])[None],
            **measured,  # type: ignore[arg-type]
        )
        arrays = (getattr(batch, f.name) for f in fields(batch) if f.name != "anchors")
        for shared in (truth, *batch.anchors.arrays.values(), *arrays):
            if shared is not None:
                shared.setflags(write=False)  # all estimators see the same
        return truth, batch

    def _known_anchors(self, replications: range) -> Anchors:
        """The anchors (R|1, T|1, B, ...) as they are known in each replication."""
        each = [
            self.noise.known_anchors(
                generator(self.seed, self.scenario.name, r, ANCHORS), self.scenario
            )
            for r in replications
        ]
        return together(each)


def together(each: Sequence[Anchors]) -> Anchors:
    """The anchors (R|1, T|1, B, ...) of several replications; arrays equal in all are kept once."""
    arrays = {}
    for name, first in each[0].arrays.items():
        values = [anchors.arrays[name] for anchors in each]
        same = all(value is first or np.array_equal(value, first) for value in values)
        arrays[name] = first if same else np.concatenate(values)
    return Anchors(**arrays)


def estimate_tile(draws: Draws, estimator: Estimator, first: int) -> tuple[np.ndarray, Estimates]:
    """Truth (R, T, n) and estimates of the tile that starts at replication `first`."""
    truth, estimates = _asked(draws, estimator, first)
    return truth, checked(estimates, truth.shape[:2], estimator.label)


def _asked(
    draws: Draws, estimator: Estimator, first: int, at: np.ndarray | None = None
) -> tuple[np.ndarray, Estimates]:
    """Truth (R, T, n) of a tile and the estimator's estimates, unchecked.

    `at` (R,): for each place of the tile, the index of the replication whose data fill it.
    """
    size = tile_of(estimator, draws.scenario)
    truth, batch = draws.tile(first, size)
    if at is None:
        numbers = tuple(range(first, first + size))
        return truth, call(estimator, batch, draws, numbers, truth)
    numbers = tuple(first + int(i) for i in at)
    return truth, call(estimator, placed(batch, at), draws, numbers, truth[at])


def call(
    estimator: Estimator,
    batch: Batch,
    draws: Draws,
    replications: tuple[int, ...],
    truth: np.ndarray,
) -> Estimates:
    """The estimator's estimates for a batch; only an estimator that needs the truth gets the true
    states (R, T, n).
    """
    streams = Streams(draws.seed, draws.scenario.name, replications)
    if "truth" not in estimator.needs:
        return estimator(batch, draws.scenario, streams)
    with_truth = cast(Callable[..., Estimates], estimator)
    return with_truth(batch, draws.scenario, streams, truth)


def placed(batch: Batch, at: np.ndarray) -> Batch:
    """A batch whose place i holds the data of the tile's replication `at[i]`."""

    def taken(array: np.ndarray | None) -> np.ndarray | None:
        if array is None or len(array) == 1:
            return array
        found: np.ndarray = array[at]
        found.setflags(write=False)
        return found

    anchors = {name: taken(array) for name, array in batch.anchors.arrays.items()}
    names = [f.name for f in fields(Batch) if f.name not in ("anchors", "prior_cov")]
    each = {name: taken(getattr(batch, name)) for name in names}
    return replace(batch, anchors=Anchors(**anchors), **each)  # type: ignore[arg-type]


def try_tile(
    draws: Draws, estimator: Estimator, first: int
) -> tuple[np.ndarray, Estimates, dict[int, str]]:
    """Like `estimate_tile`, but an exception fails only the replications that cause it; the third
    value maps the numbers of replications with errors, NaN positions included, to messages.

    To find the cause, the tile is repeated with subsets of its replications. Each replication stays
    in its own place and one of them fills the other places, so that the tile keeps its size and
    each replication its bits. UserError and MemoryError do not depend on the data and are raised.
    """
    size, errors = tile_of(estimator, draws.scenario), dict[int, str]()
    truth, _ = draws.tile(first, size)
    shape = truth.shape[:2]
    pieces: list[tuple[np.ndarray, Estimates]] = []
    whole_tile = np.arange(size)
    todo = [whole_tile]
    while todo:
        some = todo.pop()
        at = None if len(some) == size else np.where(np.isin(whole_tile, some), whole_tile, some[0])
        try:
            _, raw = _asked(draws, estimator, first, at)
        except (UserError, MemoryError):
            raise
        except Exception as error:  # any exception of the estimator
            if len(some) > 1:
                todo += np.array_split(some, 2)
            else:
                text = f"{type(error).__name__}: {error}"
                errors[first + int(some[0])] = " ".join(text.split())[:500]
            continue
        good = checked(raw, shape, estimator.label)
        nan = (good.outcome != raw.outcome).sum(axis=1)
        for i in some[nan[some] > 0]:
            text = f"{nan[i]} of {shape[1]} fixes claim a position and give NaN"
            errors[first + int(i)] = text
        pieces.append((some, good))
    whole = len(pieces) == 1 and not errors
    return truth, pieces[0][1] if whole else _assembled(pieces, shape), errors


def _assembled(pieces: list[tuple[np.ndarray, Estimates]], shape: tuple[int, ...]) -> Estimates:
    """Assemble one tile (R, T) from the replications of several pieces; those in no piece are
    FAILED by an EXCEPTION.
    """
    found: dict[str, np.ndarray | None] = {
        "position": np.full((*shape, 3), np.nan),
        "outcome": np.full(shape, Outcome.FAILED, dtype=np.int8),
        "reason": np.full(shape, Reason.EXCEPTION, dtype=np.int8),
    }
    for field in ("covariance", "iterations", "score", "anchors_used"):
        given = next((value for _, e in pieces if (value := getattr(e, field)) is not None), None)
        found[field] = None if given is None else np.full(given.shape, np.nan)
    for some, e in pieces:
        for field, into in found.items():
            value = getattr(e, field)
            if into is not None and value is not None:
                into[some] = value[some]
    return Estimates(**found)  # type: ignore[arg-type]


def checked(estimates: Estimates, shape: tuple[int, ...], name: str) -> Estimates:
    """The estimates with unusable fixes marked FAILED; UserError if an array does not have the
    shape (R, T, ...) that the role requires.

    A fix that claims a position but has no finite x or y becomes FAILED as NOT_A_NUMBER, so that
    the counts cover all fixes. Every fix that is not OK has a reason (see metrics.reasons).
    """
    if not isinstance(estimates, Estimates):
        raise UserError(
            f"{name}: an estimator must return Estimates, not {type(estimates).__name__}"
        )
    wanted = {"position": (*shape, 3), "covariance": (*shape, 3, 3), "outcome": shape}
    wanted |= dict.fromkeys(("iterations", "score", "anchors_used", "reason"), shape)
    for field, expected in wanted.items():
        value = getattr(estimates, field)
        if value is None and field not in ("position", "outcome"):
            continue
        if np.shape(value) != expected:
            raise UserError(
                f"{name}: Estimates.{field} must have the shape {expected}, not {np.shape(value)}"
            )
    if not _are(estimates.outcome, Outcome):
        raise UserError(f"{name}: Estimates.outcome must hold values of Outcome")
    if estimates.reason is not None and not _are(estimates.reason, Reason):
        raise UserError(f"{name}: Estimates.reason must hold values of Reason")
    outcome, reason = np.asarray(estimates.outcome).astype(np.int8), reasons(estimates)
    x, y = (estimates.position[..., i] for i in range(2))
    given = (outcome != Outcome.FAILED) & (outcome != Outcome.REJECTED)
    lost = given & ~(np.isfinite(x) & np.isfinite(y))
    outcome[lost], reason[lost] = Outcome.FAILED, Reason.NOT_A_NUMBER
    return replace(estimates, outcome=outcome, reason=reason)


def _are(values: np.ndarray, kind: type[IntEnum]) -> bool:
    """Whether all values are among those of `kind`, which start at 0 without a gap."""
    if np.asarray(values).dtype.kind != "i":
        return bool(np.isin(values, list(kind)).all())
    return values.size == 0 or bool(values.min() >= 0 and values.max() < len(kind))
