"""The robust likelihood of azimuths and elevations in NumPy: starts, the descent, the fixes.

The reference of `kernels.robust`; shapes as in `robust_model`.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from aoabench.estimators.losses import NORMAL, TRUNCATED, Loss
from aoabench.estimators.places import distinct_places
from aoabench.estimators.rays import FAR, apart, measured_reason
from aoabench.estimators.robust_model import Fixes, Lines, prepared, state
from aoabench.kernels.robust_limits import (
    EVEN,
    GAIN,
    GROWTH,
    LEAST,
    MOST,
    REDUNDANT,
    ROUNDING,
    SLACK,
    STARTS,
    STEEP,
    TINY,
    USED,
)
from aoabench.maths.geometry import Array
from aoabench.maths.linalg import ONE_PLACE, inverse, solve
from aoabench.types import Outcome, Reason


def starts(f: Fixes, lines: Lines) -> Iterator[Array]:
    """Candidates (N, 3) m of a start, NaN for none: the point nearest to all lines, then those on
    the lines of one anchor (where the height is known) and nearest to those of two that are apart,
    and those on one ray at its range.
    """
    used = f.wa > 0
    yield lines.nearest(used.astype(float), f)
    n, row = f.slot.max(axis=1, initial=-1) + 1, np.arange(len(f.z))
    most, count = int(n.max(initial=0)), np.zeros(len(n), dtype=int)
    first = [(f.slot == i).argmax(axis=1) for i in range(most)]
    for gap in range(most):
        for i in range(most - gap):
            some = ((f.slot == i) | (f.slot == i + gap)).astype(float)
            a, b = f.s[row, first[i]], f.s[row, first[i + gap]]
            between = ((a - b) ** 2).sum(-1) > ONE_PLACE * ((a**2).sum(-1) + (b**2).sum(-1))
            tried = (i + gap < n) & (count < STARTS)
            count += tried
            good = tried & (between if gap else True)
            if good.any():
                yield np.where(good[:, None], lines.nearest(some, f), np.nan)
    for i in range(most if f.wr.any() else 0):
        j = first[i]
        at = f.s[row, j] + f.r[row, j, None] * f.ahead[row, j]
        at[:, 2] = np.where(f.flat, f.z, at[:, 2])
        yield np.where((f.wr[row, j, None] > 0) & (i < n)[:, None], at, np.nan)


def best_start(f: Fixes, lines: Lines, loss: Loss) -> Array:
    """The candidates (N, 3) m of the least cost, NaN without any."""
    best, least = np.full((len(f.z), 3), np.nan), np.full(len(f.z), np.inf)
    for tried in starts(f, lines):
        cost = state(f, np.nan_to_num(tried), loss).cost
        with np.errstate(invalid="ignore"):
            less = np.isfinite(tried[:, 0]) & ~(cost >= least * (1.0 - EVEN) - ROUNDING)
        best[less], least[less] = tried[less], cost[less]
    return best


class Minimum(NamedTuple):
    """Result of the descent: position (N, 3) m, outcome, reason, updates and cost (N,)."""

    position: Array
    outcome: np.ndarray
    reason: np.ndarray
    updates: Array
    cost: Array


def minimum(f: Fixes, p: Array, loss: Loss, tolerance: float, updates: int) -> Minimum:
    """The minimum below the starts p (N, 3) m. Of the truncated loss, the better one of two: that
    of the loss itself, and the one that graduated non-convexity finds. The better one has the
    better outcome, or else the lower cost.
    """
    found = descended(f, p, loss, tolerance, updates, np.full(len(p), STEEP))
    if loss.kind != TRUNCATED or not len(p):
        return found
    s = state(f, p, loss).largest
    steepness = np.clip(loss.k**2 / np.maximum(2.0 * s - loss.k**2, TINY), 1.0 / STEEP, STEEP)
    graduated = descended(f, p, loss, tolerance, updates, steepness)
    lower = graduated.cost < found.cost * (1.0 - EVEN) - ROUNDING
    even = graduated.outcome == found.outcome
    lower = np.where(even, lower, graduated.outcome < found.outcome)
    for kept, new in zip(found, graduated):
        kept[lower] = new[lower]
    return found


def descended(
    f: Fixes, p: Array, loss: Loss, tolerance: float, updates: int, steepness: Array
) -> Minimum:
    """Damped Gauss-Newton steps with the loss's weights, from starts p (N, 3) m."""
    N = len(p)
    p, m, damping, count = p.copy(), steepness.copy(), np.full(N, 1e-3), np.zeros(N)
    outcome = np.full(N, Outcome.OSCILLATED, dtype=np.int8)
    reason = np.full(N, Reason.NO_CONVERGENCE, dtype=np.int8)
    far = FAR * np.sqrt((f.s**2).sum(axis=-1)).max(axis=1, initial=0.0)
    far = np.maximum(far, FAR * np.maximum(np.abs(f.z), f.r.max(axis=1, initial=0.0)))
    left = np.arange(N)
    for _ in range(updates):
        if not len(left):
            break
        some, at = f.those(left), m[left]
        now = state(some, p[left], loss, at)
        damped = now.A.copy()
        damped[:, range(3), range(3)] *= 1.0 + damping[left, None]
        step = solve(damped, now.g)
        tried = p[left] + step
        with np.errstate(invalid="ignore"):
            there = state(some, tried, loss, at)
            better = there.cost <= now.cost * (1.0 + SLACK) + ROUNDING
            length = np.linalg.norm(step, axis=-1)
            lost = ~(np.linalg.norm(tried, axis=-1) <= far[left])
        count[left] += 1
        p[left[better]] = tried[better]
        damping[left] = np.clip(damping[left] * np.where(better, 0.1, 10.0), LEAST, MOST)
        outcome[left[lost]] = Outcome.DIVERGED
        reason[left[lost]] = np.where(np.isnan(length[lost]), Reason.NO_DESCENT, Reason.TOO_FAR)
        done = ~lost & (at >= STEEP) & (length < tolerance)
        near = np.flatnonzero(done)  # damping alone makes a step short, too
        full = solve(now.A[near], now.g[near])
        gain = (full * now.g[near]).sum(axis=-1)
        short = (np.linalg.norm(full, axis=-1) < tolerance) | (gain <= GAIN)
        done[near] = short | (there.pole[near] <= tolerance)
        outcome[left[done]], reason[left[done]] = Outcome.OK, Reason.NONE
        m[left] = np.minimum(at * GROWTH, STEEP)
        left = left[~lost & ~done]
    cost = state(f, p, loss).cost
    return Minimum(p, outcome, reason, count, cost)


