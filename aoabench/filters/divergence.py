"""Divergence of filters: which fixes are DIVERGED or FAILED, and why.

A diverged fix keeps its position and covariance and counts in every error; only its outcome says
that the filter's own belief contradicts the geometry (TOO_FAR), the measurements (INNOVATIONS) or
itself (COVARIANCE). A step without any measurement is judged by its position and covariance alone.
"""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy import special

from aoabench.filters.belief import Belief
from aoabench.maths.geometry import Array
from aoabench.maths.linalg import blocks
from aoabench.params import CheckedParams, param
from aoabench.types import Anchors, Estimates, Outcome, Reason

SINGULAR = 1e-6  # least share of a variance that others leave open; single precision has 1e-7


@dataclass(frozen=True)
class ExtentBound(CheckedParams):
    """Mixin of all filters: the bound of positions."""

    _: KW_ONLY
    extent_factor: float = param(
        10.0,
        "a fix is diverged at more than this many times the extent of anchors and prior from the "
        "anchors' centre",
        above=0,
    )

    def judged(
        self, found: Estimates, anchors: Anchors, belief: Belief, singular: float = 0.0
    ) -> Estimates:
        """Return `found` with the outcomes and reasons of FAILED and of too distant or degenerate
        fixes; `singular` as for `degenerate`. A fix that is not OK keeps its outcome and reason.
        """
        far = too_far(found.position, anchors, belief, self.extent_factor)
        found = marked(found, far, Reason.TOO_FAR)
        assert found.covariance is not None
        return marked(found, degenerate(found.covariance, singular), Reason.COVARIANCE)


@dataclass(frozen=True)
class InnovationBound(ExtentBound):
    """Mixin of Kalman filters: the bounds of positions and of innovations."""

    _: KW_ONLY
    innovation_tail: float = param(
        1e-9,
        "probability that bounds normalised innovations: a larger one has this probability at one "
        "step of a well-matched filter",
        above=0,
        most=0.1,
    )
    innovation_steps: int = param(
        5,
        "number of consecutive measured steps with normalised innovations above their bound from "
        "which on fixes are diverged",
        least=1,
        most=1_000_000,
    )

    def outcomes(
        self, filtered: Filtered, Y: Array | None, anchors: Anchors, belief: Belief
    ) -> Estimates:
        """Return the estimates of a Kalman filter with outcomes and reasons, after measurements Y
        (R, T, m); None if `filtered` has the numbers of measured components.

        Where several reasons hold, the first of TOO_FAR, COVARIANCE and INNOVATIONS is stated.
        """
        found = self.judged(sound(filtered.position, filtered.covariance), anchors, belief)
        if not (filtered.nis > _limits(1, self.innovation_tail)[1]).any():
            return found  # decided faster, without counting components
        measured = np.isfinite(Y).sum(axis=-1) if Y is not None else filtered.measured
        assert measured is not None
        run = inconsistent(filtered.nis, measured, self.innovation_tail, self.innovation_steps)
        return marked(found, run, Reason.INNOVATIONS)


class Filtered(NamedTuple):
    """A Kalman filter's positions (R, T, 3) m or states (R, T, n), their covariances, normalised
    innovations squared (R, T), without what rounding may add to them, and numbers of measured
    components (R, T).
    """

    position: Array
    covariance: Array
    nis: Array
    measured: np.ndarray | None = None


def sound(position: Array, covariance: Array) -> Estimates:
    """Return estimates whose fixes are FAILED where a number is not finite, else OK.

    The reason is UNDETERMINED if the position is finite and the covariance is not, else
    NOT_A_NUMBER; the position of a FAILED fix is NaN.
    """
    if np.isfinite(position.sum()) and np.isfinite(covariance.sum()):  # then each number is
        outcome, reason = np.zeros((2, *position.shape[:-1]), dtype=np.int8)  # OK and NONE
        return Estimates(position, covariance, None, outcome, reason=reason)
    known = np.isfinite(position).all(-1)
    finite = np.asarray(known & np.isfinite(covariance).all((-1, -2)))
    outcome = np.where(finite, Outcome.OK, Outcome.FAILED).astype(np.int8)
    broken = np.where(known, Reason.UNDETERMINED, Reason.NOT_A_NUMBER)
    reason = np.where(finite, Reason.NONE, broken).astype(np.int8)
    position = np.where(finite[..., None], position, np.nan)
    return Estimates(position, covariance, None, outcome, reason=reason)


