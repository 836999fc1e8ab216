"""The robust estimator beside the paper's methods and its filter."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from aoabench.maths.estimate import Estimate
from aoabench.report.plots import PAGE, new

from .common import DF, LIMIT, NAMES, STYLES, estimate, intervals, points

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LOOKS = {  # of the variants in the right panel: label, colour, marker
    "robust_ml": ("student", "black", "o"),
    "robust_huber": ("huber", "#0072B2", "s"),
    "robust_truncated": ("truncated", "#CC79A7", "^"),
    "robust_normal": ("normal", "#999999", "D"),
}
BESIDE = ("vmf_ml", "ls_lines", "ls_anchor_discarding")  # methods of the left panel
SHOWN = (0.2, 0.4, 1.0, 2.0)  # R_sigmas of the right panel


def robust(frame: pd.DataFrame) -> Figure:
    """Left P(error <= 1 m) against coverage; right robust_ml minus the others, by loss."""
    figure, (left, right) = new(PAGE, 3.8, cols=2)
    _curves(left, frame[frame["at"] == "curve"])
    _differences(right, frame)
    figure.legend(*_once(left, right), loc="outside upper center", ncols=4)
    return figure


def _curves(axis: Any, rows: pd.DataFrame) -> None:
    """Shares of methods that reject by their score, and of the filter by R_sigma."""
    looks = {"robust_ml": {"label": "robust ML", "color": "black", "ls": "-"}}
    looks |= {name: {"label": NAMES[name], **STYLES[name]} for name in BESIDE}
    looks["df boxes"] = {"label": r"DF, by $R_\sigma$", "ls": "-", **DF}
    for name, look in looks.items():
        part = rows[rows["method"] == name].sort_values("coverage")
        points(axis, part["coverage"], part, "within_1m", elinewidth=0.5, **look)
    label = "coverage: share of the packets with a fix"
    axis.set(xlabel=label, ylabel=LIMIT, xlim=(0, 1.02), ylim=(0.5, 1))


def _differences(axis: Any, frame: pd.DataFrame) -> None:
    """Differences in P(error <= 1 m): above at full coverage, below at that of the filter."""
    full, level = frame[frame["at"] == "all"], frame[frame["at"] == "coverage"]
    methods = [name for name in NAMES if name != "discrepancy"]
    names = [NAMES[name] for name in methods] + [rf"DF, $R_\sigma$ = {r:g}" for r in SHOWN]
    for i, (name, (label, colour, marker)) in enumerate(LOOKS.items()):
        mine = full[full["method"] == name].set_index("other").loc[methods]
        others = [f"df {r:g}" for r in SHOWN]
        df = level[level["method"] == name].set_index("other").loc[others]
        both = pd.concat([mine, df])
        y = np.arange(len(names)) + 0.18 * (i - 1.5)
        style = {"color": colour, "fmt": marker, "ms": 3, "label": f"loss {label}"}
        intervals(axis, both, "more", y, scale=100, **style)
    axis.axvline(0, color="black", lw=1, ls=":")
    axis.axhline(len(methods) - 0.5, color="black", lw=0.5)
    axis.set_yticks(range(len(names)), names)
    axis.invert_yaxis()
    axis.set(xlabel=f"{LIMIT}: robust ML minus other\n[percentage points]")


def _once(*axes: Any) -> tuple[list[Any], list[str]]:
    """Handles and labels of all axes."""
    both = [axis.get_legend_handles_labels() for axis in axes]
    return [h for handles, _ in both for h in handles], [x for _, labels in both for x in labels]


def robust_values(frame: pd.DataFrame) -> dict[str, Estimate]:
    """Shares within 1 m at full coverage and differences in percentage points, by estimator; at the
    coverage of a filter with its R_sigma.
    """
    found = {}
    for r in frame.to_dict("records"):
        if r["at"] == "all":
            found[f"robust/within/{r['method']}"] = estimate(r, "within_1m").percent()
            found[f"robust/all/{r['method']}/{r['other']}"] = estimate(r, "more").percent()
        elif r["at"] != "curve":
            other = r["other"] if r["other"].startswith("df") else f"{r['other']}/{r['r_sigma']:g}"
            found[f"robust/{r['at']}/{r['method']}/{other}"] = estimate(r, "more").percent()
    return found
