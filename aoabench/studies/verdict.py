"""The verdict on one printed number or claim, computed from the numbers alone."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from aoabench.maths.statistics import Estimate

REPRODUCED = "reproduced"


IN_KIND = "reproduced in kind"


NOT_REPRODUCIBLE = "not reproducible"


NOT_PRINTED = "not printed"


NOT_COMPUTED = "not computed"


def verdict(
    printed: float | tuple[float, float] | None,
    rounding: float,
    ours: Estimate | None,
    *,
    printed_se: float = 0.0,
    in_kind: bool = False,
    strict: bool = False,
    z: float = 3.0,
) -> str:
    """The verdict on one printed number or claim, from the numbers alone.

    `printed` is a number, known to +- `rounding` (half a unit of its last digit), or an interval
    that the paper claims (low, high); `printed_se` is the printed number's own Monte Carlo error,
    where its sample size is known. "reproduced" means that our number lies in the printed interval,
    widened by z standard errors. For a claim with `strict`, our number must lie inside by z
    standard errors, so that chance alone does not confirm the claim. `in_kind` states whether
    ordering or shape holds. With z = 3 a true number is missed with probability below 0.3 %. A
    number whose standard error is NaN is "not computed". A standard error of exactly 0 belongs to a
    closed form.
    """
    if ours is None or math.isnan(ours.value) or math.isnan(ours.se):
        return NOT_COMPUTED
    if printed is None:
        return NOT_PRINTED
    low, high = printed if isinstance(printed, tuple) else (printed - rounding, printed + rounding)
    slack = z * math.hypot(ours.se, printed_se)
    tolerance = 1e-9 * max(
        abs(low) if math.isfinite(low) else 0, abs(high) if math.isfinite(high) else 0
    )
    if strict:
        slack = -slack
    if strict and ours.value in (
        low,
        high,
    ):  # on the bound is not inside, even for a standard error of 0
        return IN_KIND if in_kind else NOT_REPRODUCIBLE
    if low - slack - tolerance <= ours.value <= high + slack + tolerance:
        return REPRODUCED
    return IN_KIND if in_kind else NOT_REPRODUCIBLE


def undecided(
    printed: Any, rounding: float, ours: Estimate, *, strict: bool = False, z: float = 3.0
) -> str:
    """The reason why a verdict rests on too few replications; "" if it rests on enough.

    A strict claim is undecided while our number lies within z standard errors of its bound; a
    number, while z standard errors exceed five times its rounding, unless ours clearly differs from
    it.
    """
    slack = z * ours.se
    if strict and isinstance(printed, tuple):
        low, high = printed
        outside = ours.value + slack < low or ours.value - slack > high
        inside = low + slack <= ours.value <= high - slack
        return "" if inside or outside else f"undecided: within {z:g} standard errors of the bound"
    if rounding > 0 and slack > 5 * rounding and abs(ours.value - printed) <= rounding + slack:
        return "undecided: the standard error is too large for the printed digits"
    return ""


def same_order(printed: ArrayLike, ours: ArrayLike) -> bool:
    """Whether our numbers are finite and have the order of the printed ones, where these differ."""
    p, o = np.asarray(printed, dtype=float), np.asarray(ours, dtype=float)
    i, j = np.triu_indices(len(p), 1)
    return bool(np.all(np.sign(p[i] - p[j]) * np.sign(o[i] - o[j]) >= 0)) and bool(
        np.all(np.isfinite(o))
    )
