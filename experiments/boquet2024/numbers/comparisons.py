"""Paired comparisons over campaigns: methods, thresholds, boxes against ellipses, errata."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from aoabench.cell import Cell
from aoabench.engine.draws import Draws
from aoabench.engine.tiles import estimate_tile, tile_of
from aoabench.maths import statistics
from aoabench.store.fixes import Fixes
from aoabench.types import Estimates, Outcome

from .common import (
    METHODS,
    SCORED,
    Runs,
    columns,
    difference,
    error,
    filters,
    lost,
    only,
    rmse,
    within,
)

MOVED_M = 1e-4  # positions further apart than this are different fixes


def ranking(runs: Runs) -> pd.DataFrame:
    """P(error <= 1 m) of each method minus that of others, paired over campaigns.

    `at`: `all` (each on its own fixes), `accepted` (both on the fixes that the filter gives),
    `coverage` (the method rejects the fixes of the worst score until it gives as many as the
    filter).
    """
    _, fixes = only(runs)
    errors = {m: error(fixes[m]) for m in METHODS}
    rows = []
    for r, f in filters(fixes).items():
        e, name = error(f), f"df {r:g}"
        accepted = np.isfinite(e)
        for m, other in errors.items():
            rows.append(_more("all", name, m, e, other))
            rows.append(_more("accepted", name, m, e, np.where(accepted, other, np.nan)))
            if m in SCORED:
                as_many = thresholded(fixes[m], accepted.mean())
                rows.append(_more("coverage", name, m, e, as_many))
    for m, other in itertools.permutations(METHODS, 2):
        rows.append(_more("all", m, other, errors[m], errors[other]))
    return pd.DataFrame(rows)


def _more(at: str, method: str, other: str, a: np.ndarray, b: np.ndarray) -> dict[str, Any]:
    """A row of `ranking` from the errors of both methods (R, T)."""
    share, more = np.isfinite(a).mean(), difference(a, b)
    return {"at": at, "method": method, "other": other, **columns(more=more), "coverage": share}


def thresholded(f: Fixes, coverage: float) -> np.ndarray:
    """Errors (R, T) m of a method that rejects its fixes with the worst scores (NaN), so that the
    share `coverage` of all fixes remains.

    A fix without a score (one anchor alone) counts as the worst, as no other anchor confirms it.
    """
    e = error(f)
    score = np.where(np.isfinite(f.score), f.score, np.inf)
    score = np.where(np.isfinite(e), score, np.nan)
    known = score[np.isfinite(e)]
    last = max(min(round(coverage * e.size), len(known)) - 1, 0)
    return np.where(score <= np.partition(known, last)[last], e, np.nan)


def rejection(runs: Runs) -> pd.DataFrame:
    """P(error <= 1 m) and RMSE against coverage: scores thresholded, and the discrepancy filter's
    R_sigma sweep.
    """
    _, fixes = only(runs)
    rows = []
    for m in METHODS:
        if m not in SCORED:
            rows.append(covered(m, error(fixes[m])))
            continue
        for coverage in np.round(np.arange(0.1, 1.01, 0.05), 2):
            rows.append(covered(m, thresholded(fixes[m], coverage)))
    for kind in ("boxes", "exact"):
        for r, f in filters(fixes, kind).items():
            rows.append(covered(f"df {kind}", error(f), r))
    return pd.DataFrame(rows)


def covered(method: str, e: np.ndarray, r_sigma: float = np.nan) -> dict[str, Any]:
    """A row of `rejection` from errors (R, T), NaN where the method rejects."""
    shares = columns(coverage=statistics.mean(np.isfinite(e).mean(axis=1)), within_1m=within(e))
    return {
        "method": method,
        "r_sigma": r_sigma,
        **shares,
        **rmse(e).columns("rmse_m", "rmse_se"),
    }


def boxes(runs: Runs) -> pd.DataFrame:
    """Boxes against exact ellipses per R_sigma: shares of the packets for which the sets of anchors
    differ (none, where a fix is rejected), and the positions; P(error <= 1 m), R_d and RMSE of
    both.
    """
    cell, fixes = only(runs)
    exact, all_boxes = filters(fixes, "exact"), filters(fixes)
    both = {r: (f, exact[r]) for r, f in all_boxes.items() if r in exact}
    names = {r: [f"df_{kind}_{round(10 * r):02d}" for kind in ("boxes", "exact")] for r in both}
    different = unlike(cell, list(names.values()), len(next(iter(exact.values())).outcome))
    rows = []
    for (r, (f, g)), (other, moved) in zip(both.items(), different):
        values = {
            "other_set": statistics.mean(other.mean(axis=1)),
            "other_position": statistics.mean(moved.mean(axis=1)),
        }
        for kind, h in (("boxes", f), ("exact", g)):
            values |= {
                f"within_1m_{kind}": within(error(h)),
                f"lost_{kind}": lost(h),
                f"rmse_{kind}_m": rmse(error(h)),
            }
        values["more"] = difference(error(g), error(f))
        rows.append({"r_sigma": r, **columns(**values)})
    return pd.DataFrame(rows)


def unlike(
    cell: Cell, pairs: Sequence[Sequence[str]], count: int
) -> list[tuple[np.ndarray, np.ndarray]]:
    """For each pair of discrepancy filters of a cell, whether both fuse different sets of anchors,
    and whether they give different positions, both (count, T), in the first `count` replications.
    """
    draws = Draws(cell.scenario, cell.noise, cell.seed)
    found: list[list[tuple[np.ndarray, np.ndarray]]] = [[] for _ in pairs]
    for first in range(0, count, tile_of(cell.estimators[pairs[0][0]], cell.scenario)):
        for pair, parts in zip(pairs, found):
            a, b = (estimate_tile(draws, cell.estimators[name], first)[1] for name in pair)
            parts.append(unlike_sets(a, b))
    return [
        (np.concatenate(sets)[:count], np.concatenate(positions)[:count])
        for sets, positions in (zip(*parts) for parts in found)
    ]


def unlike_sets(a: Estimates, b: Estimates) -> tuple[np.ndarray, np.ndarray]:
    """Whether the sets of anchors behind the fixes of two filters of equal deviations differ, and
    whether the positions do, both (R, T).

    The covariance (21) of a fix is that of its set: equal sets have equal ones, and no two sets of
    different ellipses do.
    """
    same = np.isclose(a.covariance, b.covariance, rtol=1e-9, atol=1e-15, equal_nan=True)
    rejected = [e.outcome == Outcome.REJECTED for e in (a, b)]
    sets = ~same.all(axis=(-1, -2)) | (rejected[0] != rejected[1])
    away = np.linalg.norm((a.position - b.position)[..., :2], axis=-1)
    return sets, (rejected[0] != rejected[1]) | (away > MOVED_M)


def errata(runs: Runs) -> pd.DataFrame:
    """The effect of each erratum alone at R_sigma = 1, in percentage points.

    `more` is P(error <= 1 m) with the erratum corrected minus as the paper ran it; `moved` is the
    share of the packets whose fix changes.
    """
    _, fixes = only(runs)
    ran = filters(fixes)[1.0]
    rows = []
    for name in ("df_area_of_ties", "df_centre_of_estimate"):
        f = fixes[name]
        moved = (np.abs(error(ran) - error(f)) > MOVED_M) | (ran.outcome != f.outcome)
        more, share = difference(error(f), error(ran)), statistics.mean(moved.mean(axis=1))
        rows.append({"variant": name, **columns(more=more.percent(), moved=share.percent())})
    return pd.DataFrame(rows)
