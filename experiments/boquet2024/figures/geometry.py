"""Figures 2 and 3 and the rule of the square root of three."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from aoabench.maths.estimate import Estimate, stored
from aoabench.report.plots import GREY, PAGE, new

from .common import ERROR, estimate, points, raster

if TYPE_CHECKING:
    from matplotlib.figure import Figure


ANCHORS: dict[str, list[tuple[float, float]]] = {
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
    """The least GDOP of one anchor, and the distance at which the GDOP is sqrt(3) times as large;
    for each layout the share of the room below 6 m, in percent, and that minus one anchor's; for
    three and four anchors the GDOP within their convex hull over that of one anchor, at the point
    where this is largest, and over that outside, of means.
    """
    by = dict(iter(frame.groupby("layout", sort=False)))
    found = {
        "fig2/minimum": float(by["minimum"]["gdop_m"].iloc[0]),
        "fig2/sqrt 3": float(by["sqrt 3"]["x_m"].iloc[0]),
    }
    one = by["one anchor"]["gdop_m"].to_numpy()
    for name, places in ANCHORS.items():
        g = by[name]["gdop_m"].to_numpy()
        found[f"fig2/{name}/below"] = 100 * float((g < 6).mean())
        if len(places) > 1:
            found[f"fig2/{name}/more"] = 100 * float((g < 6).mean() - (one < 6).mean())
        if len(places) > 2:
            inside = _in_hull(by[name][["x_m", "y_m"]].to_numpy(), places)
            found[f"fig2/{name}/hull over one anchor"] = float((g / one)[inside].max())
            found[f"fig2/{name}/hull over outside"] = float(g[inside].mean() / g[~inside].mean())
    return {key: Estimate(value, 0.0) for key, value in found.items()}


def _in_hull(points: np.ndarray, places: list[tuple[float, float]]) -> np.ndarray:
    """Whether each point (N, 2) lies within the convex hull of the places."""
    from scipy.spatial import Delaunay

    return np.asarray(Delaunay(np.array(places)).find_simplex(points) >= 0)


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
    return {f"fig3a/{r['kind']}/{r['who']}": stored(r, "q95_m", "q95_se") for r in rows}


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
    """RMSE of the mean of A and B minus that of C alone, in m, at each point."""
    return {
        f"fig3b/{r['x_m']:g},{r['y_m']:g}": stored(r, "pair_m", "pair_se")
        - stored(r, "single_m", "single_se")
        for r in frame.to_dict("records")
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


def fig3c_values(frame: pd.DataFrame) -> dict[str, Estimate]:
    """P(error <= 1 m) in percent for each separation, and that minus C alone's."""
    found = {}
    for r in frame[np.isclose(frame["error_m"], 1.0)].to_dict("records"):
        found[f"fig3c/{r['separation_m']:g}/within"] = estimate(r, "cdf").percent()
        if r["separation_m"]:
            found[f"fig3c/{r['separation_m']:g}/more"] = estimate(r, "more").percent()
    return found


def rule(frame: pd.DataFrame) -> Figure:
    """RMSE of the mean of A's and B's estimates over that of A alone, against the deviations' ratio
    [Boquet 2024, (9) and (40)], and the same of M_LS.
    """
    from matplotlib import colormaps

    figure, axis = new(0.6 * PAGE, 3.0)
    for (kind, beta), rows in frame.groupby(["kind", "beta"], sort=False):
        if kind == "ls":
            look = {"color": "#D55E00", "fmt": "s", "ms": 3, "mfc": "none", "label": "M LS"}
        else:
            colour = colormaps["viridis"](beta / 4)
            axis.plot(rows["gamma"], rows["closed"], color=colour, lw=1)
            look = {"color": colour, "fmt": "o", "ms": 2, "label": rf"mean, $\beta$ = {beta:g}"}
            axis.axvline(np.sqrt(beta + 2), color=colour, lw=0.8, ls=":")
        points(axis, rows["gamma"], rows, "ratio", **look)
    axis.axhline(1, color=GREY, lw=0.8)
    axis.set(
        xlabel=r"deviation of B over that of A, $\gamma$", ylabel="RMSE of the mean / RMSE of A"
    )
    axis.legend(title=r"lines: (40); dotted: $\sqrt{\beta + 2}$")
    return figure


def rule_values(frame: pd.DataFrame) -> dict[str, Estimate]:
    """The RMSE ratio for each kind, beta and gamma; of each mean, the gamma above which B increases
    the RMSE (the ratio crosses 1, by a line through the two nearest points), and that over
    sqrt(beta + 2).
    """
    found = {}
    for (kind, beta), rows in frame.groupby(["kind", "beta"], sort=False):
        of = f"rule/{kind}/{beta:g}"
        for r in rows.to_dict("records"):
            found[f"{of}/{r['gamma']:g}"] = estimate(r, "ratio")
        crossing = _crossing(rows)
        found[f"{of}/threshold"] = crossing
        found[f"{of}/over rule"] = crossing * (1 / np.sqrt(beta + 2))
    return found


def _crossing(rows: pd.DataFrame) -> Estimate:
    """The gamma at which the RMSE ratio crosses 1."""
    i = int(np.flatnonzero(rows["ratio"].to_numpy() < 1)[-1])
    a, b = rows.iloc[i], rows.iloc[i + 1]
    slope = (b["ratio"] - a["ratio"]) / (b["gamma"] - a["gamma"])
    return (estimate(a, "ratio") - 1) * float(-1 / slope) + float(a["gamma"])
