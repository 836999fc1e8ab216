"""Boquet et al. 2024: figures and printed values, each a function of an item's table alone."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from aoabench.maths.statistics import Estimate
from aoabench.report.plots import GREY, PAGE, new

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NAMES = {
    "single_anchor_1": "A1",
    "single_anchor_2": "A2",
    "single_anchor_3": "A3",
    "best_anchor": "A best",
    "rssi_anchor": "A rssi",
    "anchor_mean": "M avg",
    "ls_lines": "M LS",
    "ls_anchor_discarding": "M IAD",
    "vmf_ml": "M vMF",
    "discrepancy": "DF",
}
STYLES = {
    "single_anchor_1": {"color": "#0072B2", "ls": "-"},
    "single_anchor_2": {"color": "#0072B2", "ls": "--"},
    "single_anchor_3": {"color": "#0072B2", "ls": ":"},
    "best_anchor": {"color": "#56B4E9", "ls": "-"},
    "rssi_anchor": {"color": "#56B4E9", "ls": "--"},
    "anchor_mean": {"color": "#E69F00", "ls": "-"},
    "ls_lines": {"color": "#E69F00", "ls": "--"},
    "ls_anchor_discarding": {"color": "#E69F00", "ls": ":"},
    "vmf_ml": {"color": "#009E73", "ls": "-"},
    "discrepancy": {"color": "#D55E00", "ls": "-"},
}
DF = {"color": "#D55E00", "marker": "o", "ms": 3}
PRINTED = {"color": "black", "marker": "*", "ls": "", "ms": 8, "label": "printed"}
ERROR = "horizontal error [m]"
LIMIT = "P(error ≤ 1 m)"


def _estimate(row: Any, key: str) -> Estimate:
    return Estimate(float(row[key]), float(row[f"{key}_se"]))


def _map(axis: Any, rows: pd.DataFrame, values: np.ndarray, **style: Any) -> Any:
    """Values at the points of a square raster as an image; returns it."""
    x, y = np.unique(rows["x_m"]), np.unique(rows["y_m"])
    grid = np.full((len(y), len(x)), np.nan)
    grid[np.searchsorted(y, rows["y_m"]), np.searchsorted(x, rows["x_m"])] = values
    half = (x[1] - x[0]) / 2
    extent = (x[0] - half, x[-1] + half, y[0] - half, y[-1] + half)
    return axis.imshow(grid, origin="lower", extent=extent, interpolation="nearest", **style)


# --- Figures 2 and 3 ------------------------------------------------------------------------------

ANCHORS = {
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
        image = _map(axis, rows, rows["gdop_m"].to_numpy(), cmap="viridis", vmin=0, vmax=15)
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
    """The least GDOP of one anchor, where it is sqrt(3) times that, and the share of the room below
    6 m.
    """
    one = frame.set_index("layout")
    found = {
        "fig2/minimum": Estimate(float(one.loc["minimum", "gdop_m"]), 0.0),
        "fig2/root3": Estimate(float(one.loc["sqrt 3", "x_m"]), 0.0),
    }
    share = {
        name: float((frame.loc[frame["layout"] == name, "gdop_m"] < 6).mean()) for name in ANCHORS
    }
    for name in list(ANCHORS)[1:]:
        found[f"fig2/{name.split()[0]}/more"] = Estimate(
            100 * (share[name] - share["one anchor"]), 0.0
        )
    return found


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
    """95th percentiles of the errors, positions clipped to the room and not."""
    rows = frame[frame["kind"].isin(["clipped", "unclipped"])].to_dict("records")
    key = {"B": "b", "mean of A and B": "mean"}
    return {
        f"fig3a/{r['kind']}/{key[r['who']]}": _estimate({"q": r["q95_m"], "q_se": r["q95_se"]}, "q")
        for r in rows
    }


def fig3b(frame: pd.DataFrame) -> Figure:
    """RMSE of C alone minus that of the mean of A and B [Boquet 2024, Fig. 3(b)]."""
    figure, axis = new(0.55 * PAGE, 3.2)
    more = (frame["single_m"] - frame["pair_m"]).to_numpy()
    limit = np.ceil(np.abs(more).max() * 2) / 2
    image = _map(axis, frame, more, cmap="RdBu_r", vmin=-limit, vmax=limit)
    for name, x in (("A", 2.5), ("C", 5.0), ("B", 7.5)):
        axis.plot(x, 5, "^", color="black", ms=5)
        axis.annotate(name, (x, 5), xytext=(3, 3), textcoords="offset points")
    axis.set(xlabel="x [m]", ylabel="y [m]")
    figure.colorbar(image, label="RMSE of C minus RMSE of\nthe mean of A and B [m]")
    return figure


def fig3b_values(frame: pd.DataFrame) -> dict[str, Estimate]:
    """Share of the room, in percent, where the single anchor C is better by three standard errors,
    and where worse.
    """
    d = frame["pair_m"] - frame["single_m"]
    se = np.hypot(frame["pair_se"], frame["single_se"])  # not paired: an upper limit
    return {
        "fig3b/better": Estimate(100 * float((d > 3 * se).mean()), 0.0),
        "fig3b/worse": Estimate(100 * float((d < -3 * se).mean()), 0.0),
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


def rule(frame: pd.DataFrame) -> Figure:
    """RMSE of the mean of A and B over that of A alone, against the deviations' ratio [Boquet 2024,
    (9)].
    """
    figure, axis = new(0.5 * PAGE, 2.6)
    axis.plot(
        frame["gamma"], frame["closed"], color="black", lw=1, label=r"$\sqrt{1+\gamma^2}/2$ (40)"
    )
    axis.errorbar(
        frame["gamma"],
        frame["ratio"],
        yerr=3 * frame["ratio_se"],
        color="#0072B2",
        fmt="o",
        ms=3,
        label="samples",
    )
    axis.axhline(1, color=GREY, lw=0.8)
    axis.axvline(np.sqrt(3), color=GREY, lw=0.8, ls=":")
    axis.set(
        xlabel=r"deviation of B over that of A, $\gamma$", ylabel="RMSE of the mean / RMSE of A"
    )
    axis.legend()
    return figure


def rule_values(frame: pd.DataFrame) -> dict[str, Estimate]:
    """Where B begins to do harm: the ratio crosses 1, by a line through the two nearest points."""
    i = int(np.flatnonzero(frame["ratio"].to_numpy() < 1)[-1])
    a, b = frame.iloc[i], frame.iloc[i + 1]
    slope = (b["ratio"] - a["ratio"]) / (b["gamma"] - a["gamma"])
    return {
        "rule/threshold": Estimate(
            float(a["gamma"] + (1 - a["ratio"]) / slope), float(a["ratio_se"] / slope)
        )
    }


# --- Figures 5 and 6 ------------------------------------------------------------------------------


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
    axis.plot([1, 1], [0.86, 0.69], **{**PRINTED, "label": "printed, 0.4 and 2"})
    axis.set(xlabel=ERROR, ylabel="share of the given fixes", xlim=(0, 4), ylim=(0, 1))
    axis.legend()
    return figure


def fig5_values(frame: pd.DataFrame) -> dict[str, Estimate]:
    """P(error <= 1 m) for each R_sigma and without the vote."""
    rows = frame[np.isclose(frame["error_m"], 1.0)].to_dict("records")
    return {
        f"fig5/{'no vote' if r['r_sigma'] != r['r_sigma'] else format(r['r_sigma'], 'g')}"
        "/within": _estimate(r, "cdf")
        for r in rows
    }


def fig6(frame: pd.DataFrame) -> Figure:
    """RMSE, CEP90 and both readings of the discard ratio against R_sigma [Boquet 2024, Fig. 6]."""
    figure, (left, right) = new(PAGE, 2.8, cols=2)
    for key, label, colour, marker in (
        ("rmse_m", "RMSE", "#0072B2", "o"),
        ("cep90_m", "CEP90", "#D55E00", "s"),
    ):
        left.errorbar(
            frame["r_sigma"],
            frame[key],
            yerr=3 * frame[f"{key}_se"],
            color=colour,
            marker=marker,
            ms=3,
            label=label,
        )
    for key, label, colour, marker in (
        ("lost", "fixes lost (the default)", "#0072B2", "o"),
        ("discarded", "measurements discarded", "#E69F00", "s"),
    ):
        right.errorbar(
            frame["r_sigma"],
            frame[key],
            yerr=3 * frame[f"{key}_se"],
            color=colour,
            marker=marker,
            ms=3,
            label=label,
        )
    right.plot([0.4, 2.0], [0.52, 0.10], **PRINTED)
    left.set(xlabel=r"$R_\sigma$", ylabel="error [m]", ylim=(0, None))
    right.set(xlabel=r"$R_\sigma$", ylabel=r"discard ratio $R_d$", ylim=(0, 1))
    for axis in (left, right):
        axis.legend()
    return figure


def fig6_values(frame: pd.DataFrame) -> dict[str, Estimate]:
    """Discard ratios, how RMSE and CEP90 rise from R_sigma 0.2 to 2, and the steps of R_d."""
    by = {round(r["r_sigma"], 1): r for r in frame.to_dict("records")}
    found = {
        f"fig6/{r:g}/{key}": _estimate(by[r], key)
        for r in (0.4, 2.0)
        for key in ("lost", "discarded")
    }
    for key in ("rmse_m", "cep90_m"):
        low, high = by[0.2], by[2.0]
        found[f"fig6/{key}/rise"] = Estimate(
            high[key] - low[key], float(np.hypot(high[f"{key}_se"], low[f"{key}_se"]))
        )
    steps = [(by[r]["lost_less"], by[r]["lost_less_se"]) for r in sorted(by)[1:]]
    least = min(steps, key=lambda s: s[0])
    found["fig6/lost/least step"] = Estimate(*least)
    early, late = ([by[r] for r in pair] for pair in ((0.7, 0.8), (1.7, 1.8)))
    drop = [sum(r["lost_less"] for r in part) for part in (early, late)]
    se = float(np.sqrt(sum(r["lost_less_se"] ** 2 for part in (early, late) for r in part)))
    found["fig6/lost/early minus late"] = Estimate(drop[0] - drop[1], se)
    return found


# --- Figure 7, ranking, rejection -----------------------------------------------------------------


def fig7(frame: pd.DataFrame) -> Figure:
    """CDFs of all methods: on own fixes, and on those that the filter accepts [Boquet 2024, Fig.
    7].
    """
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
        axis.set(
            title=on if on == "own fixes" else f"on the fixes of {_df(on)}",
            xlim=(0, 4),
            ylim=(0, 1),
        )
    figure.supxlabel(ERROR, fontsize=8)
    figure.supylabel("share of the fixes", fontsize=8)
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=5)
    return figure


def _df(name: str) -> str:
    return "DF" + name[2:].replace("R_sigma", r"$R_\sigma$").replace("R_d", r"$R_d$")


def ranking(frame: pd.DataFrame) -> Figure:
    """P(error <= 1 m): discrepancy filter minus each other method, against R_sigma."""
    figure, axes = new(PAGE, 2.9, cols=3, sharey=True)
    titles = {
        "all": "each on its own fixes",
        "accepted": "on the fixes that DF gives",
        "coverage": "at equal coverage",
    }
    for axis, (at, title) in zip(axes, titles.items()):
        rows = frame[(frame["at"] == at) & frame["method"].str.startswith("df")]
        for name, part in rows.groupby("other", sort=False):
            r = part["method"].str.split().str[1].astype(float)
            axis.errorbar(
                r,
                part["more"],
                yerr=3 * part["more_se"],
                label=NAMES[name],
                elinewidth=0.5,
                **STYLES[name],
            )
        axis.axhline(0, color="black", lw=0.8)
        axis.set(xlabel=r"$R_\sigma$", title=title)
    axes[0].set(ylabel=f"{LIMIT}: DF minus other")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=9)
    return figure


def ranking_values(frame: pd.DataFrame) -> dict[str, Estimate]:
    """Differences of P(error <= 1 m) in percent points; the filter's at R_sigma 0.2 and 1, the
    others' all.
    """
    rows = frame[
        ~frame["method"].str.startswith("df") | frame["method"].isin(["df 0.2", "df 1"])
    ].to_dict("records")
    return {
        f"ranking/{r['at']}/{r['method']}/{r['other']}": Estimate(
            100 * r["more"], 100 * r["more_se"]
        )
        for r in rows
    }


def rejection(frame: pd.DataFrame) -> Figure:
    """P(error <= 1 m) against coverage: every method with a score of its own thresholded, DF by its
    R_sigma.
    """
    figure, axis = new(0.65 * PAGE, 3.4)
    for name in NAMES:
        rows = frame[frame["method"] == name].sort_values("coverage")
        if len(rows) > 1:
            axis.errorbar(
                rows["coverage"],
                rows["within_1m"],
                yerr=3 * rows["within_1m_se"],
                elinewidth=0.5,
                label=f"{NAMES[name]}, by its residual",
                **STYLES[name],
            )
        elif len(rows):
            axis.plot(
                rows["coverage"],
                rows["within_1m"],
                "D",
                ms=4,
                mfc="none",
                color=STYLES[name]["color"],
            )
            axis.annotate(
                NAMES[name],
                (rows["coverage"].iloc[0], rows["within_1m"].iloc[0]),
                xytext=(-4, 0),
                textcoords="offset points",
                fontsize=6,
                ha="right",
                va="center",
            )
    for kind, line in (("boxes", "-"), ("exact", ":")):
        rows = frame[frame["method"] == f"df {kind}"].sort_values("coverage")
        axis.errorbar(
            rows["coverage"],
            rows["within_1m"],
            yerr=3 * rows["within_1m_se"],
            elinewidth=0.5,
            ls=line,
            label=rf"DF, by $R_\sigma$ ({kind})",
            **DF,
        )
    axis.plot([0.48, 0.90], [0.86, 0.69], **PRINTED)
    axis.set(xlabel="coverage: share of the packets with a fix", ylabel=LIMIT, xlim=(0, 1.02))
    axis.legend(loc="lower left")
    return figure


# --- Figure 8 -------------------------------------------------------------------------------------


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
        _map(axis, rows, rows[column].to_numpy(), cmap=shades, norm=norm, alpha=0.55)
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
    """Means of the medians over the room, and over its inner part (y > 4 m) and outer part against
    A1's.
    """
    found = {}
    mean = frame.groupby("method")[["median_m", "printed_m", "unnamed_m"]].mean()
    for name, row in mean.iterrows():
        se = frame.loc[frame["method"] == name, "median_se"]
        found[f"fig8/{name}/mean"] = Estimate(
            float(row["median_m"]), float(np.sqrt((se**2).sum()) / len(se))
        )
    wide = frame.pivot(index=["x_m", "y_m"], columns="method", values="median_m").reset_index()
    se = frame.pivot(index=["x_m", "y_m"], columns="method", values="median_se").reset_index()
    inner = wide["y_m"] > 4
    for part, rows in (("inner", inner), ("outer", ~inner)):
        for name in ("anchor_mean", "discrepancy"):
            d = (wide[name] - wide["single_anchor_1"])[rows]
            e = np.hypot(se[name], se["single_anchor_1"])[rows]  # taken as independent
            found[f"fig8/{name}/{part}"] = Estimate(
                float(d.mean()), float(np.sqrt((e**2).sum()) / len(e))
            )
    d = wide["discrepancy"] < wide["single_anchor_1"]
    found["fig8/discrepancy/better points"] = Estimate(100 * float(d.mean()), 0.0)
    return found


# --- fit, boxes, errata, speed --------------------------------------------------------------------


def misfit(frame: pd.DataFrame) -> Figure:
    """What the noise was fitted to: ours minus printed in units of the fit's tolerances."""
    rows = frame[frame["misfit"].notna()].iloc[::-1]
    figure, axis = new(PAGE, 3.6)
    y = np.arange(len(rows))
    axis.axvspan(-1, 1, color=GREY, alpha=0.12, lw=0)
    axis.axvline(0, color="black", lw=0.8)
    unit = (rows["ours"] - rows["printed"]) / rows["misfit"]
    axis.errorbar(
        rows["misfit"], y, xerr=3 * rows["se"] / unit, fmt="o", ms=4, color="#0072B2", capsize=2
    )
    axis.set_yticks(
        y, [f"{r['what']}: {r['printed']:.3g} | {r['ours']:.3g}" for r in rows.to_dict("records")]
    )
    axis.set(xlabel="misfit in units of the fit's tolerance; labels: printed | ours")
    return figure


