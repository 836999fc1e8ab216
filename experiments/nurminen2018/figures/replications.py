"""Figures 3 and 4, turned anchor frames and numbers of particles."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from aoabench.maths.estimate import Estimate, stored
from aoabench.report.plots import COLOURS, GREY, LABELS, MARKERS, PAGE, boxes, error_bars, new

from .common import MODELS, ORDER, TITLES, colour, counts, label, numbers_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def frames(frame: pd.DataFrame) -> Figure:
    """Mean RMSE with error bars of each filter in each anchor frame."""
    figure, axis = new(PAGE, 2.8)
    estimators = list(frame["estimator"].unique())[::-1]
    turns = list(frame["frame_rpy_deg"].unique())
    for k, (turn, marker) in enumerate(zip(turns, ("o", "s", "^"))):
        rows = frame[frame["frame_rpy_deg"] == turn].set_index("estimator").loc[estimators]
        y = np.arange(len(estimators)) + 0.22 * (1 - k)
        look = {"capsize": 2, "elinewidth": 0.8, "label": f"roll, pitch, yaw {turn} deg"}
        axis.errorbar(
            rows["rmse_mean_3d_m"],
            y,
            xerr=error_bars(rows, "rmse_mean_3d_m", "se_m"),
            fmt=marker,
            **look,
        )
    axis.set_yticks(range(len(estimators)), [label(name) for name in estimators])
    axis.set(xlabel="mean 3-D RMSE [m]", xlim=(0, None))
    axis.grid(axis="y", visible=False)
    figure.legend(loc="outside upper center", ncols=3, title="anchor frames turned by")
    return figure


def frames_values(frame: pd.DataFrame) -> dict[str, Estimate]:
    """Change of each filter's mean RMSE in percent from the unturned frames, and its size."""
    found = {}
    for r in frame[frame["frame_rpy_deg"] != "[0, 0, 0]"].to_dict("records"):
        key = f"frames/{r['estimator']}/{r['frame_rpy_deg'].strip('[]').replace(' ', '')}"
        change = stored(r, "change_percent", "change_se")
        found[f"{key}/change"] = change
        found[f"{key}/size"] = math.copysign(1.0, change.value) * change
    return found


def fig3(frame: pd.DataFrame) -> Figure:
    """One simulated lap with the particle filters' estimates [Nurminen 2018, Fig. 3]."""
    figure, axes = new(PAGE, 3.6, cols=2, sharex=True, sharey=True)
    for axis, noise in zip(axes, TITLES):
        rows = frame[frame["noise"] == noise]
        axis.plot([0, 5, 5, 0, 0], [0, 0, 5, 5, 0], color="black", lw=0.8, label="track")
        truth = rows[rows["kind"] == "truth"]
        axis.plot(truth["x_m"], truth["y_m"], "k.", ms=4, label="true positions")
        for model in ("ae_nominal", "ae_fitted", "ae_adaptive", "vmf"):
            track = rows[rows["kind"] == f"pf_{model}"]
            look = {"color": COLOURS[model], "marker": MARKERS[model], "ms": 2.5, "lw": 0.8}
            axis.plot(track["x_m"], track["y_m"], label=f"PF-{LABELS[model]}", **look)
        anchors = rows[rows["kind"] == "anchor"]
        place = anchors["x_m"], anchors["y_m"]
        arrows = {"angles": "xy", "scale": 16, "width": 0.008}
        axis.quiver(*place, anchors["pole_x"], anchors["pole_y"], color=GREY, **arrows)
        axis.plot(*place, "X", color=GREY, ms=6, label="anchor and its pole")
        axis.set_title(TITLES[noise])
        axis.set(xlabel="x [m]", aspect="equal")
    axes[0].set_ylabel("y [m]")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return figure


