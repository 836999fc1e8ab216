"""Names, styles and pieces that the figures share."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from aoabench import resources
from aoabench.maths.estimate import Estimate, stored
from aoabench.report.plots import error_bars

NAMES = {
    "single_anchor_1": "A1",
    "single_anchor_2": "A2",
    "single_anchor_3": "A3",
    "best_anchor": "A best",
    "rssi_anchor": "A rssi",
    "anchor_mean": "M avg",
    "ls_lines": "M LS",
    "ls_anchor_discarding": "M IAD",
    "vmf_ml": "M vMF",
    "discrepancy": "DF",
}
STYLES = {
    "single_anchor_1": {"color": "#0072B2", "ls": "-"},
    "single_anchor_2": {"color": "#0072B2", "ls": "--"},
    "single_anchor_3": {"color": "#0072B2", "ls": ":"},
    "best_anchor": {"color": "#56B4E9", "ls": "-"},
    "rssi_anchor": {"color": "#56B4E9", "ls": "--"},
    "anchor_mean": {"color": "#E69F00", "ls": "-"},
    "ls_lines": {"color": "#E69F00", "ls": "--"},
    "ls_anchor_discarding": {"color": "#E69F00", "ls": ":"},
    "vmf_ml": {"color": "#009E73", "ls": "-"},
    "discrepancy": {"color": "#D55E00", "ls": "-"},
}
DF = {"color": "#D55E00", "marker": "o", "ms": 3}
PRINTED = {"color": "black", "marker": "*", "ls": "", "ms": 8, "label": "printed"}
ERROR = "horizontal error [m]"
CONFIDENCE = 0.997  # of the intervals of dot plots, as of the verdicts
LIMIT = "P(error ≤ 1 m)"
printed = resources.printed("boquet2024")
PRINTED_AT = (0.4, 2.0)  # R_sigma at which the paper prints numbers of the filter


def estimate(row: Any, key: str) -> Estimate:
    """A number of a table's row with its standard error, column KEY_se."""
    return stored(row, key)


def points(
    axis: Any, x: pd.Series, rows: pd.DataFrame, key: str, scale: float = 1, **style: Any
) -> None:
    """Draw a column against x with error bars."""
    axis.errorbar(x, scale * rows[key], yerr=scale * error_bars(rows, key), **style)


def intervals(
    axis: Any, rows: pd.DataFrame, key: str, y: np.ndarray, scale: float = 1, **style: Any
) -> None:
    """Draw a column as horizontal points with intervals at the level of the verdicts."""
    bars = scale * error_bars(rows, key, confidence=CONFIDENCE)
    axis.errorbar(scale * rows[key].to_numpy(), y, xerr=bars, **style)


def raster(axis: Any, rows: pd.DataFrame, values: np.ndarray, **style: Any) -> Any:
    """Draw values at the points of a square raster as an image, which is returned."""
    x, y = np.unique(rows["x_m"]), np.unique(rows["y_m"])
    grid = np.full((len(y), len(x)), np.nan)
    grid[np.searchsorted(y, rows["y_m"]), np.searchsorted(x, rows["x_m"])] = values
    half = (x[1] - x[0]) / 2
    extent = (x[0] - half, x[-1] + half, y[0] - half, y[-1] + half)
    return axis.imshow(grid, origin="lower", extent=extent, interpolation="nearest", **style)