def misfit_values(frame: pd.DataFrame) -> dict[str, Estimate]:
    """Ours, for each number of the fit."""
    return {
        f"misfit/{r['id']}": _estimate({"v": r["ours"], "v_se": r["se"]}, "v")
        for r in frame.to_dict("records")
    }


def boxes(frame: pd.DataFrame) -> Figure:
    """How often bounding boxes and exact ellipses choose differently, and what each gives, against
    R_sigma.
    """
    figure, (left, right) = new(PAGE, 2.7, cols=2)
    for key, label, colour in (
        ("other_set", "other anchors", "#0072B2"),
        ("other_position", "other position", "#E69F00"),
    ):
        left.errorbar(
            frame["r_sigma"],
            100 * frame[key],
            yerr=300 * frame[f"{key}_se"],
            color=colour,
            marker="o",
            ms=3,
            label=label,
        )
    left.set(xlabel=r"$R_\sigma$", ylabel="share of the packets [%]", ylim=(0, None))
    for kind, line in (("boxes", "-"), ("exact", ":")):
        for key, label, colour in (("within_1m", LIMIT, "#D55E00"), ("lost", "$R_d$", GREY)):
            right.errorbar(
                frame["r_sigma"],
                frame[f"{key}_{kind}"],
                yerr=3 * frame[f"{key}_{kind}_se"],
                ls=line,
                color=colour,
                marker="o",
                ms=3,
                label=f"{label}, {kind}",
            )
    right.set(xlabel=r"$R_\sigma$", ylim=(0, 1))
    for axis in (left, right):
        axis.legend()
    return figure


