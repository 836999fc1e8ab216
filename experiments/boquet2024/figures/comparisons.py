"""Paired comparisons: methods, thresholds, boxes against ellipses, errata."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pandas as pd

from aoabench.maths.estimate import Estimate
from aoabench.report.plots import GREY, PAGE, new

from .common import (
    DF,
    LIMIT,
    NAMES,
    PRINTED,
    PRINTED_AT,
    STYLES,
    estimate,
    points,
    printed,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def ranking(frame: pd.DataFrame) -> Figure:
    """P(error <= 1 m): discrepancy filter minus each other method, against R_sigma."""
    figure, axes = new(PAGE, 2.9, cols=3, sharey=True)
    titles = {
        "all": "each on its own fixes",
        "accepted": "on the fixes that DF gives",
        "coverage": "at equal coverage",
    }
    for axis, (at, title) in zip(axes, titles.items()):
        rows = frame[(frame["at"] == at) & frame["method"].str.startswith("df")]
        for name, part in rows.groupby("other", sort=False):
            r = part["method"].str.split().str[1].astype(float)
            points(axis, r, part, "more", label=NAMES[name], elinewidth=0.5, **STYLES[name])
        axis.axhline(0, color="black", lw=0.8)
        axis.set(xlabel=r"$R_\sigma$", title=title)
    axes[0].set(ylabel=f"{LIMIT}: DF minus other")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=9)
    return figure


def ranking_values(frame: pd.DataFrame) -> dict[str, Estimate]:
    """Differences of P(error <= 1 m) in percentage points."""
    return {
        f"ranking/{r['at']}/{r['method']}/{r['other']}": estimate(r, "more").percent()
        for r in frame.to_dict("records")
    }


def rejection(frame: pd.DataFrame) -> Figure:
    """P(error <= 1 m) against coverage: methods with a score for several thresholds on it, DF for
    several R_sigma, and the printed values of DF.
    """
    figure, axis = new(0.65 * PAGE, 3.4)
    for name in NAMES:
        rows = frame[frame["method"] == name].sort_values("coverage")
        if len(rows) > 1:
            look = {"label": f"{NAMES[name]}, by its residual", **STYLES[name]}
            points(axis, rows["coverage"], rows, "within_1m", elinewidth=0.5, **look)
        elif len(rows):
            _named_point(axis, rows, name)
    for kind, line in (("boxes", "-"), ("exact", ":")):
        rows = frame[frame["method"] == f"df {kind}"].sort_values("coverage")
        look = {"label": rf"DF, by $R_\sigma$ ({kind})", "ls": line, **DF}
        points(axis, rows["coverage"], rows, "within_1m", elinewidth=0.5, **look)
    covered = [1 - printed[f"misfit/lost/{r:g}"] for r in PRINTED_AT]
    axis.plot(covered, [printed[f"misfit/within/{r:g}"] for r in PRINTED_AT], **PRINTED)
    axis.set(xlabel="coverage: share of the packets with a fix", ylabel=LIMIT, xlim=(0, 1.02))
    axis.legend(loc="lower left")
    return figure


def rejection_values(frame: pd.DataFrame) -> dict[str, Estimate]:
    """P(error <= 1 m) in percent of each method, by R_sigma or by coverage."""
    found = {}
    for r in frame.to_dict("records"):
        fixed = r["r_sigma"] == r["r_sigma"]
        at = f"R_sigma {r['r_sigma']:g}" if fixed else f"coverage {r['coverage']:.2f}"
        found[f"rejection/{r['method']}/{at}"] = estimate(r, "within_1m").percent()
    return found


def _named_point(axis: Any, rows: pd.DataFrame, name: str) -> None:
    """A method that gives every fix: a diamond with its name."""
    at = rows["coverage"].iloc[0], rows["within_1m"].iloc[0]
    axis.plot(*at, "D", ms=4, mfc="none", color=STYLES[name]["color"])
    beside = {"xytext": (-4, 0), "textcoords": "offset points", "ha": "right", "va": "center"}
    axis.annotate(NAMES[name], at, fontsize=6, **beside)


def boxes(frame: pd.DataFrame) -> Figure:
    """Against R_sigma: the share of packets in which bounding boxes and exact ellipses differ, and
    P(error <= 1 m) and R_d of both.
    """
    figure, (left, right) = new(PAGE, 2.7, cols=2)
    for key, label, colour in (
        ("other_set", "another set of anchors", "#0072B2"),
        ("other_position", "another position", "#E69F00"),
    ):
        look = {"color": colour, "marker": "o", "ms": 3, "label": label}
        points(left, frame["r_sigma"], frame, key, scale=100, **look)
    left.set(xlabel=r"$R_\sigma$", ylabel="share of the packets [%]", ylim=(0, None))
    for kind, line in (("boxes", "-"), ("exact", ":")):
        for key, label, colour in (("within_1m", LIMIT, "#D55E00"), ("lost", "$R_d$", GREY)):
            look = {
                "color": colour,
                "marker": "o",
                "ms": 3,
                "label": f"{label}, {kind}",
                "ls": line,
            }
            points(right, frame["r_sigma"], frame, f"{key}_{kind}", **look)
    right.set(xlabel=r"$R_\sigma$", ylim=(0, 1))
    for axis in (left, right):
        axis.legend()
    return figure


def boxes_values(frame: pd.DataFrame) -> dict[str, Estimate]:
    """Shares that differ and the gain of the exact vote, in percent."""
    return {
        f"boxes/{r['r_sigma']:g}/{key}": estimate(r, key).percent()
        for r in frame.to_dict("records")
        for key in ("other_set", "other_position", "more")
    }


def errata_values(frame: pd.DataFrame) -> dict[str, Estimate]:
    """Per erratum: P(error <= 1 m) corrected minus as the paper ran it, in percentage points, and
    the share of the packets whose fix changes.
    """
    return {
        f"errata/{r['variant']}/{key}": estimate(r, key)
        for r in frame.to_dict("records")
        for key in ("more", "moved")
    }
