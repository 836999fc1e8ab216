"""Figures 5 to 8: distributions of the errors, and medians over the room."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from aoabench.maths.statistics import Estimate
from aoabench.report.plots import GREY, PAGE, new

from .common import ERROR, NAMES, PRINTED, PRINTED_AT, STYLES, estimate, points, printed, raster

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def _band(axis: Any, rows: pd.DataFrame, **style: Any) -> None:
    axis.plot(rows["error_m"], rows["cdf"], **style)
    low, high = rows["cdf"] - 3 * rows["cdf_se"], rows["cdf"] + 3 * rows["cdf_se"]
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
    within = [printed[f"fig5/{r:g}/within"] for r in PRINTED_AT]
    axis.plot([1, 1], within, **{**PRINTED, "label": "printed, 0.4 and 2"})
    axis.set(xlabel=ERROR, ylabel="share of the given fixes", xlim=(0, 4), ylim=(0, 1))
    axis.legend()
    return figure


def fig5_values(frame: pd.DataFrame) -> dict[str, Estimate]:
    """P(error <= 1 m) for each R_sigma and without the vote."""
    rows = frame[np.isclose(frame["error_m"], 1.0)].to_dict("records")
    return {
        f"fig5/{'no vote' if r['r_sigma'] != r['r_sigma'] else format(r['r_sigma'], 'g')}"
        "/within": estimate(r, "cdf")
        for r in rows
    }


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
    right.plot(PRINTED_AT, [printed[f"fig6/{r:g}/lost"] for r in PRINTED_AT], **PRINTED)
    left.set(xlabel=r"$R_\sigma$", ylabel="error [m]", ylim=(0, None))
    right.set(xlabel=r"$R_\sigma$", ylabel=r"discard ratio $R_d$", ylim=(0, 1))
    for axis in (left, right):
        axis.legend()
    return figure


def fig6_values(frame: pd.DataFrame) -> dict[str, Estimate]:
    """Discard ratios, how RMSE and CEP90 rise from R_sigma 0.2 to 2, and the steps of R_d.

    Differences between R_sigmas take their errors as independent.
    """
    by = {round(r["r_sigma"], 1): r for r in frame.to_dict("records")}
    found = {
        f"fig6/{r:g}/{key}": estimate(by[r], key)
        for r in PRINTED_AT
        for key in ("lost", "discarded")
    }
    for key in ("rmse_m", "cep90_m"):
        found[f"fig6/{key}/rise"] = estimate(by[2.0], key) - estimate(by[0.2], key)
    steps = {r: estimate(row, "lost_less") for r, row in by.items()}
    found["fig6/lost/least step"] = min((steps[r] for r in sorted(by)[1:]), key=lambda s: s.value)
    found["fig6/lost/early minus late"] = steps[0.7] + steps[0.8] - steps[1.7] - steps[1.8]
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


def _error_of_mean(se: Any) -> float:
    """Standard error of the mean of independent numbers from their standard errors (N,)."""
    return float(np.sqrt((se**2).sum()) / len(se))


def fig8_values(frame: pd.DataFrame) -> dict[str, Estimate]:
    """Means of the medians over the room, and over its inner part (y > 4 m) and outer part against
    A1's.
    """
    found = {}
    mean = frame.groupby("method")[["median_m", "printed_m", "unnamed_m"]].mean()
    for name, row in mean.iterrows():
        se = frame.loc[frame["method"] == name, "median_se"]
        found[f"fig8/{name}/mean"] = Estimate(float(row["median_m"]), _error_of_mean(se))
    wide = frame.pivot(index=["x_m", "y_m"], columns="method", values="median_m").reset_index()
    se = frame.pivot(index=["x_m", "y_m"], columns="method", values="median_se").reset_index()
    inner = wide["y_m"] > 4
    for part, rows in (("inner", inner), ("outer", ~inner)):
        for name in ("anchor_mean", "discrepancy"):
            d = (wide[name] - wide["single_anchor_1"])[rows]
            e = np.hypot(se[name], se["single_anchor_1"])[rows]  # taken as independent
            found[f"fig8/{name}/{part}"] = Estimate(float(d.mean()), _error_of_mean(e))
    d = wide["discrepancy"] < wide["single_anchor_1"]
    found["fig8/discrepancy/better points"] = Estimate(100 * float(d.mean()), 0.0)
    return found
