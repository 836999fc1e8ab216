"""The time that each method takes for a fix."""

from __future__ import annotations

import time

import numpy as np
import pandas as pd

from aoabench.config.compose import compose_cells
from aoabench.engine.draws import Draws
from aoabench.engine.tiles import estimate_tile

from .common import METHODS


def speed(scale: str) -> pd.DataFrame:
    """Time per fix of every method on this machine, serially: median of several passes over the
    same campaigns.
    """
    names = [*METHODS, "discrepancy", "discrepancy_exact"]
    cell = compose_cells(
        ["scenario=ble_room", "noise=ble_multipath", f"estimator=[{','.join(names)}]"]
    )[0]
    draws, rows = Draws(cell.scenario, cell.noise, cell.seed), []
    for name, estimator in cell.estimators.items():
        seconds = []
        for _ in range(4 if scale == "quick" else 12):
            draws.tile(0, 8)
            begin = time.perf_counter()
            truth, _ = estimate_tile(draws, estimator, 0)
            seconds.append((time.perf_counter() - begin) / (truth.shape[0] * truth.shape[1]))
        q = np.quantile(seconds[1:], [0.25, 0.5, 0.75])
        se = 1.2533 * (q[2] - q[0]) / 1.349 / np.sqrt(len(seconds) - 1)
        rows.append({"method": name, "us_per_fix": 1e6 * q[1], "us_se": 1e6 * se})
    return pd.DataFrame(rows)
