"""Leaderboard: figures and tables, each a function of an item's table alone."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pandas as pd

from aoabench.maths.estimate import stored
from aoabench.report.plots import BOUND, BOUND_LABEL, PAGE, error_bars, new
from aoabench.report.text import interval_text, significant

if TYPE_CHECKING:
    from matplotlib.figure import Figure

KINDS = {
    "filter": ("#0072B2", "filter: knows motion and earlier steps"),
    "snapshot": ("#E69F00", "snapshot: each fix alone"),
    "limit": ("#BBBBBB", "limit: sees the truth"),
}
HEAVY = "heavy tail: compare medians"
MOST = 8.0  # no axis ends beyond so many times the best RMSE


def board(frame: pd.DataFrame) -> Figure:
    """A bar of the RMSE with three standard errors for each estimator, marks at 50 % and 95 % of
    its errors, its share of ok fixes and the bound; a panel per setting, in the order of the first.
    """
    settings = list(frame["setting"].unique())
    names = list(frame[frame["setting"] == settings[0]]["estimator"])[::-1]
    height = 1.2 + 0.2 * len(names)
    figure, axes = new(PAGE, height, cols=len(settings), sharey=True, squeeze=False)
    for axis, setting in zip(axes[0], settings):
        rows = frame[frame["setting"] == setting].set_index("estimator").loc[names]
        _panel(axis, rows)
        axis.set_title(setting, loc="left")
        axis.set_xlabel(f"{frame['metric'].iloc[0]} error [m]")
    axes[0, 0].set_yticks(range(len(names)), names)
    kinds = [kind for kind in KINDS if kind in set(frame["kind"])]
    bounded = bool(frame["bound_m"].notna().any())
    figure.legend(
        handles=_legend(kinds, bounded, any(_heavy(frame))), loc="outside upper center", ncols=3
    )
    return figure


def _panel(axis: Any, rows: pd.DataFrame) -> None:
    """Draw the estimators of one setting."""
    end = _end(rows)
    colours = [KINDS[kind][0] for kind in rows["kind"]]
    y = range(len(rows))
    seen = rows["rmse_m"].where(rows["rmse_m"] <= end)
    drawn = axis.barh(y, rows["rmse_m"].clip(upper=end), height=0.7, color=colours)
    for bar, heavy in zip(drawn, _heavy(rows)):
        bar.set(hatch="////" if heavy else "", edgecolor="white", linewidth=0)
    bars = error_bars(rows, "rmse_m", "rmse_se")
    axis.errorbar(seen, y, xerr=bars, fmt="none", ecolor="black", elinewidth=0.8)
    for column, marker in (("error_q50_m", "|"), ("error_q95_m", "d")):
        axis.plot(rows[column].where(rows[column] <= end), y, marker, color="black", ms=4)
    for i, r in zip(y, rows.to_dict("records")):
        if r["rmse_m"] > end:
            at = {"xytext": (-3, 0), "textcoords": "offset points", "color": "black"}
            text = f"{significant(r['rmse_m'], 3)} m \u2192"
            axis.annotate(text, (end, i), ha="right", va="center", fontsize=6.5, **at)
        share = f"{100 * r['share_ok']:.3g} %"
        axis.annotate(
            share, (1.02, i), xycoords=("axes fraction", "data"), va="center", fontsize=6.5
        )
    axis.annotate("ok", (1.02, len(rows) - 0.4), xycoords=("axes fraction", "data"), fontsize=6.5)
    if rows["bound_m"].notna().any():
        axis.axvline(rows["bound_m"].iloc[0], **BOUND)
    axis.set(xlim=(0, end), ylim=(-0.6, len(rows) - 0.4))
    axis.grid(visible=False, axis="y")


def _heavy(frame: pd.DataFrame) -> list[bool]:
    """Whether few errors decide the RMSE, by row."""
    return list(frame["heavy_tail"]) if "heavy_tail" in frame else [False] * len(frame)


def _end(rows: pd.DataFrame) -> float:
    """End of a panel's axis in m: beyond all RMSEs and quantiles up to MOST times the best RMSE."""
    most = MOST * rows[rows["kind"] != "limit"]["rmse_m"].min()
    values = rows[["rmse_m", "error_q95_m"]]
    return 1.05 * float(values[values <= most].max().max())


def _legend(kinds: list[str], bounded: bool, heavy: bool) -> list[Any]:
    """Handles for the kinds of estimators and for the marks."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    bars = [Patch(color=KINDS[kind][0], label=f"RMSE, {KINDS[kind][1]}") for kind in kinds]
    marks = [("|", "50 % of the errors"), ("d", "95 % of the errors")]
    points = [Line2D([], [], color="black", ls="", marker=m, label=text) for m, text in marks]
    lines = [Line2D([], [], label=BOUND_LABEL, **BOUND)] if bounded else []
    hatched = Patch(facecolor="#888888", edgecolor="white", hatch="////", label=HEAVY)
    return [*bars, *points, *lines, *[hatched] * heavy]


def board_table(frame: pd.DataFrame) -> pd.DataFrame:
    """The ranking as texts; tables of before 2026-11-28 do not say which tails are heavy."""
    each = frame.to_dict("records")
    return pd.DataFrame(
        {
            "setting": frame["setting"],
            "rank": ["limit" if r["kind"] == "limit" else str(r["rank"]) for r in each],
            "estimator": frame["estimator"],
            "RMSE [m], 95 % interval": [_rmse(r) for r in each],
            "50 %, 95 % of the errors [m]": [
                f"{r['error_q50_m']:.3g}, {r['error_q95_m']:.3g}" for r in each
            ],
            "above the best [%], 95 % interval": [_interval(r) for r in each],
            "fixes ok": [f"{100 * share:.4g} %" for share in frame["share_ok"]],
        }
    )


def _rmse(row: dict[str, Any]) -> str:
    low, high = stored(row, "rmse_m", "rmse_se").interval()
    heavy = ", heavy tail" if row.get("heavy_tail") else ""
    return interval_text(row["rmse_m"], low, high) + heavy


def _interval(row: dict[str, Any]) -> str:
    if row["estimator"] == row["best"]:
        return "best"
    if row["above_se"] != row["above_se"]:
        return "-"
    digits = 0 if row["above_se"] >= 1 else 1 if row["above_se"] >= 0.1 else 3
    numbers = (f"{row[key]:.{digits}f}" for key in ("above_percent", "above_low", "above_high"))
    return "{} [{}, {}]".format(*numbers)


square_track = bs_grid = indoor_map = ble_room = board
square_track_table = bs_grid_table = indoor_map_table = ble_room_table = board_table
