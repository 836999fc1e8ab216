"""The variants of the layout: all filters, and the effect of adaptivity."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from aoabench.maths.estimate import Estimate, stored
from aoabench.report.plots import LABELS, PAGE, error_bars, new

from .common import ORDER, TITLES, counts, label, numbers_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure


LAYOUTS = [f"square_track{variant}" for variant in ("", "_far", "_corner", "_sides", "_upright")]


def layouts(frame: pd.DataFrame) -> Figure:
    """Mean RMSE relative to PF-VMF for each layout, both data models."""
    names = [n for n in ORDER if n != "pf_vmf"][::-1]
    figure, axes = new(PAGE, 3.4, cols=len(LAYOUTS), sharey=True, sharex=True)
    for axis, layout in zip(axes, LAYOUTS):
        rows = frame[frame["layout"] == layout].set_index("estimator")
        _both_data_models(axis, rows, names, "above_pf_vmf")
        axis.set_title(_title(layout))
        axis.set_yticks(range(len(names)), [label(n) for n in names])
        axis.set_xticks([0, 50, 100, 150])
    figure.supxlabel(f"difference of mean RMSE from PF-VMF [%], {counts(frame)}", fontsize=8)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure


def _both_data_models(axis: Any, rows: pd.DataFrame, order: list[Any], column: str) -> None:
    """Draw a difference in percent with error bars, a line for each of `order`."""
    for noise, marker, shift in (("ae_flip", "o", 0.15), ("vmf", "s", -0.15)):
        shown = rows[rows["noise"] == noise].loc[order]
        value, bars = (
            shown[f"{column}_percent"],
            error_bars(shown, f"{column}_percent", f"{column}_se"),
        )
        look = {"ms": 3, "capsize": 1.5, "elinewidth": 0.8, "label": TITLES[noise]}
        axis.errorbar(value, np.arange(len(order)) + shift, xerr=bars, fmt=marker, **look)
    axis.axvline(0, color="black", lw=0.8, ls=":")


def _title(layout: str) -> str:
    return layout.removeprefix("square_track").removeprefix("_") or "base"


def layouts_values(frame: pd.DataFrame) -> dict[str, Estimate]:
    """The numbers of each filter on each layout but the base one, which Figure 4 has."""
    found = {}
    for r in frame[frame["layout"] != LAYOUTS[0]].to_dict("records"):
        found |= numbers_of(r, f"layouts/{_title(r['layout'])}/{r['noise']}/{r['estimator']}")
    return found


def adaptivity(frame: pd.DataFrame) -> Figure:
    """Mean RMSE of EKF and UKF with AE-adaptive relative to the same filter with AE-nominal and
    AE-fitted.
    """
    figure, axes = new(PAGE, 2.6, cols=len(LAYOUTS), sharey=True, sharex=True)
    filters = ("ekf_ae_adaptive", "ukf_ae_adaptive", "ukf_ae_adaptive_augmented")
    pairs = [(name, other) for name in filters for other in ("ae_nominal", "ae_fitted")][::-1]
    for axis, layout in zip(axes, LAYOUTS):
        rows = frame[frame["layout"] == layout].set_index(["estimator", "other"])
        _both_data_models(axis, rows, pairs, "above")
        axis.set_title(_title(layout))
        axis.set_yticks(range(len(pairs)), [f"{label(n)} over {LABELS[o]}" for n, o in pairs])
    replications = frame["replications"].iloc[0]
    text = f"mean RMSE of AE-adaptive above [%], {replications} replications"
    figure.supxlabel(text, fontsize=8)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure


def adaptivity_values(frame: pd.DataFrame) -> dict[str, Estimate]:
    """Mean RMSE of AE-adaptive above that of the same filter with another AE model, in percent."""
    found = {}
    for r in frame.to_dict("records"):
        key = f"adaptivity/{_title(r['layout'])}/{r['noise']}/{r['estimator']}/above_{r['other']}"
        found[key] = stored(r, "above_percent", "above_se")
    return found
