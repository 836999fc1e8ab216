"""Figures 5 to 7: positions, RMSE and bound, iterations."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from aoabench.maths.estimate import Estimate
from aoabench.report.plots import PAGE, bound, bound_ratio, new

from .common import NAMES, SIGMA, STYLES, curve, of, read

if TYPE_CHECKING:
    from matplotlib.figure import Figure


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


def fig5_values(frame: pd.DataFrame) -> dict[str, Estimate]:
    """Numbers of base stations and positions, and the largest elevation between them."""
    stations, points = (
        frame.loc[frame["kind"] == kind, ["x_m", "y_m", "z_m"]].to_numpy()
        for kind in ("base station", "position")
    )
    away = points[:, None] - stations
    elevation = np.arctan2(np.abs(away[..., 2]), np.hypot(away[..., 0], away[..., 1]))
    return {
        "fig5/base_stations": Estimate(float(len(stations)), 0.0),
        "fig5/positions": Estimate(float(len(points)), 0.0),
        "fig5/largest_elevation": Estimate(float(np.rad2deg(elevation.max())), 0.0),
    }


def fig6(frame: pd.DataFrame) -> Figure:
    """RMSE of the four estimators with the bound [Le 2021, Fig. 6], ratios to the bound, and shares
    of gross errors.
    """
    figure, (left, middle, right) = new(PAGE, 2.8, cols=3)
    for name, label in NAMES.items():
        curve(left, of(frame, name), "sigma_deg", "rmse_m", "rmse_se", label=label, **STYLES[name])
    rows = of(frame, "ls")
    bound(left, rows["sigma_deg"], rows["bound_m"])
    left.set(xlabel=SIGMA, ylabel="RMSE [m]", yscale="log")
    for name in ("ls", "ml_kcorr"):
        curve(
            middle,
            of(frame, name),
            "sigma_deg",
            "ratio",
            "ratio_se",
            label=NAMES[name],
            **STYLES[name],
        )
    bound_ratio(middle)
    middle.set(xlabel=SIGMA, ylabel="RMSE / square root of the CRB")
    for name in ("ml_arctan", "ml_atan2"):
        rows = of(frame, name)
        rows = rows[rows["gross_percent"] > 0]
        curve(right, rows, "sigma_deg", "gross_percent", "gross_percent_se", **STYLES[name])
    right.set(xlabel=SIGMA, ylabel="share of gross errors [%]", yscale="log")
    figure.legend(*left.get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


def fig6_values(frame: pd.DataFrame) -> dict[str, Estimate]:
    """Per deviation: RMSEs, their excess over the proposed estimator's, what few large errors do
    not decide, the bound, and ratio to the bound and squared bias of the proposed one.
    """
    found = {}
    for r in frame.to_dict("records"):
        key = f"fig6/{r['sigma_deg']:g}/{r['estimator']}"
        numbers = {"rmse": read(r, "rmse_m", "rmse_se"), "gross": read(r, "gross_percent")}
        if r["estimator"] == "ml_kcorr":
            numbers |= {"ratio": read(r, "ratio"), "bias": read(r, "bias_percent", "bias_se")}
            found[f"fig6/{r['sigma_deg']:g}/bound"] = read(r, "bound_m", "bound_se")
        else:
            numbers["above"] = read(r, "above_percent", "above_se")
            numbers |= {word: read(r, f"{word}_percent") for word in ("capped", "kept", "median")}
        found |= {f"{key}/{name}": number for name, number in numbers.items()}
    return found


def fig7(frame: pd.DataFrame) -> Figure:
    """Mean number of iterations of the three iterative estimators [Le 2021, Fig. 7]."""
    figure, axis = new(0.6 * PAGE, 2.8)
    for name in list(NAMES)[1:]:
        curve(
            axis,
            of(frame, name),
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
    """Per deviation the iterations; for the other ML estimators, paired over positions, the
    iterations more than those of the proposed one and the percentage points by which fewer
    converge.
    """
    found = {}
    for r in frame[frame["estimator"] != "ls"].to_dict("records"):
        numbers = {"iterations": read(r, "iterations")}
        if r["estimator"] != "ml_kcorr":
            numbers["more"] = read(r, "more_iterations", "more_se")
            numbers["fewer"] = read(r, "fewer_converged", "fewer_se")
        key = f"fig7/{r['sigma_deg']:g}/{r['estimator']}"
        found |= {f"{key}/{name}": e for name, e in numbers.items()}
    return found
