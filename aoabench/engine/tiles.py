"""One tile of replications: truth, measurements and what an estimator makes of them.

Estimators see tiles of a fixed number of replications, aligned on the replication number: the same
replication gives the same bits however the work is cut.
"""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import numpy as np

from aoabench.errors import UserError
from aoabench.streams import ANCHORS, ESTIMATOR, MEASUREMENT, PRIOR, TRUTH, Streams, generator
from aoabench.types import Anchors, Batch, Estimates, Measurements, Outcome


def tile_of(estimator: Any, scenario: Any = None) -> int:
    """How many replications this estimator takes at once; no more than the scenario has, if it says
    how many.
    """
    tile = int(getattr(estimator, "tile", 128))
    return min(tile, getattr(scenario, "replications", tile))


def simulate(
    scenario: Any, noise: Any, seed: int, replication: int
) -> tuple[np.ndarray, Measurements, Any]:
    """Truth (T, n), measurements and prior (mean, covariance) of one replication.

    A scenario with `same_truth` has one truth for all replications.
    """
    once = getattr(scenario, "same_truth", False)
    truth = scenario.truth(generator(seed, scenario.name, 0 if once else replication, TRUTH))
    measured = getattr(scenario, "recorded", None)
    if measured is None:
        measured = noise.sample(
            generator(seed, scenario.name, replication, MEASUREMENT), scenario, truth
        )
    prior = scenario.prior(generator(seed, scenario.name, replication, ESTIMATOR, PRIOR), truth)
    return truth, measured, prior


class Draws:
    """Simulated replications of one cell; the last tile is kept, for the next estimator that asks
    for it.
    """

    def __init__(self, scenario: Any, noise: Any, seed: int) -> None:
        self.scenario, self.noise, self.seed = scenario, noise, seed
        self._last: tuple[tuple[int, int], tuple[np.ndarray, Batch]] | None = None

    def tile(self, start: int, size: int) -> tuple[np.ndarray, Batch]:
        """Truth (size, T, n) and batch of the replications from `start` on."""
        if self._last is None or self._last[0] != (start, size):
            self._last = (start, size), self._simulated(start, size)
        return self._last[1]

    def _simulated(self, start: int, size: int) -> tuple[np.ndarray, Batch]:
        drawn = [
            simulate(self.scenario, self.noise, self.seed, r) for r in range(start, start + size)
        ]
        measured = {
            f.name: None
            if getattr(drawn[0][1], f.name) is None
            else np.stack([getattr(d[1], f.name) for d in drawn])
            for f in fields(Measurements)
        }
        prior = drawn[0][2]
        known = self._known_anchors(range(start, start + size))
        batch = Batch(
            anchors=known,
            prior_mean=None if prior is None else np.stack([d[2][0] for d in drawn]),
            prior_cov=None if prior is None else prior[1],
            **measured,  # type: ignore[arg-type]
        )
        truth = np.stack([d[0] for d in drawn])
        anchors = (known.position, known.rotation, known.position_sigma)
        for shared in (truth, *anchors, *(getattr(batch, f.name) for f in fields(batch))):
            if isinstance(shared, np.ndarray):
                shared.setflags(write=False)  # all estimators see the same
        return truth, batch

    def _known_anchors(self, replications: range) -> Anchors:
        true: Anchors = self.scenario.known_anchors
        if not hasattr(self.noise, "known_anchors"):
            return true
        name = self.scenario.name
        each = [
            self.noise.known_anchors(generator(self.seed, name, r, ANCHORS), self.scenario)
            for r in replications
        ]
        sigma = [a.position_sigma for a in each]
        return Anchors(
            np.concatenate([a.position for a in each]),
            true.rotation,
            None if sigma[0] is None else sigma[0],
        )


def estimate_tile(draws: Draws, estimator: Any, first: int) -> tuple[np.ndarray, Estimates]:
    """Truth (R, T, n) and estimates of the tile that starts at replication `first`."""
    truth, estimates = _asked(draws, estimator, first)
    return truth, checked(estimates, truth.shape[:2], type(estimator).__name__)


def _asked(
    draws: Draws, estimator: Any, first: int, at: np.ndarray | None = None
) -> tuple[np.ndarray, Estimates]:
    """Truth (R, T, n) of a tile and what the estimator says, unchecked; `at` (R,): whose data each
    place gets.
    """
    size = tile_of(estimator, draws.scenario)
    truth, batch = draws.tile(first, size)
    numbers = range(first, first + size) if at is None else [first + int(i) for i in at]
    streams = Streams(draws.seed, draws.scenario.name, tuple(numbers))
    seen = (truth if at is None else truth[at],) if getattr(estimator, "sees_truth", False) else ()
    return truth, estimator(
        batch if at is None else placed(batch, at), draws.scenario, streams, *seen
    )


