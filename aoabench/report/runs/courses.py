"""Errors over time, and pairs of replications."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from aoabench.report import plots
from aoabench.report.runs import look
from aoabench.report.runs.look import Words
from aoabench.store.comparison import rounded

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

_MOST_VECTORS = 5000  # points that a PDF or SVG holds one by one


def time(courses: pd.DataFrame, words: Words) -> Figure:
    """Draw the median error over the steps, with the band from the 5 to the 95 % quantile (see
    `values.courses`); of a recording the error of each track.
    """
    made = look.sheet(courses, words)
    log = look.spans_decades(courses["median"].quantile([0.05, 0.95]).to_numpy())
    for panel, group, mine in look.groups_of(courses):
        style = made.style(group) | {"marker": None}
        for i, (_, track) in enumerate(mine.groupby("track", sort=False)):
            label = group if i == 0 else None
            made.axes[panel].plot(track["x"], track["median"], label=label, linewidth=1, **style)
            if (track["n"] > 1).any():
                made.axes[panel].fill_between(
                    track["x"],
                    track["low"],
                    track["high"],
                    color=style["color"],
                    alpha=0.15,
                    linewidth=0,
                )
    for axis in made.axes.values():
        axis.margins(x=0.01)
        look.scale(axis, "y", log, courses[["median", "low", "high"]])
    if not log:
        next(iter(made.axes.values())).set_ylim(bottom=0)
    look.legend(made, words.by)
    return made.figure


def pairs(points: pd.DataFrame, rows: pd.DataFrame, words: Words) -> Figure:
    """Draw each replication's metric for two estimators (see `values.paired`): below the diagonal
    the other estimator's value is smaller than the baseline's.
    """
    made = look.sheet(rows, words, height=2.2, groups=False)
    log = look.spans_decades(points[["x", "y"]].to_numpy(dtype=float))
    ends = _ends(points, log)
    for row in rows.to_dict("records"):
        axis = made.axes[row["panel"]]
        mine = points[points["panel"] == row["panel"]]
        many = len(mine) > _MOST_VECTORS
        axis.scatter(
            mine["x"], mine["y"], s=8, alpha=0.5, linewidths=0, color="C0", rasterized=many
        )
        look.scale(axis, "x", log, ends)
        look.scale(axis, "y", log, ends)
        axis.set(xlim=ends, ylim=ends, box_aspect=1)
        axis.plot(ends, ends, color=plots.GREY, linewidth=0.8, zorder=0)
        axis.annotate(words_of(row), (0.03, 0.97), xycoords="axes fraction", va="top", fontsize=6)
    return made.figure


def _ends(points: pd.DataFrame, log: bool) -> tuple[float, float]:
    """Both ends of both axes, with a margin above for the words."""
    both = points[["x", "y"]].to_numpy(dtype=float)
    low, high = float(both.min()), float(both.max())
    if log:
        return 0.9 * low, high * (high / low) ** 0.15
    margin = 0.05 * (high - low) or 0.05 * abs(high) or 0.5
    return low - margin, high + 3 * margin


def words_of(row: Mapping[Any, Any]) -> str:
    """The lines of a panel: the change of the mean, and in how many pairs the value is smaller."""
    if not row["n"]:
        return f"no pairs: none of {row['of']} replications has both values"
    change = row["change"], row["change_low"], row["change_high"]
    unit = f" {row['unit']}".rstrip()
    text = "change unknown, too few pairs"
    if row["equal"] == row["n"]:
        return f"equal in all {row['n']}"
    if np.isfinite(change).all():
        value, low, high = rounded(*change, "+")
        text = f"mean {value}{unit} [{low}, {high}]"
    equal = f", equal in {row['equal']}" if row["equal"] else ""
    return f"{text}\nsmaller in {row['smaller']} of {row['n']}{equal}"
