"""Verdicts, computed from the numbers alone.

A claim holds where the whole interval of our number lies within its limits, fails where the
interval lies outside, and is undecided otherwise: a wider interval never makes it hold.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from aoabench.maths.estimate import Estimate
from aoabench.maths.intervals import normal_quantile
from aoabench.studies.claims import Limits

HOLDS = "holds"
FAILS = "fails"
UNDECIDED = "undecided"
NOT_JUDGED = "not judged"
DEPENDS = "depends"  # of a statement alone: some of its readings hold, and some fail

LEVEL = 0.997  # of all intervals of a reading together
POWER = 0.8


@dataclass(frozen=True)
class Judgement:
    """The verdict on one reading of a claim.

    `decisive` is the position, among the reading's numbers, of the one that decides; `interval` is
    its interval at the level of all of them together. The claim holds for all limits that leave
    `flips` between them, and for no others. `shows` is the smallest difference from a limit that
    this number of replications shows with probability POWER. `more` is the factor by which an
    undecided claim needs more replications (NaN: decided).
    """

    word: str
    decisive: int
    interval: tuple[float, float]
    flips: tuple[float, float]
    shows: float
    more: float
    ties: int = 0


def word(limits: Limits, interval: tuple[float, float]) -> str:
    """Whether a number with this interval holds, fails or is undecided."""
    low, high = interval
    if math.isnan(low) or math.isnan(high):
        return UNDECIDED
    above = low >= limits.low if limits.with_low else low > limits.low
    below = high <= limits.high if limits.with_high else high < limits.high
    if above and below:
        return HOLDS
    under = high < limits.low or (high == limits.low and not limits.with_low)
    over = low > limits.high or (low == limits.high and not limits.with_high)
    return FAILS if under or over else UNDECIDED


def judge(
    numbers: Sequence[Estimate], limits: Limits, quantifier: str = "for all", tie: float = 0.0
) -> Judgement:
    """The verdict on the numbers (at least one) of a reading.

    Each number has an interval at the level LEVEL of all together (Bonferroni). `for all` holds if
    each number does and fails if one does; `exists` holds if one does and fails if each does;
    `typical` needs more than half for either. Numbers that do not hold, but whose interval lies
    within +- `tie`, count neither way; if all are such, the reading is undecided.
    """
    confidence = 1 - (1 - LEVEL) / len(numbers)
    intervals = [_interval(e, confidence) for e in numbers]
    alone = [word(limits, i) for i in intervals]
    tied = [w != HOLDS and tie > 0 and max(-i[0], i[1]) <= tie for w, i in zip(alone, intervals)]
    counted = [i for i, t in enumerate(tied) if not t] or list(range(len(numbers)))
    words = ["" if all(tied) else alone[i] for i in counted]
    found = _quantified(words, quantifier)
    ranks = (FAILS, UNDECIDED, HOLDS)
    order = sorted(counted, key=lambda i: (ranks.index(alone[i]), _margin(limits, intervals[i])))
    place = {"for all": 0, "exists": -1, "typical": (len(order) - 1) // 2}[quantifier]
    at = order[place]
    decisive, (low, high) = numbers[at], intervals[at]
    hull = [intervals[i] for i in counted] if quantifier == "for all" else [(low, high)]
    z = normal_quantile(confidence)
    power = normal_quantile(2 * POWER - 1)  # one-sided
    half = (high - low) / 2
    return Judgement(
        found,
        at,
        (low, high),
        (min(a for a, _ in hull), max(b for _, b in hull)),
        half * (1 + power / z),
        _more(limits, decisive.value, half) if found == UNDECIDED else math.nan,
        sum(tied),
    )


def together(words: Iterable[str]) -> str:
    """The verdict on a claim from those on its readings: one that fails in some and holds in others
    depends on the reading.
    """
    seen = set(words) - {NOT_JUDGED}
    if not seen:
        return NOT_JUDGED
    if {HOLDS, FAILS} <= seen:
        return DEPENDS
    return UNDECIDED if UNDECIDED in seen else seen.pop()


def _interval(estimate: Estimate, confidence: float) -> tuple[float, float]:
    """The interval of a number; for a closed form (standard error 0) the number itself."""
    if estimate.se == 0:
        return estimate.value, estimate.value
    return estimate.interval(confidence)


def _quantified(words: Sequence[str], quantifier: str) -> str:
    holds, fails = words.count(HOLDS), words.count(FAILS)
    enough = {"for all": len(words), "exists": 1, "typical": len(words) // 2 + 1}[quantifier]
    if holds >= enough:
        return HOLDS
    return FAILS if fails > len(words) - enough else UNDECIDED


def _margin(limits: Limits, interval: tuple[float, float]) -> float:
    """How far an interval lies within the limits (negative: outside, or across), in its
    half-widths where it has one.
    """
    low, high = interval
    if math.isnan(low):
        return -math.inf
    inside = min(low - limits.low, limits.high - high)
    half = (high - low) / 2
    return inside / half if half > 0 and math.isfinite(inside) else inside


def _more(limits: Limits, value: float, half: float) -> float:
    """The factor in replications at which the interval would not reach the nearest limit."""
    distance = min(abs(value - limits.low), abs(value - limits.high))
    if math.isnan(half) or math.isnan(distance):
        return math.nan
    ratio = half / distance if distance > 0 else math.inf
    return ratio * ratio
