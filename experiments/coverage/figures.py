"""Coverage: figures and tables, each a function of an item's table alone."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from aoabench.report.plots import GREY, PAGE, new

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LEFT = 60.0  # per cent, where the axis begins; what lies below is drawn there
QUANTITIES = ("pooled RMSE", "mean RMSE", "median", "change")


def coverage(frame: pd.DataFrame) -> Figure:
    """Coverage of the 95 % intervals, a panel per quantity and a row per estimator and size."""
    rows = _labels(frame)
    labels = list(dict.fromkeys(rows["label"]))[::-1]
    height = 1.2 + 0.19 * len(labels)
    figure, axes = new(PAGE, height, cols=len(QUANTITIES), sharey=True, sharex=True, squeeze=False)
    for axis, quantity in zip(axes[0], QUANTITIES):
        some = rows[rows["quantity"] == quantity]
        at = np.array([labels.index(label) for label in some["label"]])
        _panel(axis, some, at)
        axis.axvline(95, color="black", lw=0.8, ls=":")
        axis.set(title=quantity, xlabel="coverage [%]", xlim=(LEFT - 2, 101))
    axes[0, 0].set_yticks(range(len(labels)), labels)
    axes[0, 0].set_ylim(-0.7, len(labels) - 0.3)
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


def _panel(axis: Any, rows: pd.DataFrame, at: np.ndarray) -> None:
    """The coverage of one quantity at the heights `at` (N,)."""
    every, some = 100 * rows["coverage"], 100 * rows["unflagged"]
    axis.plot(every.clip(LEFT), at, "o", ms=5, mfc="none", mec=GREY, mew=0.7, label="all runs")
    symmetric = (100 * rows["symmetric"]).clip(LEFT)
    axis.plot(symmetric, at, "x", ms=3.5, color="#D55E00", mew=0.8, label="± 1.96 s.e.")
    ends = [100 * rows[f"unflagged_{end}"].to_numpy() for end in ("low", "high")]
    shown = some.clip(LEFT).to_numpy()
    bars = [np.maximum(shown - np.clip(ends[0], LEFT, None), 0), np.maximum(ends[1] - shown, 0)]
    look = {"fmt": "o", "ms": 2.5, "color": "black", "elinewidth": 0.8, "capsize": 1.5}
    axis.errorbar(shown, at, xerr=bars, label="runs not flagged", **look)


def _labels(frame: pd.DataFrame) -> pd.DataFrame:
    """The rows with a label of estimator, size and share of flagged runs."""

    def label(row: Any) -> str:
        place = f", {row.positions} positions" if row.positions >= 0 else ""
        where = f", {row.setting}" if row.setting else ""
        flagged = f"{100 * row.flagged:.3g} % flagged"
        return f"{row.estimator}{where}, N = {row.replications}{place}: {flagged}"

    return frame.assign(label=[label(row) for row in frame.itertuples()])


def coverage_table(frame: pd.DataFrame) -> pd.DataFrame:
    """Coverage as texts."""

    def share(row: dict[str, Any], name: str) -> str:
        ends = 100 * row[f"{name}_low"], 100 * row[f"{name}_high"]
        return (
            f"{100 * row[name]:.1f} [{ends[0]:.1f}, {ends[1]:.1f}]" if row[f"{name}_runs"] else "-"
        )

    rows = frame.to_dict("records")
    return pd.DataFrame(
        {
            "setting": frame["setting"],
            "estimator": frame["estimator"],
            "positions": [str(n) if n >= 0 else "" for n in frame["positions"]],
            "N": frame["replications"].astype(str),
            "quantity": frame["quantity"],
            "runs": frame["coverage_runs"].astype(str),
            "flagged [%]": [f"{100 * share:.1f}" for share in frame["flagged"]],
            "coverage [%], runs not flagged": [share(row, "unflagged") for row in rows],
            "all runs [%]": [share(row, "coverage") for row in rows],
            "± 1.96 s.e. [%]": [f"{100 * v:.1f}" if v == v else "-" for v in frame["symmetric"]],
        }
    )


square_track = corridor = bs_grid = room = coverage
square_track_table = corridor_table = bs_grid_table = room_table = coverage_table
