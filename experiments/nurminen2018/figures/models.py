"""Table I and Figures 1 and 2: models of the noise, and one update near the pole."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from aoabench.maths.estimate import Estimate, stored
from aoabench.report.plots import COLOURS, GREY, LABELS, MARKERS, PAGE, new

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def table1_values(frame: pd.DataFrame) -> dict[str, tuple[Estimate, float]]:
    """Shares and fitted parameters with the number of samples behind them, and how much further the
    distance of AE-adaptive from VMF is with data of Model II.
    """
    found = {
        f"table1/{r['data']}/{r['model']}/{r['quantity']}": (
            stored(r, "value", "se"),
            float(r["samples"]),
        )
        for r in frame.to_dict("records")
    }
    if "table1/model1/ae_adaptive/distance" in found:  # not in a table of an earlier version
        (first, n), (second, _) = (found[f"table1/model{k}/ae_adaptive/distance"] for k in (1, 2))
        found["table1/ae_adaptive/further_in_model2"] = (second - first, n)
    return found


def fig1(frame: pd.DataFrame) -> Figure:
    """Deviations of azimuth (left) and elevation (right) noise against the true elevation [Nurminen
    2018, Fig. 1].
    """
    figure, (left, right) = new(PAGE, 2.4, cols=2, sharex=True)
    x = frame["elevation_deg"]
    left.plot(x, frame["azimuth_deg"], color=COLOURS["vmf"])
    left.set(ylabel="azimuth deviation [deg]", ylim=(0, None))
    right.plot(x, frame["elevation_about_truth_deg"], color=COLOURS["vmf"], label="about the truth")
    right.plot(
        x,
        frame["elevation_about_mean_deg"],
        color=COLOURS["ae_nominal"],
        ls="--",
        label="about the mean",
    )
    right.set(ylabel="elevation deviation [deg]", ylim=(0, 12))
    right.legend(loc="lower center")
    for axis in (left, right):
        axis.set(xlabel="true elevation [deg]", xlim=(-90, 90), xticks=range(-90, 91, 30))
    return figure


def fig1_values(frame: pd.DataFrame) -> dict[str, Estimate]:
    """Deviations at the equator, and the azimuth's deviation at the pole over that at the
    equator.
    """
    at = frame.set_index("elevation_deg")
    return {
        "fig1/azimuth_at_equator": Estimate(at.loc[0.0, "azimuth_deg"], 0.0),
        "fig1/elevation_at_equator": Estimate(at.loc[0.0, "elevation_about_truth_deg"], 0.0),
        "fig1/growth_at_pole": Estimate(
            at.loc[90.0, "azimuth_deg"] / at.loc[0.0, "azimuth_deg"], 0.0
        ),
    }


def fig2(frame: pd.DataFrame) -> Figure:
    """Lines from the prior mean to the posterior means, from above and from the side [Nurminen
    2018, Fig. 2].
    """
    figure, axes = new(PAGE, 3.3, cols=2)
    for axis, plane, title in zip(axes, ((0, 1), (0, 2)), ("from above", "from the side")):
        _view(axis, frame, plane)
        axis.set_aspect("equal", adjustable="datalim")
        axis.set_title(title)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside right center")
    return figure


def _view(axis: Any, frame: pd.DataFrame, plane: tuple[int, int]) -> None:
    """Draw Figure 2's positions in a plane, given by the numbers of its two coordinates."""
    u, v = (("x_m", "y_m", "z_m")[i] for i in plane)
    prior = frame[frame["method"] == "prior"].iloc[0]
    ray = np.array([-np.cos(9 * np.pi / 20), 0.0, -np.sin(9 * np.pi / 20)])
    end = 1.05 * np.abs(frame["z_m"]).max() / abs(ray[2]) * ray[list(plane)]
    axis.plot([0, end[0]], [0, end[1]], color=GREY, ls=":", label="measured direction")
    axis.plot(0, 0, "P", color="black", ms=6, label="anchor (pole axis through it)")
    shown = frame[frame["model"].isin(["ae_nominal", "vmf"])]
    for r in shown[shown["method"] != "exact"].to_dict("records"):
        line, label = {"ekf": "-", "ukf": "--"}[r["method"]], LABELS[r["model"]]
        look = {"color": COLOURS[r["model"]], "marker": MARKERS[r["model"]], "markevery": [1]}
        look["label"] = f"{r['method'].upper()}-{label}"
        axis.plot([prior[u], r[u]], [prior[v], r[v]], line, **look)
    for r in shown[shown["method"] == "exact"].to_dict("records"):
        look = {"color": COLOURS[r["model"]], "ms": 10, "mec": "black", "mew": 0.6}
        axis.plot(r[u], r[v], "*", label=f"exact, {LABELS[r['model']]}", **look)
    axis.plot(prior[u], prior[v], "o", mfc="white", mec="black", ms=6, label="prior mean")
    axis.set(xlabel=f"{u[0]} [m]", ylabel=f"{v[0]} [m]")


def fig2_values(frame: pd.DataFrame) -> dict[str, Estimate]:
    """Angles in deg of each posterior mean to the measured direction, and of each EKF's horizontal
    step to the clockwise tangent of the circle through the prior's mean.
    """
    prior = frame[frame["method"] == "prior"][["x_m", "y_m"]].to_numpy()[0]
    tangent = np.array([prior[1], -prior[0]]) / np.linalg.norm(prior)
    found = {}
    for r in frame.to_dict("records"):
        key = f"fig2/{r['method']}/{r['model']}"
        found[f"{key}/angle"] = Estimate(r["angle_to_measurement_deg"], 0.0)
        if r["method"] == "ekf":
            step = np.array([r["x_m"], r["y_m"]]) - prior
            cosine = step @ tangent / np.linalg.norm(step)
            found[f"{key}/off_tangent"] = Estimate(float(np.rad2deg(np.arccos(cosine))), 0.0)
    return found