def marked(found: Estimates, wrong: np.ndarray, reason: Reason) -> Estimates:
    """Mark OK fixes of `found` that are `wrong` (R, T) DIVERGED for `reason`; return `found`."""
    assert found.reason is not None
    if wrong.any():
        wrong = wrong & (found.outcome == Outcome.OK)
        found.outcome[wrong], found.reason[wrong] = Outcome.DIVERGED, reason
    return found


def too_far(position: Array, anchors: Anchors, belief: Belief, factor: float) -> np.ndarray:
    """Whether positions (R, T, 3) m are at more than `factor` extents from the anchors' centre.

    The centre (R|1, T|1, 3) is the mean of the anchors' known positions at that step. The extent is
    the larger of the largest distance of an anchor from the centre, and of the distance of the
    prior's mean from the centre plus the prior's standard deviation, which is the root of the trace
    of the position's prior covariance. Without a finite extent above 0 no position is too far.
    """
    places = anchors.position
    known = np.asarray(np.isfinite(places).all(-1))
    with np.errstate(invalid="ignore"):
        centre = np.where(known[..., None], places, 0.0).sum(2) / known.sum(2)[..., None]
        apart = np.where(known, _length(places - centre[:, :, None]), 0.0)
        deviation = np.sqrt(np.trace(belief.covariance[:3, :3]))
        off = _length(belief.mean[:, None, :3] - centre) + deviation
        extent = np.maximum(apart.max(axis=2, initial=0.0), off)
        bound = np.where(extent > 0, factor * extent, np.inf)
        furthest = max(position.max(), -position.min())
        if 2 * (furthest + np.abs(centre).max()) < bound.min():
            return np.zeros(position.shape[:-1], dtype=bool)  # decided faster, without lengths
        return _length(position - centre) > bound


def inconsistent(nis: Array, measured: np.ndarray, tail: float, steps: int) -> np.ndarray:
    """Whether a fix (R, T) ends a run of at least `steps` measured steps whose normalised
    innovations squared `nis` (R, T) exceed the chi-square quantile 1 - `tail`.

    The degrees of freedom are the numbers (R, T) of components that are `measured`. A step without
    any neither continues nor ends a run and is not marked.
    """
    found = np.zeros(nis.shape, dtype=bool)
    limit = _limits(max(int(measured.max(initial=0)), 1), tail)
    some = np.count_nonzero(nis > limit[1], axis=1) >= steps  # the others have no run
    if some.any():
        seen = measured[some] > 0
        above = (nis[some] > limit[measured[some]]) & seen
        count = np.cumsum(above, axis=1, dtype=np.int32)
        before = count * (seen & ~above)
        found[some] = above & (count - np.maximum.accumulate(before, axis=1) >= steps)
    return found


@lru_cache(maxsize=64)
def _limits(most: int, tail: float) -> Array:
    """Chi-square quantiles (most + 1,) of probability 1 - tail for 0, 1, ... degrees of freedom."""
    limits = special.chdtri(np.maximum(np.arange(most + 1.0), 1.0), tail)
    limits.flags.writeable = False
    return np.asarray(limits)


def degenerate(covariance: Array, singular: float = 0.0) -> np.ndarray:
    """Whether covariances (..., 3, 3) m^2 are zero or not positive definite; False where NaN.

    A matrix is positive definite if its variances are positive and, in the order of the axes, each
    axis keeps more than the share `singular` of its variance when those before it are known. The
    rule does not depend on the unit of length.
    """
    bad = np.empty(covariance.shape[:-2], dtype=bool)
    for some in blocks(bad.shape):
        bad[some] = _degenerate(covariance[some], singular)
    return bad


def _degenerate(covariance: Array, singular: float) -> np.ndarray:
    below = ((0, 0), (1, 1), (2, 2), (1, 0), (2, 0), (2, 1))
    a, b, c, d, e, f = (np.ascontiguousarray(covariance[..., i, j]) for i, j in below)
    with np.errstate(all="ignore"):
        p, q = d / a, e / a
        second = b - p * d
        coupled = f - q * d
        third = c - q * e - coupled * coupled / second
        return np.asarray((a <= 0) | (second <= singular * b) | (third <= singular * c))


def _length(vector: Array) -> Array:
    """Lengths (...) of vectors (..., 3)."""
    return np.asarray(np.sqrt((vector * vector).sum(axis=-1)))
