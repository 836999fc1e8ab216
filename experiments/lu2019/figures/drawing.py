"""Lu et al. 2019: figures, each a function of an item's table alone."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from aoabench.report.plots import GREY, PAGE, error_bars, new
from aoabench.report.text import significant

from .values import consistent

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NAMES = {"ekf_toa_aoa": "EKF, times and angles", "ekf_aoa": "EKF, angles", "wcg": "WCG"}
STYLES = {
    "ekf_toa_aoa": {"color": "#0072B2", "marker": "o", "ls": "-"},
    "ekf_aoa": {"color": "#D55E00", "marker": "s", "ls": "--"},
    "wcg": {"color": "#009E73", "marker": "^", "ls": "-."},
}
KINDS = {"independent": "independent errors", "common": "one error common to all"}
SIGMA = "deviation of the known access nodes [m]"


def fig2(frame: pd.DataFrame) -> Figure:
    """Plan, access nodes, route and its height [Lu 2019, Fig. 2]."""
    figure, (left, right) = new(PAGE, 3.6, cols=2, width_ratios=[3, 1])
    for w in frame[frame["kind"] == "wall"].to_dict("records"):
        left.plot([w["x_m"], w["x1_m"]], [w["y_m"], w["y1_m"]], color="black", lw=0.8)
    an, route = frame[frame["kind"] == "access node"], frame[frame["kind"] == "route"]
    left.quiver(
        an["x_m"], an["y_m"], an["x1_m"], an["y1_m"], color=GREY, angles="xy", scale=45, width=0.002
    )
    left.plot(
        an["x_m"], an["y_m"], "o", ms=2.5, color="#D55E00", label="access node and its broadside"
    )
    left.plot(route["x_m"], route["y_m"], color="#0072B2", label="route")
    left.plot(*route[["x_m", "y_m"]].iloc[0], "x", color="#009E73", ms=7, mew=2, label="start")
    left.plot(*route[["x_m", "y_m"]].iloc[-1], "o", color="#CC79A7", ms=6, label="end")
    left.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    left.grid(visible=False)
    time = frame["step_s"].iloc[0] * np.arange(1, len(route) + 1)
    right.plot(time, route["z_m"], color="#0072B2")
    right.set(xlabel="time [s]", ylabel="z [m]", ylim=(0.9, 2.1))
    figure.legend(*left.get_legend_handles_labels(), loc="outside upper center", ncols=4)
    return figure


def fig3(frame: pd.DataFrame) -> Figure:
    """Distribution functions of the measurements' errors [Lu 2019, Fig. 3]."""
    figure, (left, right) = new(PAGE, 2.6, cols=2, sharey=True)
    cdf = frame[frame["kind"] == "cdf"]
    rows = cdf[cdf["name"] == "toa_m"]
    left.plot(rows["x"], rows["value"], color=STYLES["ekf_toa_aoa"]["color"])
    for name, label, style in (
        ("azimuth_deg", "azimuth", "-"),
        ("elevation_deg", "elevation", "--"),
    ):
        rows = cdf[cdf["name"] == name]
        colour = STYLES["ekf_aoa"]["color"] if name == "azimuth_deg" else STYLES["wcg"]["color"]
        right.plot(rows["x"], rows["value"], style, color=colour, label=label)
    for axis, limit in ((left, 10.0), (right, 0.5)):
        for x in (-limit, limit):
            axis.axvline(x, color="black", lw=0.8, ls=":")
    left.set(xlabel="error of the time of arrival, times c [m]", ylabel="share of the errors below")
    right.set(xlabel="error of the angle of arrival [deg]")
    right.legend(loc="lower right")
    return figure


# --- Figure 4 -------------------------------------------------------------------------------------


SHOWN_M = (0.001, 60.0)  # axis of the errors: from a millimetre to beyond the printed 29 m


def fig4(frame: pd.DataFrame) -> Figure:
    """RMSE and median error in space and height, and divergence rate, against the uncertainty
    [Lu 2019, Fig. 4].
    """
    figure, axes = new(PAGE, 6.2, rows=3, cols=2, sharex=True, sharey="row")
    for column, (kind, title) in zip(axes.T, KINDS.items()):
        for name in NAMES:
            rows = frame[(frame["an_error"] == kind) & (frame["estimator"] == name)]
            rows = rows.dropna(subset=["an_sigma_m"]).sort_values("an_sigma_m")
            for axis, part in zip(column, ("3d", "z")):
                _errors(axis, rows, name, part)
            _diverged(column[2], rows, name)
        for axis in column[:2]:
            axis.set(yscale="log", ylim=SHOWN_M)
            axis.set_yticks([0.01, 0.1, 1, 10], ["0.01", "0.1", "1", "10"])
        column[0].set_title(title, pad=16)
        column[2].set(xlabel=SIGMA)
    labels = ("3-D error [m]", "vertical error [m]", "diverged trials [%]")
    for axis, label in zip(axes[:, 0], labels):
        axis.set_ylabel(label)
    figure.legend(handles=_fig4_legend(), loc="outside upper center", ncols=3)
    return figure


