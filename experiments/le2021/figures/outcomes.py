"""Table I: what becomes of the iterations."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from aoabench.maths.estimate import Estimate
from aoabench.report.plots import PAGE, error_bars, new

from .common import NAMES, STYLES, read

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def table1(frame: pd.DataFrame) -> Figure:
    """Shares, errors and iterations of the classes over all deviations [Le 2021, Table I]."""
    figure, axes = new(PAGE, 2.6, cols=3, sharey=True)
    rows = frame[frame["sigma_deg"].isna()]
    labels = [f"{NAMES[r['estimator']]}: {r['class']}" for r in rows.to_dict("records")]
    colours = [STYLES[name]["color"] for name in rows["estimator"]]
    y = -np.arange(len(rows))
    for axis, (column, label) in zip(
        axes,
        (
            ("share", "share of the fixes [%]"),
            ("rmse_m", "RMSE, and median (bar) [m]"),
            ("iterations", "iterations"),
        ),
    ):
        scale = 100 if column == "share" else 1
        bars = scale * error_bars(rows, column, "rmse_se" if column == "rmse_m" else "", log=True)
        for i in range(len(rows)):
            value = scale * rows[column].iloc[i]
            if value > 0:
                axis.errorbar(
                    value,
                    y[i],
                    xerr=np.nan_to_num(bars[:, i : i + 1]),
                    fmt="o",
                    color=colours[i],
                    capsize=2,
                )
        if column == "rmse_m":
            axis.scatter(rows["median_m"], y, marker="|", s=60, color=colours, linewidths=1.5)
        axis.set(xscale="log", xlabel=label)
    axes[0].set_yticks(y, labels)
    return figure


def table1_values(frame: pd.DataFrame) -> dict[str, Estimate]:
    """Over all deviations: iterations (mean and most) and share of each class, and its error over
    that of the converged fixes: of the RMSEs, with these fixes' errors capped, of the medians.
    """
    found = {}
    for r in frame[frame["sigma_deg"].isna()].to_dict("records"):
        key = f"table1/{r['estimator']}/{r['class']}"
        found[f"{key}/share"] = read(r, "share").percent()
        if not r["fixes"]:
            continue
        found[f"{key}/iterations"] = read(r, "iterations")
        found[f"{key}/most"] = Estimate(r["most_iterations"], 0.0)
        if r["class"] != "convergence":
            found[f"{key}/rmse"] = read(r, "over_converged")
            found[f"{key}/capped"] = read(r, "over_capped")
            found[f"{key}/median"] = read(r, "over_median")
    return found
