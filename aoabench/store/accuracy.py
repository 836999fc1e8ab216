"""Quantities over fixes: quantiles of the error, shares within a distance, availability."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from aoabench.columns import CEP, ERROR_Z, WITHIN_M
from aoabench.maths import intervals
from aoabench.maths.intervals import Array, Interval


@dataclass(frozen=True)
class Errors:
    """Every fix of an estimator: error in the plane and in z, m (NaN without a position), and
    whether it is ok, each (R, T).

    place (T,): the number of each fix's position, where all replications share their positions.
    counts (R,): the numbers of the replications' fixes if they differ; then the other arrays are
    (F,), one replication after the other. tried (R, T): whether a replication has the fix; None:
    it has all.
    """

    xy: Array
    z: Array
    ok: np.ndarray
    place: np.ndarray | None = None
    counts: np.ndarray | None = None
    tried: np.ndarray | None = None


def accuracy(errors: Errors | None, n_ok: ArrayLike, n_fixes: ArrayLike) -> dict[str, float]:
    """The columns of the summary that count fixes, with their 95 % intervals, from every fix;
    without them availability alone, from the numbers of fixes (N,) of the replications.

    Quantiles are over the fixes with a position; shares are of all fixes.
    """
    if errors is None:
        ok, all_ = (np.asarray(n, dtype=float)[:, None] for n in (n_ok, n_fixes))
        return _share("availability", ok, all_, None)
    place, counts = errors.place, errors.counts
    tried = np.ones(errors.ok.shape, dtype=bool) if errors.tried is None else errors.tried
    all_ = intervals.by_replication(tried, counts)
    hits = {"availability": errors.ok}
    hits |= {f"p_within_{limit}m": errors.xy <= limit for limit in WITHIN_M}
    found: dict[str, float] = {}
    for name, some in hits.items():
        found |= _share(name, intervals.by_replication(some, counts), all_, place)
    for columns, error in ((CEP, errors.xy), (ERROR_Z, np.abs(errors.z))):
        known = error[np.isfinite(error)]
        if len(known):
            each = intervals.cep_intervals(error, list(columns.values()), place, counts=counts)
            for (name, probability), ends in zip(columns.items(), each):
                found |= _three(name, float(np.quantile(known, probability)), ends)
    return found


def _share(name: str, hits: Array, tries: Array, place: np.ndarray | None) -> dict[str, float]:
    if not tries.sum() > 0:
        return {}
    value = float(hits.sum() / tries.sum())
    return _three(name, value, intervals.share_interval(hits, tries, place))


def _three(name: str, value: float, ends: Interval) -> dict[str, float]:
    return {name: value, f"{name}_low": ends[0], f"{name}_high": ends[1]}
