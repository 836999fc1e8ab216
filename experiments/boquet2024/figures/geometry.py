"""Figures 2 and 3 and the rule of the square root of three."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from aoabench.maths.statistics import Estimate
from aoabench.report.plots import GREY, PAGE, new

from .common import ERROR, points, raster

if TYPE_CHECKING:
    from matplotlib.figure import Figure


ANCHORS = {
    "one anchor": [(5, 5)],
    "two anchors": [(2.5, 5), (7.5, 5)],
    "three anchors": [(2.5, 2.5), (7.5, 2.5), (5, 7.5)],
    "four anchors": [(2.5, 2.5), (7.5, 2.5), (2.5, 7.5), (7.5, 7.5)],
}


def fig2(frame: pd.DataFrame) -> Figure:
    """GDOP over the standard room for one to four anchors; contours at multiples of 3 m [Boquet
    2024, Fig. 2].
    """
    figure, axes = new(PAGE, 2.5, cols=4, sharey=True)
    image = None
    for axis, (name, places) in zip(axes, ANCHORS.items()):
        rows = frame[frame["layout"] == name]
        image = raster(axis, rows, rows["gdop_m"].to_numpy(), cmap="viridis", vmin=0, vmax=15)
        x, y = np.unique(rows["x_m"]), np.unique(rows["y_m"])
        grid = rows.pivot(index="y_m", columns="x_m", values="gdop_m").to_numpy()
        lines = axis.contour(x, y, grid, levels=[3, 6, 9, 12, 15], colors="white", linewidths=0.8)
        axis.clabel(lines, fmt="%g m", fontsize=5)
        axis.plot(*np.array(places, dtype=float).T, "^", color="#D55E00", mec="white", ms=5)
        axis.set(xlabel="x [m]", title=name)
    axes[0].set(ylabel="y [m]")
    figure.colorbar(image, ax=axes, label="GDOP [m/rad]", shrink=0.8)
    return figure


def fig2_values(frame: pd.DataFrame) -> dict[str, Estimate]:
    """The least GDOP of one anchor, the distance at which the GDOP is sqrt(3) times as large, and
    for several anchors the additional share of the room below 6 m, in percent points.
    """
    one = frame.set_index("layout")
    found = {
        "fig2/minimum": Estimate(float(one.loc["minimum", "gdop_m"]), 0.0),
        "fig2/root3": Estimate(float(one.loc["sqrt 3", "x_m"]), 0.0),
    }
    share = {
        name: float((frame.loc[frame["layout"] == name, "gdop_m"] < 6).mean()) for name in ANCHORS
    }
    for name in list(ANCHORS)[1:]:
        found[f"fig2/{name.split()[0]}/more"] = Estimate(
            100 * (share[name] - share["one anchor"]), 0.0
        )
    return found


def fig3a(frame: pd.DataFrame) -> Figure:
    """Samples from B, and of the mean of A and B, for a node at (8.5, 3) m [Boquet 2024, Fig.
    3(a)].
    """
    figure, axis = new(0.55 * PAGE, 3.2)
    for who, colour, marker in (("mean of A and B", "#0072B2", "s"), ("B", "#D55E00", "o")):
        rows = frame[(frame["kind"] == "sample") & (frame["who"] == who)]
        axis.plot(rows["x_m"], rows["y_m"], marker, color=colour, ms=2, alpha=0.6, label=who)
    for name, x in (("A", 2.5), ("B", 7.5)):
        axis.plot(x, 5, "^", color="black")
        axis.annotate(name, (x, 5), xytext=(4, 4), textcoords="offset points")
    axis.plot(8.5, 3, "*", color="black", ms=9, label="node")
    axis.add_patch(_rectangle())
    axis.set(xlabel="x [m]", ylabel="y [m]", xlim=(-1, 16), ylim=(-4, 11), aspect="equal")
    figure.legend(loc="outside upper center", ncols=3)
    return figure


def _rectangle() -> Any:
    from matplotlib.patches import Rectangle

    return Rectangle((0, 0), 10, 10, fill=False, lw=0.8, ls=":")


def fig3a_values(frame: pd.DataFrame) -> dict[str, Estimate]:
    """95th percentiles of the errors, with positions clipped to the room and without clipping."""
    rows = frame[frame["kind"].isin(["clipped", "unclipped"])].to_dict("records")
    key = {"B": "b", "mean of A and B": "mean"}
    return {
        f"fig3a/{r['kind']}/{key[r['who']]}": Estimate(float(r["q95_m"]), float(r["q95_se"]))
        for r in rows
    }


def fig3b(frame: pd.DataFrame) -> Figure:
    """RMSE of C alone minus that of the mean of A and B [Boquet 2024, Fig. 3(b)]."""
    figure, axis = new(0.55 * PAGE, 3.2)
    more = (frame["single_m"] - frame["pair_m"]).to_numpy()
    limit = np.ceil(np.abs(more).max() * 2) / 2
    image = raster(axis, frame, more, cmap="RdBu_r", vmin=-limit, vmax=limit)
    for name, x in (("A", 2.5), ("C", 5.0), ("B", 7.5)):
        axis.plot(x, 5, "^", color="black", ms=5)
        axis.annotate(name, (x, 5), xytext=(3, 3), textcoords="offset points")
    axis.set(xlabel="x [m]", ylabel="y [m]")
    figure.colorbar(image, label="RMSE of C minus RMSE of\nthe mean of A and B [m]")
    return figure


def fig3b_values(frame: pd.DataFrame) -> dict[str, Estimate]:
    """Shares of the room, in percent, in which the single anchor C is better, and worse, by three
    standard errors.
    """
    d = frame["pair_m"] - frame["single_m"]
    se = np.hypot(frame["pair_se"], frame["single_se"])  # not paired: an upper limit
    return {
        "fig3b/better": Estimate(100 * float((d > 3 * se).mean()), 0.0),
        "fig3b/worse": Estimate(100 * float((d < -3 * se).mean()), 0.0),
    }


def fig3c(frame: pd.DataFrame) -> Figure:
    """CDF of the error of the mean of A and B for separations of 1 to 9 m, and of C alone [Boquet
    2024, Fig. 3(c)].
    """
    from matplotlib import colormaps

    figure, axis = new(0.6 * PAGE, 3.0)
    for apart, rows in frame.groupby("separation_m"):
        if apart:
            axis.plot(
                rows["error_m"],
                rows["cdf"],
                color=colormaps["viridis"](apart / 10),
                label=f"{apart} m",
            )
        else:
            axis.plot(rows["error_m"], rows["cdf"], color=GREY, ls=":", lw=2, label="C alone")
    axis.set(xlabel=ERROR, ylabel="share of the estimates", xlim=(0, 6), ylim=(0, 1))
    axis.legend(title="A and B apart", ncols=2)
    return figure


def rule(frame: pd.DataFrame) -> Figure:
    """RMSE of the mean of A and B over that of A alone, against the deviations' ratio [Boquet 2024,
    (9)].
    """
    figure, axis = new(0.5 * PAGE, 2.6)
    axis.plot(
        frame["gamma"], frame["closed"], color="black", lw=1, label=r"$\sqrt{1+\gamma^2}/2$ (40)"
    )
    look = {"color": "#0072B2", "fmt": "o", "ms": 3, "label": "samples"}
    points(axis, frame["gamma"], frame, "ratio", **look)
    axis.axhline(1, color=GREY, lw=0.8)
    axis.axvline(np.sqrt(3), color=GREY, lw=0.8, ls=":")
    axis.set(
        xlabel=r"deviation of B over that of A, $\gamma$", ylabel="RMSE of the mean / RMSE of A"
    )
    axis.legend()
    return figure


def rule_values(frame: pd.DataFrame) -> dict[str, Estimate]:
    """The ratio of deviations above which B increases the RMSE: the RMSE ratio crosses 1, by a line
    through the two nearest points.
    """
    i = int(np.flatnonzero(frame["ratio"].to_numpy() < 1)[-1])
    a, b = frame.iloc[i], frame.iloc[i + 1]
    slope = (b["ratio"] - a["ratio"]) / (b["gamma"] - a["gamma"])
    return {
        "rule/threshold": Estimate(
            float(a["gamma"] + (1 - a["ratio"]) / slope), float(a["ratio_se"] / slope)
        )
    }
