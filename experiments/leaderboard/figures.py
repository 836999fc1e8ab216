"""Leaderboard: figures and tables, each a function of an item's table alone."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pandas as pd

from aoabench.report.plots import PAGE, log_bars, new
from aoabench.report.text import number_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def board(frame: pd.DataFrame) -> Figure:
    """RMSE with three standard errors of each estimator, a panel per setting, in the order of the
    first setting, the best on top.
    """
    settings = list(frame["setting"].unique())
    names = list(frame[frame["setting"] == settings[0]]["estimator"])[::-1]
    height = 0.9 + 0.16 * len(names)
    figure, axes = new(PAGE, height, cols=len(settings), sharey=True, sharex=True, squeeze=False)
    for axis, setting in zip(axes[0], settings):
        rows = frame[frame["setting"] == setting].set_index("estimator").loc[names]
        bars = log_bars(rows["rmse_m"], rows["rmse_se"])
        look = {"fmt": "o", "ms": 3, "capsize": 2, "elinewidth": 0.8}
        axis.errorbar(rows["rmse_m"], range(len(names)), xerr=bars, **look)
        axis.axvline(rows["rmse_m"].min(), color="black", lw=0.8, ls=":")
        axis.set(xscale="log", title=setting, xlabel=f"{frame['metric'].iloc[0]} RMSE [m]")
    axes[0, 0].set_yticks(range(len(names)), names)
    return figure


def board_table(frame: pd.DataFrame) -> pd.DataFrame:
    """The ranking as texts."""
    return pd.DataFrame(
        {
            "setting": frame["setting"],
            "rank": frame["rank"].astype(str),
            "estimator": frame["estimator"],
            "RMSE ± s.e. [m]": [
                number_text(v, s) for v, s in zip(frame["rmse_m"], frame["rmse_se"])
            ],
            "above the best [%], 95 % interval": [_interval(r) for r in frame.to_dict("records")],
            "fixes ok": [f"{100 * share:.4g} %" for share in frame["share_ok"]],
        }
    )


def _interval(row: dict[str, float]) -> str:
    if row["rank"] == 1:
        return "best"
    if row["above_se"] != row["above_se"]:
        return "-"
    digits = 0 if row["above_se"] >= 1 else 1 if row["above_se"] >= 0.1 else 3
    numbers = (f"{row[key]:.{digits}f}" for key in ("above_percent", "above_low", "above_high"))
    return "{} [{}, {}]".format(*numbers)


square_track = bs_grid = indoor_map = ble_room = board
square_track_table = bs_grid_table = indoor_map_table = ble_room_table = board_table
