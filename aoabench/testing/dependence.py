"""Rules about what estimates depend on: the batch and the streams, and nothing else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from aoabench.filters.heard import heard_alone
from aoabench.testing import worlds
from aoabench.testing.copies import sent
from aoabench.testing.rules import NotTried
from aoabench.testing.trial import Trial
from aoabench.types import Estimates, Outcome


def repeatable(trial: Trial) -> str:
    """Whether two calls differ."""
    again = trial.run(trial.batch)
    same = np.array_equal(trial.found.position, again.position, equal_nan=True)
    return "" if same else "a second call with the same batch and streams gives other positions"


def untouched(trial: Trial) -> str:
    """Whether a call changes its batch."""
    given, places = trial.batch, trial.batch.anchors
    arrays = {n: a.copy() for n, a in given.arrays.items() if a is not None}
    anchors = {n: a.copy() for n, a in places.arrays.items()}
    own = replace(given, anchors=replace(places, **anchors), **arrays)  # type: ignore[arg-type]
    before = {n: a.copy() for n, a in arrays.items()} | {
        f"anchors.{n}": a.copy() for n, a in anchors.items()
    }
    trial.run(own)
    after = arrays | {f"anchors.{n}": a for n, a in own.anchors.arrays.items()}
    changed = [n for n, a in before.items() if not np.array_equal(a, after[n], equal_nan=True)]
    return f"it changes batch.{', batch.'.join(changed)} in place" if changed else ""


def uninformed(trial: Trial) -> str:
    """Whether the estimator looks up the truth."""
    if "truth" in trial.estimator.needs:
        raise NotTried("it needs the truth and says so")
    problem = trial.apart(trial.found, trial.run(trial.batch, scenario=trial.sealed))
    words = "scenario.true_anchors, which differ from batch.anchors, the anchors as known,"
    return f"{words} {problem}" if problem else ""


def unused(trial: Trial) -> str:
    """Whether estimates depend on what `uses` leaves out."""
    uses = trial.estimator.uses
    if uses is None:
        raise NotTried("it does not state what it uses")
    for name in sorted(worlds.QUANTITIES - uses):
        if problem := trial.apart(trial.found, trial.run(worlds.other(trial.batch, name))):
            return f"uses leaves out {name!r}, and another one {problem}"
    return ""


def replications(trial: Trial) -> str:
    """Whether a replication depends on the others, or gets another one's anchors."""
    truth, batch = trial.uneven
    whole = trial.run(batch, truth)
    for i in range(len(truth)):
        alone = trial.run(batch.of(i), truth[i : i + 1], (i,))
        if problem := trial.apart(rows(whole, i), alone):
            return f"one replication alone instead of in a tile {problem}"
    return ""


def rows(found: Estimates, i: int) -> Estimates:
    """The estimates (1, T, ...) of one replication."""
    cut = [None if a is None else a[i : i + 1] for a in (found.position, found.covariance)]
    return Estimates(cut[0], cut[1], None, found.outcome[i : i + 1])  # type: ignore[arg-type]


def moving_anchors(trial: Trial) -> str:
    """Whether anchors that are given for each step are used."""
    truth, batch = trial.uneven
    still, repeated = trial.run(batch, truth), worlds.moving(batch)
    if problem := trial.apart(still, trial.run(repeated, truth)):
        return f"the same anchors, given for each step, {problem}"
    if "prior" in trial.estimator.needs or trial.is_random:
        return ""
    shift = 0.1 * np.random.default_rng(3).standard_normal(repeated.anchors.position.shape)
    anchors = replace(repeated.anchors, position=repeated.anchors.position + shift)
    moved = replace(repeated, anchors=anchors)
    whole, k = trial.run(moved, truth), truth.shape[1] - 1
    alone = trial.run(worlds.steps(moved, slice(k, k + 1)), truth[:, k : k + 1])
    last = Estimates(whole.position[:, k:], None, None, whole.outcome[:, k:])
    problem = trial.apart(last, replace(alone, covariance=None))
    return f"a step alone instead of in a track with anchors that move {problem}" if problem else ""


def heard(trial: Trial) -> str:
    """Whether batches of the anchors heard alone give the same."""
    if not trial.estimator.heard_only:
        raise NotTried("it takes batches of all anchors")
    R, T, B = trial.batch.azimuth.shape
    silent = (np.arange(T)[:, None] + np.arange(B)) % B == 0
    whole = worlds.without(replace(trial.batch, rssi=None), silent)
    compact = heard_alone(whole)
    if compact is whole:
        raise NotTried("the scenario has too few anchors")
    one, other = (trial.run(batch) for batch in (whole, compact))
    # a snapshot diverges at a bound that follows from the anchors that it uses
    same = np.isin(Outcome.DIVERGED, (one.outcome, other.outcome))
    problem = "" if same.any() and "prior" not in trial.estimator.needs else trial.apart(one, other)
    return f"a batch of the anchors heard instead of one of all {problem}" if problem else ""


def causal(trial: Trial) -> str:
    """Whether later measurements change earlier fixes."""
    if not trial.estimator.causal:
        raise NotTried("it says that it uses later measurements")
    trial.require_exact()
    half = trial.batch.azimuth.shape[1] // 2
    first = trial.run(worlds.steps(trial.batch, slice(0, half)))
    whole = trial.found
    cut = None if whole.covariance is None else whole.covariance[:, :half]
    problem = trial.apart(
        first, Estimates(whole.position[:, :half], cut, None, whole.outcome[:, :half])
    )
    return f"the second half of a track {problem}" if problem else ""


def sendable(trial: Trial) -> str:
    """Whether a worker process gets the same estimator."""
    again = trial.run(trial.batch, estimator=sent(trial.estimator))
    same = np.array_equal(trial.found.position, again.position, equal_nan=True)
    return "" if same else "after the way to a worker process it gives other positions"
