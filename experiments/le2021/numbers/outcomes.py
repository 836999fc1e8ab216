"""Table I: what becomes of the iterations."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from aoabench.maths import statistics
from aoabench.maths.estimate import Estimate
from aoabench.store.fixes import Fixes
from aoabench.types import Outcome

from .common import CLASSES, Runs, capped, deviation_deg, iterated, median, median_ratio

FEW = 10  # positions; a class with fewer gets no standard error


def table1(runs: Runs) -> pd.DataFrame:
    """Per estimator and class: shares, errors and iterations, over all deviations (sigma_deg NaN)
    and for each deviation.
    """
    kept: dict[tuple[str, float], Fixes] = {}
    for cell, fixes in runs:
        kept |= {(name, deviation_deg(cell)): f for name, f in fixes.items() if name != "ls"}
    rows = []
    for name in dict.fromkeys(name for name, _ in kept):
        each = {sigma: [f] for (other, sigma), f in kept.items() if other == name}
        for sigma, some in {np.nan: [f for one in each.values() for f in one], **each}.items():
            rows += classes(name, sigma, some)
    return pd.DataFrame(rows)


def classes(name: str, sigma_deg: float, some: list[Fixes]) -> list[dict[str, Any]]:
    """A row for each class of an estimator's fixes; standard errors over positions (of medians by
    jackknife).
    """
    error, iterations = (
        np.concatenate([getattr(f, field) for f in some]) for field in ("error_3d_m", "iterations")
    )
    outcome, error = np.concatenate([iterated(f) for f in some]), error.astype(float)
    rows = []
    for word, value in CLASSES.items():
        member = outcome == value
        n = member.sum(axis=0)
        row = {"estimator": name, "sigma_deg": sigma_deg, "class": word, "fixes": int(n.sum())}
        row |= statistics.ratio(n, np.full(len(n), len(member))).columns("share")
        if n.sum():
            row |= statistics.ratio(_sums(member, error**2), n).root().columns("rmse_m", "rmse_se")
            row |= median(error, member).columns("median_m", "median_se")
            row |= statistics.ratio(_sums(member, iterations), n).columns("iterations")
            row |= {"most_iterations": float(iterations[member].max())}
            row |= over_converged(error, member, outcome == Outcome.OK)
            if (n > 0).sum() < FEW:
                row |= {key: np.nan for key in row if key.endswith("_se")}
        rows.append(row)
    return rows


def _sums(member: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Sums (P,) of the members' values (R, P) at each position."""
    return np.where(member, values, 0.0).sum(axis=0, dtype=float)


def over_converged(
    error: np.ndarray, member: np.ndarray, converged: np.ndarray
) -> dict[str, float]:
    """Columns of a class's error over that of the converged fixes: of the RMSEs, of the RMSEs with
    the converged fixes' errors capped (at least the former) and of the medians.
    """
    own, other = error**2, capped(error) ** 2
    row = class_ratio(own, member, own, converged).columns("over_converged")
    row |= class_ratio(own, member, other, converged).columns("over_capped")
    mine, theirs = (np.where(some, error, np.nan) for some in (member, converged))
    return row | median_ratio(mine, theirs).columns("over_median")


def class_ratio(
    square: np.ndarray, member: np.ndarray, other: np.ndarray, converged: np.ndarray
) -> Estimate:
    """Ratio of the members' RMSE to that of the converged fixes, from squared errors (R, P)."""
    return statistics.ratio_of_ratios(
        _sums(member, square), member.sum(axis=0), _sums(converged, other), converged.sum(axis=0)
    ).root()