def boxes_values(frame: pd.DataFrame) -> dict[str, Estimate]:
    """Shares that differ and the gain of the exact vote, in percent."""
    return {
        f"boxes/{r['r_sigma']:g}/{key}": Estimate(100 * r[key], 100 * r[f"{key}_se"])
        for r in frame.to_dict("records")
        for key in ("other_set", "other_position", "more")
    }


def errata_values(frame: pd.DataFrame) -> dict[str, Estimate]:
    """Put right minus as the paper ran it, in percent points, and the share of the packets that it
    moves.
    """
    return {
        f"errata/{r['variant']}/{key}": _estimate(r, key)
        for r in frame.to_dict("records")
        for key in ("more", "moved")
    }


def speed(frame: pd.DataFrame) -> Figure:
    """Time per fix of each method, and the paper's 5 ms."""
    figure, axis = new(0.6 * PAGE, 2.8)
    names = {**NAMES, "discrepancy": "DF, boxes", "discrepancy_exact": "DF, exact"}
    rows = frame.iloc[::-1]
    axis.barh([names[m] for m in rows["method"]], rows["us_per_fix"], color="#0072B2")
    axis.axvline(5000, color="black", lw=1, ls="--", label="printed: 5 ms")
    axis.set(xlabel="time per fix [µs], one core", xscale="log")
    axis.legend()
    return figure


def speed_values(frame: pd.DataFrame) -> dict[str, Estimate]:
    """Microseconds per fix."""
    return {
        f"speed/{r['method']}": Estimate(r["us_per_fix"] / 1000, r["us_se"] / 1000)
        for r in frame.to_dict("records")
    }