def fig4(frame: pd.DataFrame) -> Figure:
    """Box plots of percentage RMSE differences from PF-VMF, both data models [Nurminen 2018, Fig.
    4].
    """
    figure, axes = new(PAGE, 3.6, cols=2, sharey=True)
    names = [n for n in ORDER if n != "pf_vmf"][::-1]
    for axis, noise in zip(axes, TITLES):
        rows = frame[frame["noise"] == noise].set_index("estimator").loc[names]
        levels = [r for _, r in rows.iterrows()]
        boxes(axis, levels, list(range(len(names))), [colour(n) for n in names])
        axis.axvline(0, color="black", lw=0.8, ls=":")
        axis.set_title(TITLES[noise])
        axis.set(xlabel="RMSE difference from PF-VMF [%]")
        axis.set_yticks(range(len(names)), [label(n) for n in names])
    figure.suptitle(counts(frame), fontsize=8)
    return figure


def fig4_values(frame: pd.DataFrame) -> dict[str, Estimate]:
    """The numbers of each filter on the base layout."""
    found = {}
    for r in frame.to_dict("records"):
        found |= numbers_of(r, f"fig4/{r['noise']}/{r['estimator']}")
    return found


def readings(frame: pd.DataFrame) -> Figure:
    """Mean RMSE of AE-adaptive above the same filter with VMF, for each reading of its name."""
    figure, axes = new(PAGE, 2.2, cols=2, sharey=True)
    names = [n for n in ORDER if "adaptive" in n][::-1]
    for axis, noise in zip(axes, TITLES):
        for about, marker, shift in (("truth", "o", 0.12), ("mean", "s", -0.12)):
            rows = frame[(frame["noise"] == noise) & (frame["about"] == about)]
            rows = rows.set_index("estimator").loc[names]
            bars = error_bars(rows, "above_vmf_percent", "above_vmf_se")
            look = {"fmt": marker, "ms": 3.5, "capsize": 2, "elinewidth": 0.8}
            look["label"] = f"deviations about the {about}"
            y = np.arange(len(names)) + shift
            axis.errorbar(rows["above_vmf_percent"], y, xerr=bars, **look)
        axis.axvline(0, color="black", lw=0.8, ls=":")
        axis.set_title(TITLES[noise])
        axis.set_yticks(range(len(names)), [label(n) for n in names])
    figure.supxlabel("mean RMSE above the same filter with VMF [%]", fontsize=8)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure


def readings_values(frame: pd.DataFrame) -> dict[str, Estimate]:
    """The numbers of AE-adaptive in each filter and reading."""
    found = {}
    for r in frame.to_dict("records"):
        found |= numbers_of(r, f"readings/{r['about']}/{r['noise']}/{r['estimator']}")
    return found


def particles(frame: pd.DataFrame) -> Figure:
    """Mean RMSE against the number of particles, both data models."""
    figure, axes = new(PAGE, 2.8, cols=2, sharey=True)
    for axis, noise in zip(axes, TITLES):
        for model in MODELS:
            rows = frame[(frame["noise"] == noise) & (frame["estimator"] == f"pf_{model}")]
            look = {"color": COLOURS[model], "marker": MARKERS[model]}
            look |= {"capsize": 2, "elinewidth": 0.8, "label": f"PF-{LABELS[model]}"}
            value, bars = rows["rmse_mean_3d_m"], error_bars(rows, "rmse_mean_3d_m", "se_m")
            axis.errorbar(rows["particles"], value, yerr=bars, **look)
        axis.set_title(TITLES[noise])
        axis.set(xlabel="particles", xscale="log")
    axes[0].set(ylabel="mean 3-D RMSE [m]", ylim=(0, None))
    axes[1].legend()
    return figure


def particles_values(frame: pd.DataFrame) -> dict[str, Estimate]:
    """Paired excess in percent of the RMSE over the one with most particles."""
    found = {}
    for r in frame[frame["particles"] < frame["particles"].max()].to_dict("records"):
        above = stored(r, "above_largest_percent", "above_largest_se")
        found[f"particles/{r['noise']}/{r['particles']}/{r['estimator']}"] = above
    return found
