"""Names, styles and curves."""

from __future__ import annotations

from typing import Any

import pandas as pd

from aoabench.maths.estimate import Estimate, stored
from aoabench.report.plots import GREY, error_bars

NAMES = {
    "ls": "(a) least squares",
    "ml_arctan": "(b) ML, arctan",
    "ml_atan2": "(c) ML, atan2",
    "ml_kcorr": "(d) ML, atan2, corrected",
}
OTHERS = {  # not in the paper
    "ls_lines": "lines, least squares",
    "ls_anchor_discarding": "lines, anchors discarded",
    "vmf_ml": "ML, unit vectors",
    "robust_ml": "ML, Student's loss",
}
STYLES = {
    "ls": {"color": GREY, "marker": "v", "ls": "-."},
    "ml_arctan": {"color": "#D55E00", "marker": "s", "ls": ":"},
    "ml_atan2": {"color": "#E69F00", "marker": "D", "ls": "--"},
    "ml_kcorr": {"color": "#0072B2", "marker": "o", "ls": "-"},
    "ls_lines": {"color": "#56B4E9", "marker": "<", "ls": "-."},
    "ls_anchor_discarding": {"color": "#CC79A7", "marker": ">", "ls": ":"},
    "vmf_ml": {"color": "#009E73", "marker": "^", "ls": "-"},
    "robust_ml": {"color": "black", "marker": "x", "ls": "--"},
}
SIGMA = "deviation of the angles [deg]"


def curve(axis: Any, rows: pd.DataFrame, x: str, y: str, se: str, **style: Any) -> None:
    """Draw a column against another with error bars."""
    bars = error_bars(rows, y, se, log=True)
    axis.errorbar(rows[x], rows[y], yerr=bars, capsize=2, elinewidth=0.8, **style)


def of(frame: pd.DataFrame, name: str) -> pd.DataFrame:
    """Rows of an estimator in the order of the deviation."""
    return frame[frame["estimator"] == name].sort_values("sigma_deg")


def read(row: dict[str, Any], column: str, se: str = "") -> Estimate:
    """The number in a column; its standard error is in the column `se` (default COLUMN_se)."""
    return stored(row, column, se)
