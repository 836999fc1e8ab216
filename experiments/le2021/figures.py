"""Le, Slock, Rossi 2021: figures and printed values, each a function of an item's table alone."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from aoabench.maths.statistics import Estimate
from aoabench.report.plots import BOUND_LABEL, GREY, PAGE, bound, bound_ratio, error_bars, new

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NAMES = {
    "ls": "(a) least squares",
    "ml_arctan": "(b) ML, arctan",
    "ml_atan2": "(c) ML, atan2",
    "ml_kcorr": "(d) ML, atan2, corrected",
}
STYLES = {
    "ls": {"color": GREY, "marker": "v", "ls": "-."},
    "ml_arctan": {"color": "#D55E00", "marker": "s", "ls": ":"},
    "ml_atan2": {"color": "#E69F00", "marker": "D", "ls": "--"},
    "ml_kcorr": {"color": "#0072B2", "marker": "o", "ls": "-"},
}
SIGMA = "deviation of the angles [deg]"


def _curve(axis: Any, rows: pd.DataFrame, x: str, y: str, se: str, **style: Any) -> None:
    bars = error_bars(rows, y, se, log=True)
    axis.errorbar(rows[x], rows[y], yerr=bars, capsize=2, elinewidth=0.8, **style)


def _of(frame: pd.DataFrame, name: str) -> pd.DataFrame:
    return frame[frame["estimator"] == name].sort_values("sigma_deg")


def fig5(frame: pd.DataFrame) -> Figure:
    """Positions and base stations from above and from the side [Le 2021, Fig. 5]."""
    figure, axes = new(PAGE, 3.4, cols=2)
    looks = {
        "position": {
            "marker": ".",
            "ls": "",
            "color": STYLES["ml_kcorr"]["color"],
            "ms": 2,
            "label": "position",
        },
        "base station": {
            "marker": "^",
            "ls": "",
            "color": STYLES["ml_arctan"]["color"],
            "label": "base station",
        },
    }
    for kind, look in looks.items():
        points = frame[frame["kind"] == kind]
        axes[0].plot(points["x_m"], points["y_m"], **look)
        axes[1].plot(points["x_m"], points["z_m"], **look)
    axes[0].set(xlabel="x [m]", ylabel="y [m]", aspect="equal", title="from above")
    axes[1].set(xlabel="x [m]", ylabel="z [m]", title="from the side")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure


# --- Figures 6 and 7 ------------------------------------------------------------------------------


def fig6(frame: pd.DataFrame) -> Figure:
    """RMSE of the four estimators with the bound, and ratios to the bound [Le 2021, Fig. 6]."""
    figure, (left, right) = new(PAGE, 3.0, cols=2)
    for name, label in NAMES.items():
        _curve(
            left, _of(frame, name), "sigma_deg", "rmse_m", "rmse_se", label=label, **STYLES[name]
        )
    rows = _of(frame, "ls")
    bound(left, rows["sigma_deg"], rows["bound_m"])
    left.set(xlabel=SIGMA, ylabel="RMSE [m]", yscale="log")
    for name in ("ls", "ml_kcorr"):
        _curve(
            right,
            _of(frame, name),
            "sigma_deg",
            "ratio",
            "ratio_se",
            label=NAMES[name],
            **STYLES[name],
        )
    bound_ratio(right)
    right.set(xlabel=SIGMA, ylabel="RMSE / square root of the CRB")
    figure.legend(*left.get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


def fig6_values(frame: pd.DataFrame) -> dict[str, Estimate]:
    """RMSEs, ratios to the bound, and the excess of each other estimator over the proposed one."""
    found = {}
    for r in frame.to_dict("records"):
        key = f"fig6/{r['sigma_deg']:g}/{r['estimator']}"
        found[f"{key}/rmse"] = Estimate(r["rmse_m"], r["rmse_se"])
        if r["estimator"] == "ml_kcorr":
            found[f"fig6/{r['sigma_deg']:g}/bound"] = Estimate(r["bound_m"], r["bound_se"])
            found[f"{key}/ratio"] = Estimate(r["ratio"], r["ratio_se"])
            found[f"{key}/bias"] = Estimate(r["bias_percent"], r["bias_se"])
        else:
            found[f"{key}/above"] = Estimate(r["above_percent"], r["above_se"])
    return found


def fig7(frame: pd.DataFrame) -> Figure:
    """Mean number of iterations of the three iterative estimators [Le 2021, Fig. 7]."""
    figure, axis = new(0.6 * PAGE, 2.8)
    for name in list(NAMES)[1:]:
        _curve(
            axis,
            _of(frame, name),
            "sigma_deg",
            "iterations",
            "iterations_se",
            label=NAMES[name],
            **STYLES[name],
        )
    axis.set(xlabel=SIGMA, ylabel="mean number of iterations", yscale="log")
    axis.set_yticks(ticks := [2, 3, 5, 10, 20], [str(t) for t in ticks])
    axis.minorticks_off()
    axis.legend()
    return figure


def fig7_values(frame: pd.DataFrame) -> dict[str, Estimate]:
    """Iterations of the other ML estimators minus those of the proposed one, paired over
    positions.
    """
    others = frame[frame["estimator"].isin(["ml_arctan", "ml_atan2"])]
    return {
        f"fig7/{r['sigma_deg']:g}/{r['estimator']}/more": Estimate(
            r["more_iterations"], r["more_se"]
        )
        for r in others.to_dict("records")
    }


# --- Table I --------------------------------------------------------------------------------------


def table1(frame: pd.DataFrame) -> Figure:
    """Shares, errors and iterations of the classes over all deviations [Le 2021, Table I]."""
    figure, axes = new(PAGE, 2.6, cols=3, sharey=True)
    rows = frame[frame["sigma_deg"].isna()]
    labels = [f"{NAMES[r['estimator']]}: {r['class']}" for r in rows.to_dict("records")]
    colours = [STYLES[name]["color"] for name in rows["estimator"]]
    y = -np.arange(len(rows))
    for axis, (column, label) in zip(
        axes,
        (
            ("share", "share of the fixes [%]"),
            ("rmse_m", "RMSE, and median (bar) [m]"),
            ("iterations", "iterations"),
        ),
    ):
        scale = 100 if column == "share" else 1
        bars = scale * error_bars(rows, column, "rmse_se" if column == "rmse_m" else "", log=True)
        for i in range(len(rows)):
            value = scale * rows[column].iloc[i]
            if value > 0:
                axis.errorbar(
                    value,
                    y[i],
                    xerr=np.nan_to_num(bars[:, i : i + 1]),
                    fmt="o",
                    color=colours[i],
                    capsize=2,
                )
        if column == "rmse_m":
            axis.scatter(rows["median_m"], y, marker="|", s=60, color=colours, linewidths=1.5)
        axis.set(xscale="log", xlabel=label)
    axes[0].set_yticks(y, labels)
    return figure


def table1_values(frame: pd.DataFrame) -> dict[str, Estimate]:
    """Over all deviations: iterations and share of each class, and the ratio of its RMSE to that of
    the converged fixes.
    """
    found = {}
    for r in frame[frame["sigma_deg"].isna()].to_dict("records"):
        key = f"table1/{r['estimator']}/{r['class']}"
        found[f"{key}/iterations"] = Estimate(r["iterations"], r["iterations_se"])
        if r["class"] != "convergence":
            found[f"{key}/rmse"] = Estimate(r["over_converged"], r["over_converged_se"])
        found[f"{key}/share"] = Estimate(r["share"], r["share_se"]).percent()
    return found


# --- errata, zones, pole --------------------------------------------------------------------------

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
        rows = _of(frame[frame["variant"] == variant], "ml_kcorr")
        _curve(left, rows, "sigma_deg", "rmse_m", "rmse_se", label=label, **style)
        if variant in ("sign", "invariant"):
            above = rows["above_meant_percent"]
            bars = error_bars(rows, "above_meant_percent", "above_meant_se")
            right.errorbar(rows["sigma_deg"], above, yerr=bars, capsize=2, elinewidth=0.8, **style)
    rows = _of(frame[frame["variant"] == "meant"], "ml_kcorr")
    bound(left, rows["sigma_deg"], rows["bound_m"])
    left.set(xlabel=SIGMA, ylabel="RMSE of (d) [m]", yscale="log")
    right.axhline(0, color="black", lw=0.8, ls=":")
    right.set(xlabel=SIGMA, ylabel="RMSE of (d) above corrected [%]")
    figure.legend(*left.get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


def errata_values(frame: pd.DataFrame) -> dict[str, Estimate]:
    """RMSE above that of the corrected estimator, in percent."""
    return {
        f"errata/{r['variant']}/{r['sigma_deg']:g}/{r['estimator']}": Estimate(
            r["above_meant_percent"], r["above_meant_se"]
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
            rows = _of(frame[frame["zone"] == where], name)
            look = {"color": colour, "marker": marker, "ls": line, "ms": 3, "label": where}
            _curve(axis, rows, "sigma_deg", "ratio", "ratio_se", **look)
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


def pole(frame: pd.DataFrame) -> Figure:
    """RMSE over the bound against the distance from a column of base stations: in space, and in the
    plane.
    """
    figure, axes = new(PAGE, 4.8, rows=2, cols=2, sharex=True, sharey=True)
    for column, (sigma, part) in zip(axes.T, frame.groupby("sigma_deg")):
        for axis, ratio, what in zip(column, ("ratio", "ratio_xy"), ("3-D", "horizontal")):
            for name, label in NAMES.items():
                rows = part[part["estimator"] == name].sort_values("distance_m")
                _curve(axis, rows, "distance_m", ratio, f"{ratio}_se", label=label, **STYLES[name])
            bound_ratio(axis, BOUND_LABEL)
            axis.set(xscale="log", yscale="log", title=f"{what}, {sigma:g} deg")
    figure.supxlabel("horizontal distance from a column of base stations [m]", fontsize=8)
    figure.supylabel("RMSE / square root of the CRB", fontsize=8)
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure
