"""What the paper leaves open, and how much that matters to its methods."""

from __future__ import annotations

from itertools import product

import numpy as np
import pandas as pd

from aoabench.cell import Cell
from aoabench.engine import metrics
from aoabench.maths import intervals, statistics

from .common import METHODS, SETTINGS, cell_of, estimated
from .trials import DIVERGED_M

LEVEL = 0.997  # of intervals


def readings(scale: str) -> pd.DataFrame:
    """Per setting, kind of error, uncertainty and method: median RMSE of the trials in space and
    height; the share of trials in which it is above the centroid's; its median excess over the
    centroid's in the same trial in percent, with the distribution-free interval (LEVEL); and the
    rate of divergence.
    """
    trials = {"quick": 8, "paper": 64}[scale]
    rows = []
    for setting, kind, sigma in product(SETTINGS, ("independent", "common"), (0.5, 5.0)):
        words = (f"noise.an_error={kind}", f"noise.an_sigma_m={sigma}")
        found = trial_rmses(cell_of(*SETTINGS[setting], *words), trials)
        for name in METHODS:
            row = {"setting": setting, "an_error": kind, "an_sigma_m": sigma, "estimator": name}
            diverged = int((found[name]["3d"] > DIVERGED_M).sum())
            row |= {"trials": trials} | statistics.rate(diverged, trials).columns("diverged")
            for part in ("3d", "z"):
                row |= _numbers(found[name][part], found["wcg"][part], part)
            rows.append(row)
    return pd.DataFrame(rows)


def _numbers(rmse: np.ndarray, centroid: np.ndarray, part: str) -> dict[str, float]:
    """Columns of a method's RMSEs (trials,) beside those of the centroid in the same trials."""
    excess = 100 * (rmse / centroid - 1)
    low, high = intervals.quantile_interval(excess, 0.5, LEVEL)
    return (
        statistics.quantile(rmse, 0.5).columns(f"median_{part}")
        | statistics.rate(int((rmse > centroid).sum()), len(rmse)).columns(f"worse_{part}")
        | statistics.quantile(excess, 0.5).columns(f"excess_{part}")
        | {f"excess_{part}_low": low, f"excess_{part}_high": high}
    )


def trial_rmses(cell: Cell, trials: int) -> dict[str, dict[str, np.ndarray]]:
    """RMSE in m of each trial (trials,), in space (3d) and in height (z), by method."""
    found: dict[str, list[dict[str, np.ndarray]]] = {name: [] for name in cell.estimators}
    for name, truth, estimates in estimated(cell, trials):
        found[name].append(metrics.per_replication(estimates, truth[..., :3]))
    return {
        name: {
            part: np.concatenate([tile[f"rmse_{part}_m"] for tile in tiles]) for part in ("3d", "z")
        }
        for name, tiles in found.items()
    }
