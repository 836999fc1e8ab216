"""Figures 5 to 8: distributions of the errors, and medians over the room."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from aoabench.maths.estimate import Estimate, stored
from aoabench.report.plots import GREY, PAGE, error_bars, new

from .common import ERROR, NAMES, PRINTED, PRINTED_AT, STYLES, estimate, points, printed, raster

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def _band(axis: Any, rows: pd.DataFrame, **style: Any) -> None:
    axis.plot(rows["error_m"], rows["cdf"], **style)
    below, above = error_bars(rows, "cdf")
    low, high = rows["cdf"] - below, rows["cdf"] + above
    axis.fill_between(rows["error_m"], low, high, color=style["color"], alpha=0.12, lw=0)


def fig5(frame: pd.DataFrame) -> Figure:
    """CDFs of the discrepancy filter for some R_sigma, and without its second stage [Boquet 2024,
    Fig. 5].
    """
    from matplotlib import colormaps

    figure, axis = new(0.65 * PAGE, 3.2)
    for r in (0.2, 0.4, 0.6, 1.0, 1.4, 2.0):
        rows = frame[np.isclose(frame["r_sigma"], r)]
        lost = rows["lost"].iloc[0]
        label = rf"$R_\sigma$ = {r:g}, $R_d$ = {lost:.2f}"
        _band(axis, rows, color=colormaps["viridis"](r / 2.3), label=label)
    _band(axis, frame[frame["r_sigma"].isna()], color=GREY, ls=":", label="without S2, $R_d$ = 0")
    within = [printed[f"misfit/within/{r:g}"] for r in PRINTED_AT]
    axis.plot([1, 1], within, **{**PRINTED, "label": "printed, 0.4 and 2"})
    axis.set(xlabel=ERROR, ylabel="share of the given fixes", xlim=(0, 4), ylim=(0, 1))
    axis.legend()
    return figure


def fig5_values(frame: pd.DataFrame) -> dict[str, Estimate]:
    """P(error <= 1 m) for each R_sigma and without the vote."""
    rows = frame[np.isclose(frame["error_m"], 1.0)].to_dict("records")
    return {f"fig5/{r['method']}/within": estimate(r, "cdf") for r in rows}


def fig6(frame: pd.DataFrame) -> Figure:
    """RMSE, CEP90 and both readings of the discard ratio against R_sigma [Boquet 2024, Fig. 6]."""
    figure, (left, right) = new(PAGE, 2.8, cols=2)
    for axis, key, label, colour, marker in (
        (left, "rmse_m", "RMSE", "#0072B2", "o"),
        (left, "cep90_m", "CEP90", "#D55E00", "s"),
        (right, "lost", "fixes lost (the default)", "#0072B2", "o"),
        (right, "discarded", "measurements discarded", "#E69F00", "s"),
    ):
        style = {"color": colour, "marker": marker, "ms": 3}
        points(axis, frame["r_sigma"], frame, key, label=label, **style)
    right.plot(PRINTED_AT, [printed[f"misfit/lost/{r:g}"] for r in PRINTED_AT], **PRINTED)
    left.set(xlabel=r"$R_\sigma$", ylabel="error [m]", ylim=(0, None))
    right.set(xlabel=r"$R_\sigma$", ylabel=r"discard ratio $R_d$", ylim=(0, 1))
    for axis in (left, right):
        axis.legend()
    return figure


def fig6_values(frame: pd.DataFrame) -> dict[str, Estimate]:
    """Each measure for each R_sigma, its steps from one R_sigma to the next, the rise of RMSE and
    CEP90 from R_sigma 0.2 to 2, and how much less R_d falls from 1.6 to 1.8 than from 0.6 to 0.8.
    Steps of P(error <= 1 m) are in percentage points.
    """
    found = {}
    measures = [name for name in frame if f"{name}_se" in frame]
    shown = [name for name in measures if not name.endswith(("_rise", "_slower"))]
    for r in frame.to_dict("records"):
        for name in shown:
            if np.isfinite(r[name]):
                value = estimate(r, name)
                if name == "within_1m_more":
                    value = value.percent()
                found[f"fig6/{r['r_sigma']:g}/{name}"] = value
        for name in ("lost", "discarded"):
            found[f"fig6/{r['r_sigma']:g}/{name}_percent"] = estimate(r, name).percent()
        found[f"fig6/{r['r_sigma']:g}/given_percent"] = (-1 * estimate(r, "lost") + 1).percent()
    by = {round(r["r_sigma"], 1): r for r in frame.to_dict("records")}
    for name in ("rmse_m", "cep90_m"):
        found[f"fig6/{name}/rise"] = estimate(by[2.0], f"{name}_rise")
    for name in ("lost", "discarded"):
        found[f"fig6/{name}/early minus late"] = estimate(by[1.8], f"{name}_slower")
    return found


def fig7(frame: pd.DataFrame) -> Figure:
    """CDFs of all methods: on own fixes, and on those that DF gives [Boquet 2024, Fig. 7]."""
    filters = [m for m in frame["method"].unique() if m.startswith("df")]
    figure, axes = new(PAGE, 5.4, rows=2, cols=2, sharex=True, sharey=True)
    lines = dict(zip(filters, ("-", "--", ":")))
    for axis, on in zip(axes.ravel(), ["own fixes", *filters]):
        rows = frame[frame["on"] == on]
        for name in NAMES:
            part = rows[rows["method"] == name]
            if len(part):
                axis.plot(part["error_m"], part["cdf"], label=NAMES[name], lw=1, **STYLES[name])
        own = frame[frame["on"] == "own fixes"]
        for name in filters if on == "own fixes" else [on]:
            part = own[own["method"] == name]
            axis.plot(
                part["error_m"], part["cdf"], color="#D55E00", lw=2, ls=lines[name], label=_df(name)
            )
        title = on if on == "own fixes" else f"on the fixes of {_df(on)}"
        axis.set(title=title, xlim=(0, 4), ylim=(0, 1))
    figure.supxlabel(ERROR, fontsize=8)
    figure.supylabel("share of the fixes", fontsize=8)
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=5)
    return figure


def fig7_values(frame: pd.DataFrame) -> dict[str, Estimate]:
    """P(error <= 1 m) of each curve."""
    rows = frame[np.isclose(frame["error_m"], 1.0)].to_dict("records")
    return {f"fig7/{r['on']}/{r['method']}/within": estimate(r, "cdf") for r in rows}


def _df(name: str) -> str:
    return "DF" + name[2:].replace("R_sigma", r"$R_\sigma$").replace("R_d", r"$R_d$")


def fig8(frame: pd.DataFrame) -> Figure:
    """Median errors at each point: ours for every method, then the printed grids [Boquet 2024, Fig.
    8].
    """
    from matplotlib.colors import BoundaryNorm, ListedColormap

    shades = ListedColormap(["#009E73", "#F0E442", "#D55E00"])
    norm = BoundaryNorm([0, 0.5, 1, 1e9], 3)
    panels = [(f"{NAMES[m]}, ours", m, "median_m") for m in NAMES]
    panels += [
        (f"{NAMES[m]}, printed", m, "printed_m")
        for m in ("single_anchor_2", "anchor_mean", "vmf_ml")
    ]
    panels += [("M IAD or A rssi, printed", "ls_anchor_discarding", "unnamed_m")]
    figure, axes = new(PAGE, 6.0, rows=3, cols=5, sharex=True, sharey=True)
    for axis, (title, method, column) in zip(axes.ravel(), panels):
        rows = frame[frame["method"] == method]
        raster(axis, rows, rows[column].to_numpy(), cmap=shades, norm=norm, alpha=0.55)
        for r in rows.to_dict("records"):
            axis.text(
                r["x_m"], r["y_m"], f"{r[column]:.2f}", ha="center", va="center", fontsize=4.5
            )
        axis.plot([3.7, 1.8, 5.6], [4.0, 6.9, 6.9], "^", color="white", ms=11, zorder=1.5)
        axis.set(title=title)
    for axis in axes.ravel()[len(panels) :]:
        axis.set_axis_off()
    handles = [
        _patch(c, label)
        for c, label in zip(shades.colors, ("up to 0.5 m", "up to 1 m", "above 1 m"))
    ]
    axes.ravel()[len(panels)].legend(handles=handles, title="median error", loc="center")
    figure.supxlabel("x [m]", fontsize=8)
    figure.supylabel("y [m]", fontsize=8)
    return figure


def _patch(colour: str, label: str) -> Any:
    from matplotlib.patches import Patch

    return Patch(color=colour, alpha=0.55, label=label)


def fig8_values(frame: pd.DataFrame) -> dict[str, Estimate]:
    """The median error in m of each method at each point, and of the filter that minus A_1's."""
    found = {}
    for r in frame.to_dict("records"):
        at = f"fig8/{r['method']}/{r['x_m']:g},{r['y_m']:g}"
        found[at] = stored(r, "median_m", "median_se")
        if r["method"] == "discrepancy":
            found[f"{at}/more"] = estimate(r, "more_m")
    return found