def placed(batch: Batch, at: np.ndarray) -> Batch:
    """The batch with the data of replication `at[i]` of the tile in its place i."""

    def placed(array: np.ndarray | None) -> np.ndarray | None:
        if array is None or len(array) == 1:
            return array
        taken = array[at]
        taken.setflags(write=False)
        return taken

    anchors = Anchors(**{f.name: placed(getattr(batch.anchors, f.name)) for f in fields(Anchors)})  # type: ignore[arg-type]
    each = {
        f.name: placed(getattr(batch, f.name))
        for f in fields(Batch)
        if f.name not in ("anchors", "prior_cov")
    }
    return Batch(anchors=anchors, prior_cov=batch.prior_cov, **each)  # type: ignore[arg-type]


def try_tile(
    draws: Draws, estimator: Any, first: int
) -> tuple[np.ndarray, Estimates, dict[int, str]]:
    """As `estimate_tile`; what raises costs those replications alone that it raises on, and NaN is
    told, too.

    The third value says by replication's number what was wrong. To find who raises, the tile is
    repeated with some of its replications, each in its own place, the other places filled by one of
    them: the tile keeps its size and what it gives to a replication keeps its bits. UserErrors and
    lack of memory are not the data's fault and stop the run.
    """
    size, errors, name = (
        tile_of(estimator, draws.scenario),
        dict[int, str](),
        type(estimator).__name__,
    )
    truth, _ = draws.tile(first, size)
    everyone = np.arange(size)
    pieces: list[tuple[np.ndarray, Estimates]] = []
    todo = [everyone]
    while todo:
        some = todo.pop()
        at = None if len(some) == size else np.where(np.isin(everyone, some), everyone, some[0])
        try:
            _, raw = _asked(draws, estimator, first, at)
        except (UserError, MemoryError):
            raise
        except Exception as error:  # the estimator's, whatever it is
            if len(some) > 1:
                todo += np.array_split(some, 2)
            else:
                errors[first + int(some[0])] = " ".join(f"{type(error).__name__}: {error}".split())[
                    :500
                ]
            continue
        good = checked(raw, truth.shape[:2], name)
        nan = (good.outcome != raw.outcome).sum(axis=1)
        for i in some[nan[some] > 0]:
            errors[first + int(i)] = (
                f"{nan[i]} of {truth.shape[1]} fixes claim a position and give NaN"
            )
        pieces.append((some, good))
    return (
        truth,
        pieces[0][1] if len(pieces) == 1 and not errors else _assembled(pieces, truth.shape[:2]),
        errors,
    )


def _assembled(pieces: list[tuple[np.ndarray, Estimates]], shape: tuple[int, ...]) -> Estimates:
    """One tile (R, T) of some of the rows of each of several; nobody's rows are `failed`."""
    found: dict[str, np.ndarray | None] = {
        "position": np.full((*shape, 3), np.nan),
        "outcome": np.full(shape, Outcome.FAILED, dtype=np.int8),
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
    """The estimates, if their arrays have the shapes (R, T, ...) that the protocol asks for;
    UserError otherwise.

    A fix that claims a position and gives none (x or y not finite) is `failed`: nothing drops out
    of the counts.
    """
    if not isinstance(estimates, Estimates):
        raise UserError(
            f"{name}: an estimator must return Estimates, not {type(estimates).__name__}"
        )
    wanted = {"position": (*shape, 3), "covariance": (*shape, 3, 3), "outcome": shape}
    wanted |= dict.fromkeys(("iterations", "score", "anchors_used"), shape)
    for field, expected in wanted.items():
        value = getattr(estimates, field)
        if value is None and field not in ("position", "outcome"):
            continue
        if np.shape(value) != expected:
            raise UserError(
                f"{name}: Estimates.{field} must have the shape {expected}, not {np.shape(value)}"
            )
    if not np.isin(estimates.outcome, list(Outcome)).all():
        raise UserError(f"{name}: Estimates.outcome must hold values of Outcome")
    given = (estimates.outcome != Outcome.FAILED) & (estimates.outcome != Outcome.REJECTED)
    lost = given & ~np.isfinite(estimates.position[..., :2]).all(-1)
    return replace(
        estimates, outcome=np.where(lost, Outcome.FAILED, estimates.outcome).astype(np.int8)
    )
