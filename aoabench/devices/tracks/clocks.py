"""Clocks of anchors that count from their own start, made comparable by the events that they share.

Two anchors that hear one packet give it one fix or sequence number. The offset between their clocks
is the difference that most pairs of such times have; a line through these pairs adds the drift.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from aoabench.maths.geometry import Array

SAME_S = 1.0  # s; clocks that all differ by less are taken as one
MOST_PAIRS = 200_000
_BIN_S = 0.5  # s; differences of one event's times scatter less
_DRIFT = 1e-4  # largest relative difference of two clocks' rates
_FOR_DRIFT = 20  # pairs that a drift needs


class Aligned(NamedTuple):
    """Times (N,) s by one clock, the largest offset in s that was removed, 0 if all clocks agree,
    and whether (N,) a packet's anchor shares no event with the others, so that its time is not by
    that clock.
    """

    time: Array
    offset: float
    apart: np.ndarray


def aligned(time: Array, anchor: np.ndarray, event: np.ndarray) -> Aligned:
    """Return times by the clock of the first anchor that measured.

    time (N,) s, NaN = unknown; anchor (N,); event (N,): numbers that the packets of one event
    share, which may come again.
    """
    known = np.isfinite(time)
    counts = np.bincount(anchor[known], minlength=int(anchor.max(initial=0)) + 1)
    event = np.unique(event, return_inverse=True)[1].ravel()
    heard = np.zeros(event.max(initial=0) + 1, dtype=bool)
    found, largest, best = time.copy(), 0.0, int((counts > 0).argmax())
    done = np.zeros(len(time), dtype=bool)
    left = counts > 0
    while True:
        done |= known & (anchor == best)
        heard[event[known & (anchor == best)]] = True
        left[best] = False
        shared = np.bincount(anchor[known & heard[event]], minlength=len(counts)) * left
        best = int(shared.argmax())
        if not shared[best]:
            apart = known & left[anchor]
            return Aligned(found, largest, apart) if largest > SAME_S else Aligned(time, 0.0, apart)
        own = known & (anchor == best)
        line = _line(*_pairs(event[own], found[own], event[done], found[done]))
        offset = np.polyval(line, found[own])
        found[own] += offset
        largest = max(largest, float(np.abs(offset).max()))


def _pairs(event_a: np.ndarray, a: Array, event_b: np.ndarray, b: Array) -> tuple[Array, Array]:
    """Times (P,) by two clocks of all pairs with one event, at most some MOST_PAIRS."""
    order = np.lexsort((b, event_b))
    event_b, b = event_b[order], b[order]
    first = np.searchsorted(event_b, event_a, side="left")
    count = np.searchsorted(event_b, event_a, side="right") - first
    row = np.flatnonzero(count)
    row = row[:: max(int(count.sum()) // MOST_PAIRS, 1)]
    count = count[row]
    start = np.repeat(first[row] - (np.cumsum(count) - count), count)
    return np.repeat(a[row], count), b[start + np.arange(count.sum())]


def _line(a: Array, b: Array) -> Array:
    """Coefficients (2,) of the line in `a` that gives b - a for the pairs of one event each."""
    difference = b - a
    ordered = np.sort(difference)
    width = _BIN_S + _DRIFT * np.ptp(a)
    inside = np.searchsorted(ordered, ordered + width, side="right") - np.arange(len(ordered))
    low = ordered[int(inside.argmax())]
    right = (difference >= low) & (difference <= low + width)
    agree = np.abs(difference) <= SAME_S
    if 2 * agree.sum() >= right.sum():
        right = agree
    middle = float(np.median(difference[right]))
    if right.sum() < _FOR_DRIFT or np.ptp(a[right]) < 1 / _DRIFT:
        return np.array([0.0, middle])
    centre = a[right].mean()
    slope, level = np.polyfit(a[right] - centre, difference[right], 1)
    return np.array([slope, level - slope * centre])