class Found(NamedTuple):
    """Fixes as the kernel returns them: position (N, 3) m, covariance (N, 3, 3) m^2, outcome,
    reason, updates, score and anchors used (N,).
    """

    position: Array
    covariance: Array
    outcome: np.ndarray
    reason: np.ndarray
    updates: Array
    score: Array
    used: Array


def fixes(
    measured: tuple[Array, ...],
    sites: tuple[Array, Array, Array],
    height: float,
    loss: Loss,
    tolerance: float,
    updates: int,
) -> Found:
    """One position per fix from angles, ranges and weights (N, B) and anchors (N, B, ...), their
    positions, rotations and numbers; `height` in m is NaN where z is estimated.
    """
    s, R, numbers = sites
    f, lines, centre = prepared(measured, s, R, height, numbers)
    used, line, ranged, known = f.wa > 0, f.we > 0, f.wr > 0, bool(np.isfinite(height))
    # one ray, or one range, meets the plane, and one range ends a ray
    alone = (known & (line | ranged).any(axis=1)) | (line & ranged).any(axis=1)
    seen = np.where(f.flat[:, None, None] & (np.arange(3) == 2), 0.0, f.s)
    together = ~alone & ~apart(seen[:, None], used[:, None])[:, 0]
    few = (loss.kind != NORMAL) & (f.different < REDUNDANT)
    plain = few & ~ranged.any(axis=1)
    p = lines.nearest(used.astype(float), f)
    losses = (loss, np.flatnonzero(~few)), (Loss(NORMAL, 1.0), np.flatnonzero(few & ~plain))
    for rho, those in losses:
        go = those[~together[those]]
        p[go] = best_start(f.those(go), Lines(*(a[go] for a in lines)), rho)
    p[together | (used.sum(axis=1) < np.where(alone, 1, 2))] = np.nan
    solved = np.isfinite(p[:, 0])
    outcome = np.where(solved, Outcome.OK, Outcome.FAILED).astype(np.int8)
    failed = measured_reason(used, 1 if known else 2, together)
    reason = np.where(solved, Reason.NONE, failed).astype(np.int8)
    count = np.zeros(len(p))
    for rho, those in losses:
        go = those[solved[those]]
        found = minimum(f.those(go), p[go], rho, tolerance, updates)
        p[go], outcome[go], reason[go], count[go], _ = found
    judged = _judged(f, p, outcome, reason, loss, few | ~solved)
    p += centre
    p[f.flat, 2] = np.nan
    return Found(p, judged[0], outcome, reason, count, *judged[1:])


def _judged(
    f: Fixes, p: Array, outcome: np.ndarray, reason: np.ndarray, loss: Loss, whole: np.ndarray
) -> tuple[Array, Array, Array]:
    """Covariances (N, 3, 3) m^2, scores and numbers of anchors used (N,) at positions p (N, 3) m;
    a fix behind an anchor that is used becomes DIVERGED. All anchors of the fixes `whole` are used.
    """
    with np.errstate(invalid="ignore"):
        at = state(f, p, loss, capped=True)
        least = USED * loss.weight(np.zeros(1))[0]
        used = (f.wa > 0) & ((at.by_azimuth >= least) | whole[:, None])
        back = (used & ((f.ahead * (p[:, None] - f.s)).sum(axis=-1) < 0)).any(axis=1)
    back &= outcome == Outcome.OK
    outcome[back], reason[back] = Outcome.DIVERGED, Reason.BEHIND
    scale = np.maximum(at.squares / np.maximum(f.redundancy, 1), 1.0)
    P = scale[:, None, None] * inverse(at.A)
    P[f.flat, 2] = P[f.flat, :, 2] = np.nan
    number = np.maximum((1 * (f.wa > 0) + (f.we > 0) + (f.wr > 0)).sum(axis=1), 1)
    score = np.where(f.redundancy > 0, np.sqrt(2.0 * at.cost / number), np.nan)
    return P, score, distinct_places(used, f.slot).astype(float)