def _fig4_legend() -> list[Any]:
    """Handles for methods and for the three kinds of marks."""
    from matplotlib.lines import Line2D

    methods = [Line2D([], [], label=label, **STYLES[name]) for name, label in NAMES.items()]
    rmse = Line2D([], [], color=GREY, marker="o", label="filled: RMSE of all trials")
    median = Line2D([], [], color=GREY, marker="o", mfc="white", ls=":", label="open: median")
    beyond = Line2D(
        [], [], color=GREY, marker=6, ls="", label="RMSE beyond the axis, with its value"
    )
    return [*methods, rmse, median, beyond]


def _errors(axis: Any, rows: pd.DataFrame, name: str, part: str) -> None:
    """Draw a method's RMSE of all trials in space (3d) or height (z), and its median error where
    the table has one. A RMSE beyond the axis is a mark on its edge with the value beside it.
    """
    sigma, value = rows["an_sigma_m"], rows[f"rmse_{part}"]
    seen = value.where(value <= SHOWN_M[1])
    bars = error_bars(rows, f"rmse_{part}", log=True)
    axis.errorbar(sigma, seen, yerr=bars, capsize=2, elinewidth=0.8, **STYLES[name])
    if f"median_{part}" in rows:
        look = {**STYLES[name], "ls": ":", "lw": 1.0, "mfc": "white", "ms": 3.5}
        axis.plot(sigma, rows[f"median_{part}"], **look)
    for x, y in zip(sigma[seen.isna()], value[seen.isna()]):
        colour = STYLES[name]["color"]
        axis.plot(x, SHOWN_M[1], marker=6, color=colour, clip_on=False)
        text = f"{significant(y / 1000, 3)} km" if y >= 1000 else f"{significant(y, 3)} m"
        at = {"xytext": (0, 5), "textcoords": "offset points", "annotation_clip": False}
        axis.annotate(text, (x, SHOWN_M[1]), ha="center", fontsize=6.5, color=colour, **at)


def _diverged(axis: Any, rows: pd.DataFrame, name: str) -> None:
    """Draw the share of a method's trials that diverge, in percent."""
    share, (below, above) = 100 * rows["diverged"], 100 * error_bars(rows, "diverged")
    look = {"capsize": 2, "elinewidth": 0.8, **STYLES[name]}
    axis.errorbar(rows["an_sigma_m"], share, yerr=[np.minimum(below, share), above], **look)


# --- Table II, errata, consistency ----------------------------------------------------------------


VARIANTS = {
    "meant": "corrected", "jacobian": "derivatives (U1, U2)", "shared": "one shared error (U3)",
    "cross": "no cross terms (U4)", "alpha": "orientation (U5)", "gain": "array gain twice (U6)",
    "wrap": "no wrap (U8)",
}  # fmt: skip


def errata(frame: pd.DataFrame) -> Figure:
    """Median RMSE of each method, corrected and with one erratum as printed, without and with
    uncertain access nodes.
    """
    figure, axes = new(PAGE, 3.0, cols=2, sharey=True)
    rows_of = [v for v in VARIANTS if v in set(frame["variant"])]
    for axis, (sigma, part) in zip(axes, frame.groupby("an_sigma_m")):
        for k, (name, label) in enumerate(NAMES.items()):
            rows = part[part["estimator"] == name].set_index("variant")
            present = [v for v in rows_of if v in rows.index]
            y = [-rows_of.index(v) + 0.2 * (1 - k) for v in present]
            shown = rows.loc[present]
            bars = error_bars(shown, "median_m", "median_se", log=True)
            look = {**STYLES[name], "ls": "", "ms": 4, "capsize": 2, "elinewidth": 0.8}
            axis.errorbar(shown["median_m"], y, xerr=bars, label=label, **look)
        axis.set(
            xscale="log", xlabel="median 3-D RMSE [m]", title=f"access nodes known to {sigma:g} m"
        )
        axis.set_yticks([-i for i in range(len(rows_of))], [VARIANTS[v] for v in rows_of])
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


def nees(frame: pd.DataFrame) -> Figure:
    """Mean NEES at each time, with the band of a consistent filter."""
    sigmas = sorted(frame["an_sigma_m"].unique())
    figure, axes = new(PAGE, 4.2, rows=2, cols=len(sigmas), sharey="row")
    titles = {"indoor_map_model": "truth from the model", "indoor_map": "on the route"}
    for line, (scenario, title) in zip(axes, titles.items()):
        for axis, sigma in zip(line, sigmas):
            part = frame[(frame["scenario"] == scenario) & (frame["an_sigma_m"] == sigma)]
            for name in ("ekf_toa_aoa", "ekf_aoa"):
                rows = part[part["estimator"] == name]
                style = {"color": STYLES[name]["color"], "ls": STYLES[name]["ls"], "lw": 0.9}
                axis.plot(rows["time_s"], rows["nees"], label=NAMES[name], **style)
            axis.axhspan(
                *consistent(int(part["trials"].iloc[0])),
                color=GREY,
                alpha=0.35,
                label="95 % band",
                lw=0,
            )
            axis.set(yscale="log", title=f"{title}, {sigma:g} m", xlabel="time [s]")
        line[0].set_ylabel("mean NEES (3 dof)")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure
