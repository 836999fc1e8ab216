"""The errata one by one, and positions and deviations that the paper does not have."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pandas as pd

from aoabench.maths.estimate import Estimate
from aoabench.report.plots import BOUND_LABEL, PAGE, bound, bound_ratio, error_bars, new

from .common import NAMES, OTHERS, SIGMA, STYLES, curve, of, read

if TYPE_CHECKING:
    from matplotlib.figure import Figure


VARIANTS = {
    "meant": ("corrected", STYLES["ml_kcorr"]),
    "invariant": (
        "start from invariant rows (L6)",
        {"color": "#009E73", "marker": "^", "ls": "--"},
    ),
    "sign": ("sign as printed (L1)", STYLES["ml_atan2"]),
    "atan2": ("atan2 as printed (L2)", STYLES["ml_arctan"]),
}


def errata(frame: pd.DataFrame) -> Figure:
    """RMSE of the proposed estimator, corrected and with each erratum as printed, and the increase
    in percent.
    """
    figure, (left, right) = new(PAGE, 2.9, cols=2)
    for variant, (label, style) in VARIANTS.items():
        rows = of(frame[frame["variant"] == variant], "ml_kcorr")
        curve(left, rows, "sigma_deg", "rmse_m", "rmse_se", label=label, **style)
        if variant in ("sign", "invariant"):
            above = rows["above_meant_percent"]
            bars = error_bars(rows, "above_meant_percent", "above_meant_se")
            right.errorbar(rows["sigma_deg"], above, yerr=bars, capsize=2, elinewidth=0.8, **style)
    rows = of(frame[frame["variant"] == "meant"], "ml_kcorr")
    bound(left, rows["sigma_deg"], rows["bound_m"])
    left.set(xlabel=SIGMA, ylabel="RMSE of (d) [m]", yscale="log")
    right.axhline(0, color="black", lw=0.8, ls=":")
    right.set(xlabel=SIGMA, ylabel="RMSE of (d) above corrected [%]")
    figure.legend(*left.get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


def errata_values(frame: pd.DataFrame) -> dict[str, Estimate]:
    """RMSE above that of the corrected estimator, in percent."""
    return {
        f"errata/{r['variant']}/{r['sigma_deg']:g}/{r['estimator']}": read(
            r, "above_meant_percent", "above_meant_se"
        )
        for r in frame[frame["variant"] != "meant"].to_dict("records")
    }


def zones(frame: pd.DataFrame) -> Figure:
    """RMSE over the bound against the deviation, a panel per estimator and a curve per zone."""
    figure, axes = new(PAGE, 4.6, rows=2, cols=2, sharey="row")
    places = {
        "ls": axes[0, 0],
        "ml_kcorr": axes[0, 1],
        "ml_arctan": axes[1, 0],
        "ml_atan2": axes[1, 1],
    }
    styles = (
        ("#0072B2", "o", "-"),
        ("#56B4E9", "s", "--"),
        ("#009E73", "D", "-."),
        ("#E69F00", "^", ":"),
    )
    styles += (("#D55E00", "v", "-"),)
    for name, axis in places.items():
        for (colour, marker, line), where in zip(styles, frame["zone"].unique()):
            rows = of(frame[frame["zone"] == where], name)
            look = {"color": colour, "marker": marker, "ls": line, "ms": 3, "label": where}
            curve(axis, rows, "sigma_deg", "ratio", "ratio_se", **look)
        bound_ratio(axis)
        axis.set(
            xscale="log",
            yscale="linear" if name in ("ls", "ml_kcorr") else "log",
            title=NAMES[name],
        )
        axis.set_xticks(ticks := [0.5, 1, 2, 4, 8, 15], [f"{t:g}" for t in ticks])
        axis.minorticks_off()
    figure.supxlabel(SIGMA, fontsize=8)
    figure.supylabel("RMSE / square root of the CRB", fontsize=8)
    handles = axes[0, 0].get_legend_handles_labels()
    figure.legend(
        *handles, loc="outside upper center", ncols=5, title="positions keep from the base stations"
    )
    return figure


def zones_values(frame: pd.DataFrame) -> dict[str, Estimate]:
    """Per zone, deviation and estimator the ratio to the bound, and the excess of the RMSE of least
    squares over that of the proposed estimator in percent.
    """
    found = {}
    for r in frame.to_dict("records"):
        key = f"zones/{r['zone']}/{r['sigma_deg']:g}/{r['estimator']}"
        found[f"{key}/ratio"] = read(r, "ratio")
        if r["estimator"] == "ls":
            found[f"{key}/above"] = read(r, "above_percent", "above_se")
    return found


def pole(frame: pd.DataFrame) -> Figure:
    """RMSE over the bound against the distance from a column of base stations: in space, and in the
    plane.
    """
    figure, axes = new(PAGE, 4.8, rows=2, cols=2, sharex=True, sharey=True)
    for column, (sigma, part) in zip(axes.T, frame.groupby("sigma_deg")):
        for axis, ratio, what in zip(column, ("ratio", "ratio_xy"), ("3-D", "horizontal")):
            for name, label in (NAMES | OTHERS).items():
                rows = part[part["estimator"] == name].sort_values("distance_m")
                curve(axis, rows, "distance_m", ratio, f"{ratio}_se", label=label, **STYLES[name])
            bound_ratio(axis, BOUND_LABEL)
            axis.set(xscale="log", yscale="log", title=f"{what}, {sigma:g} deg")
    figure.supxlabel("horizontal distance from a column of base stations [m]", fontsize=8)
    figure.supylabel("RMSE / square root of the CRB", fontsize=8)
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


def pole_values(frame: pd.DataFrame) -> dict[str, Estimate]:
    """Per deviation, distance and estimator the ratios to the bound in space and in the plane."""
    found = {}
    for r in frame.to_dict("records"):
        key = f"pole/{r['sigma_deg']:g}/{r['distance_m']:g}/{r['estimator']}"
        for word, column in (("3d", "ratio"), ("xy", "ratio_xy")):
            found[f"{key}/{word}"] = read(r, column)
    return found
