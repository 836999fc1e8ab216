"""One tile of replications: truth, measurements and the estimates of an estimator.

Estimators see tiles of a fixed number of replications, aligned on the replication number, so that a
replication gives the same bits however the work is divided.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from enum import IntEnum
from typing import cast

import numpy as np

from aoabench.engine.draws import Draws, placed
from aoabench.engine.inputs import heard
from aoabench.engine.metrics import reasons
from aoabench.errors import UserError
from aoabench.roles import Estimator, Scenario
from aoabench.streams import TRUTH, generator
from aoabench.types import Batch, Estimates, Outcome, Reason

_MOST_ELEMENTS = 2**20


def tile_of(estimator: Estimator, scenario: Scenario) -> int:
    """Number of replications that an estimator takes at once: its own `tile`, or one derived from
    the size of a replication; at most the number that the scenario has; one track of a recording.
    """
    if scenario.tracks is not None:
        return 1
    tile = estimator.tile or _derived_tile(scenario, estimator.heard_only)
    return min(tile, scenario.replications or tile)


def _derived_tile(scenario: Scenario, heard_only: bool) -> int:
    """The largest power of two up to 128 for which an array (R, T, B), or (R, T, K) of the anchors
    heard, has at most 2^20 elements.
    """
    truth, count = (
        scenario.truth(generator(0, scenario.name, 0, TRUTH)),
        scenario.true_anchors.count,
    )
    if heard_only and (heard := scenario.hears(truth[:, :3])) is not None:
        count = max(int(heard.sum(axis=1).max(initial=0)), 1)
    most = max(_MOST_ELEMENTS // (len(truth) * count), 1)
    return min(1 << (most.bit_length() - 1), 128)


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
    truth, batch = draws.tile(first, size, estimator.heard_only)
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
    streams, needs = draws.streams(replications), estimator.needs
    more = (truth,) if "truth" in needs else ()
    found = cast(Callable[..., Estimates], estimator)(batch, draws.scenario, streams, *more)
    return _counted(found, batch) if "motion" in needs else found


def _counted(estimates: Estimates, batch: Batch) -> Estimates:
    """A filter's estimates with the number of anchors that each step uses: all that are heard,
    unless the filter states another number.
    """
    if not isinstance(estimates, Estimates) or estimates.anchors_used is not None:
        return estimates
    return replace(estimates, anchors_used=heard(batch).astype(float))


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
    truth = draws.drawn(first, size).truth
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
            if _interrupted(error):
                raise KeyboardInterrupt from error
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


def _interrupted(error: BaseException | None) -> bool:
    """Whether an exception comes from an interruption, as those of a compiler may."""
    seen = 0
    while error is not None and not isinstance(error, KeyboardInterrupt) and seen < 100:
        error, seen = error.__cause__ or error.__context__, seen + 1
    return isinstance(error, KeyboardInterrupt)


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
