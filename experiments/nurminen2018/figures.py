"""Nurminen et al. 2018: figures and printed values, each a function of an item's table alone."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from aoabench.maths.statistics import Estimate
from aoabench.report.plots import COLOURS, GREY, LABELS, MARKERS, PAGE, boxes, new

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TITLES = {"ae_flip": "Model I: normal angles, flipped", "vmf": "Model II: von Mises-Fisher"}


def _split(estimator: str) -> tuple[str, str]:
    family, _, model = estimator.partition("_")
    return family.upper(), model


# --- Table I --------------------------------------------------------------------------------------


def table1_values(frame: pd.DataFrame) -> dict[str, tuple[Estimate, float]]:
    """Shares and fitted parameters with the number of samples behind them."""
    return {
        f"table1/{r.data}/{r.model}/{r.quantity}": (Estimate(r.value, r.se), float(r.samples))
        for r in frame.itertuples()
    }


# --- Figure 1 -------------------------------------------------------------------------------------


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
    """Deviations at the equator, and the growth of the azimuth's towards the pole."""
    at = frame.set_index("elevation_deg")
    return {
        "fig1/azimuth_at_equator": Estimate(at.loc[0.0, "azimuth_deg"], 0.0),
        "fig1/elevation_at_equator": Estimate(at.loc[0.0, "elevation_about_truth_deg"], 0.0),
        "fig1/growth_at_pole": Estimate(
            at.loc[90.0, "azimuth_deg"] / at.loc[0.0, "azimuth_deg"], 0.0
        ),
    }


# --- Figure 2 -------------------------------------------------------------------------------------


def fig2(frame: pd.DataFrame) -> Figure:
    """Prior mean to posterior means, from above and from the side [Nurminen 2018, Fig. 2]."""
    figure, axes = new(PAGE, 3.3, cols=2)
    prior = frame[frame["method"] == "prior"].iloc[0]
    shown = frame[frame["model"].isin(["ae_nominal", "vmf"])]
    styles = {"ekf": "-", "ukf": "--"}
    ray = np.array([-np.cos(9 * np.pi / 20), 0.0, -np.sin(9 * np.pi / 20)])
    for axis, (i, j) in zip(axes, ((0, 1), (0, 2))):
        u, v = ("x_m", "y_m", "z_m")[i], ("x_m", "y_m", "z_m")[j]
        length = 1.05 * np.abs(frame["z_m"]).max() / abs(ray[2])
        axis.plot(
            [0, length * ray[i]],
            [0, length * ray[j]],
            color=GREY,
            ls=":",
            label="measured direction",
        )
        axis.plot(0, 0, "P", color="black", ms=6, label="anchor (pole axis through it)")
        for r in shown[shown["method"] != "exact"].itertuples():
            axis.plot(
                [prior[u], getattr(r, u)],
                [prior[v], getattr(r, v)],
                styles[r.method],
                color=COLOURS[r.model],
                marker=MARKERS[r.model],
                markevery=[1],
                label=f"{r.method.upper()}-{LABELS[r.model]}",
            )
        for r in shown[shown["method"] == "exact"].itertuples():
            axis.plot(
                getattr(r, u),
                getattr(r, v),
                "*",
                color=COLOURS[r.model],
                ms=10,
                mec="black",
                mew=0.6,
                label=f"exact, {LABELS[r.model]}",
            )
        axis.plot(prior[u], prior[v], "o", mfc="white", mec="black", ms=6, label="prior mean")
        axis.set(xlabel=f"{u[0]} [m]", ylabel=f"{v[0]} [m]")
        axis.set_aspect("equal", adjustable="datalim")
    axes[0].set_title("from above")
    axes[1].set_title("from the side")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside right center")
    return figure


def fig2_values(frame: pd.DataFrame) -> dict[str, Estimate]:
    """Angles to the measured direction, and how much further off the AE filters are than the VMF
    ones.
    """
    angle = frame.set_index(["method", "model"])["angle_to_measurement_deg"]
    found = {}
    for method in ("ekf", "ukf"):
        found[f"fig2/{method}/vmf_minus_prior"] = Estimate(
            angle[method, "vmf"] - angle["prior", "prior"], 0.0
        )
        for model in ("ae_nominal", "ae_fitted", "ae_adaptive"):
            found[f"fig2/{method}/{model}_minus_vmf"] = Estimate(
                angle[method, model] - angle[method, "vmf"], 0.0
            )
    return found


# --- the third argument ---------------------------------------------------------------------------


def frames(frame: pd.DataFrame) -> Figure:
    """Mean RMSE with three standard errors of each filter in each anchor frame."""
    figure, axis = new(PAGE, 2.8)
    estimators = list(frame["estimator"].unique())[::-1]
    turns = list(frame["frame_rpy_deg"].unique())
    for k, (turn, marker) in enumerate(zip(turns, ("o", "s", "^"))):
        rows = frame[frame["frame_rpy_deg"] == turn].set_index("estimator").loc[estimators]
        y = np.arange(len(estimators)) + 0.22 * (1 - k)
        axis.errorbar(
            rows["rmse_mean_3d_m"], y, xerr=3 * rows["se_m"], fmt=marker, capsize=2, elinewidth=0.8,
            label=f"roll, pitch, yaw {turn} deg",
        )  # fmt: skip
    axis.set_yticks(
        range(len(estimators)), [f"{f}-{LABELS[m]}" for f, m in map(_split, estimators)]
    )
    axis.set(xlabel="mean 3-D RMSE [m]", xlim=(0, None))
    axis.grid(axis="y", visible=False)
    figure.legend(loc="outside upper center", ncols=3, title="anchor frames turned by")
    return figure


def frames_values(frame: pd.DataFrame) -> dict[str, Estimate]:
    """Per filter the change in percent from the unturned frames: the larger of two, so z = 3.2
    keeps its 0.3 %.
    """
    found = {}
    for name, rows in frame[frame["frame_rpy_deg"] != "[0, 0, 0]"].groupby("estimator"):
        r = rows.loc[(rows["change_percent"].abs() / rows["change_se"]).idxmax()]
        found[f"frames/{name}"] = Estimate(r["change_percent"], r["change_se"])
        found[f"frames/{name}/size"] = Estimate(abs(r["change_percent"]), r["change_se"])
    return found


# --- Figure 3 -------------------------------------------------------------------------------------


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
            axis.plot(
                track["x_m"],
                track["y_m"],
                color=COLOURS[model],
                marker=MARKERS[model],
                ms=2.5,
                lw=0.8,
                label=f"PF-{LABELS[model]}",
            )
        anchors = rows[rows["kind"] == "anchor"]
        axis.quiver(
            anchors["x_m"], anchors["y_m"], anchors["pole_x"], anchors["pole_y"],
            color=GREY, angles="xy", scale=16, width=0.008,
        )  # fmt: skip
        axis.plot(
            anchors["x_m"], anchors["y_m"], "X", color=GREY, ms=6, label="anchor and its pole"
        )
        axis.set_title(TITLES[noise])
        axis.set(xlabel="x [m]", aspect="equal")
    axes[0].set_ylabel("y [m]")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return figure


# --- Figure 4 -------------------------------------------------------------------------------------

ORDER = [
    f"{f}_{m}"
    for f in ("pf", "ekf", "ukf")
    for m in ("vmf", "ae_adaptive", "ae_fitted", "ae_nominal")
]
ORDER.insert(ORDER.index("ukf_ae_adaptive") + 1, "ukf_ae_adaptive_augmented")


def _label(estimator: str) -> str:
    family, model = _split(estimator)
    return f"{family}-{LABELS[model.removesuffix('_augmented')]}" + (
        " (aug.)" if model.endswith("_augmented") else ""
    )


def _counts(frame: pd.DataFrame) -> str:
    return f"{frame['particles'].iloc[0]} particles, {frame['replications'].iloc[0]} replications"


def _colour(estimator: str) -> str:
    return COLOURS[_split(estimator)[1].removesuffix("_augmented")]


def fig4(frame: pd.DataFrame) -> Figure:
    """Box plots of percentage RMSE differences from PF-VMF, both data models [Nurminen 2018, Fig.
    4].
    """
    figure, axes = new(PAGE, 3.6, cols=2, sharey=True)
    names = [n for n in ORDER if n != "pf_vmf"][::-1]
    for axis, noise in zip(axes, TITLES):
        rows = frame[frame["noise"] == noise].set_index("estimator").loc[names]
        boxes(
            axis,
            [r for _, r in rows.iterrows()],
            list(range(len(names))),
            [_colour(n) for n in names],
        )
        axis.axvline(0, color="black", lw=0.8, ls=":")
        axis.set_title(TITLES[noise])
        axis.set(xlabel="RMSE difference from PF-VMF [%]")
        axis.set_yticks(range(len(names)), [_label(n) for n in names])
    figure.suptitle(_counts(frame), fontsize=8)
    return figure


def layouts(frame: pd.DataFrame) -> Figure:
    """Mean RMSE relative to PF-VMF for each layout, both data models."""
    names = [n for n in ORDER if n != "pf_vmf"][::-1]
    figure, axes = new(PAGE, 3.4, cols=len(LAYOUTS), sharey=True, sharex=True)
    for axis, layout in zip(axes, LAYOUTS):
        for k, (noise, marker) in enumerate((("ae_flip", "o"), ("vmf", "s"))):
            rows = (
                frame[(frame["layout"] == layout) & (frame["noise"] == noise)]
                .set_index("estimator")
                .loc[names]
            )
            axis.errorbar(
                rows["above_pf_vmf_percent"],
                np.arange(len(names)) + 0.15 - 0.3 * k,
                xerr=3 * rows["above_pf_vmf_se"],
                fmt=marker,
                ms=3,
                capsize=1.5,
                elinewidth=0.8,
                label=TITLES[noise],
            )
        axis.axvline(0, color="black", lw=0.8, ls=":")
        axis.set_title(layout.removeprefix("square_track").removeprefix("_") or "base")
        axis.set_yticks(range(len(names)), [_label(n) for n in names])
        axis.set_xticks([0, 50, 100, 150])
    figure.supxlabel(f"difference of mean RMSE from PF-VMF [%], {_counts(frame)}", fontsize=8)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure


LAYOUTS = [f"square_track{variant}" for variant in ("", "_far", "_corner", "_sides", "_upright")]


def adaptivity(frame: pd.DataFrame) -> Figure:
    """What AE-adaptive changes in EKF and UKF, against the same filter with AE-nominal and
    AE-fitted.
    """
    figure, axes = new(PAGE, 2.6, cols=len(LAYOUTS), sharey=True, sharex=True)
    kinds = [
        (n, o)
        for n in ("ekf_ae_adaptive", "ukf_ae_adaptive", "ukf_ae_adaptive_augmented")
        for o in ("ae_nominal", "ae_fitted")
    ]
    for axis, layout in zip(axes, LAYOUTS):
        for k, (noise, marker) in enumerate((("ae_flip", "o"), ("vmf", "s"))):
            rows = frame[(frame["layout"] == layout) & (frame["noise"] == noise)].set_index(
                ["estimator", "other"]
            )
            rows = rows.loc[kinds[::-1]]
            axis.errorbar(
                rows["above_percent"],
                np.arange(len(kinds)) + 0.15 - 0.3 * k,
                xerr=3 * rows["above_se"],
                fmt=marker,
                ms=3,
                capsize=1.5,
                elinewidth=0.8,
                label=TITLES[noise],
            )
        axis.axvline(0, color="black", lw=0.8, ls=":")
        axis.set_title(layout.removeprefix("square_track").removeprefix("_") or "base")
        axis.set_yticks(
            range(len(kinds)), [f"{_label(n)} over {LABELS[o]}" for n, o in kinds[::-1]]
        )
    figure.supxlabel(
        f"mean RMSE of AE-adaptive above [%], {frame['replications'].iloc[0]} replications",
        fontsize=8,
    )
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure


def adaptivity_values(frame: pd.DataFrame) -> dict[str, Estimate]:
    """Per layout, data model and form: AE-adaptive above the AE model that it helps least (of two,
    so z = 3.2).
    """
    found = {}
    for (layout, noise, name), rows in frame.groupby(["layout", "noise", "estimator"]):
        two = [Estimate(r["above_percent"], r["above_se"]) for r in rows.to_dict("records")]
        found[f"adaptivity/{layout}/{noise}/{name}"] = max(two, key=_z)
    return found


def particles(frame: pd.DataFrame) -> Figure:
    """Mean RMSE against the number of particles, both data models."""
    figure, axes = new(PAGE, 2.8, cols=2, sharey=True)
    for axis, noise in zip(axes, TITLES):
        for model in ("vmf", "ae_adaptive", "ae_fitted", "ae_nominal"):
            rows = frame[(frame["noise"] == noise) & (frame["estimator"] == f"pf_{model}")]
            axis.errorbar(
                rows["particles"],
                rows["rmse_mean_3d_m"],
                yerr=3 * rows["se_m"],
                color=COLOURS[model],
                marker=MARKERS[model],
                capsize=2,
                elinewidth=0.8,
                label=f"PF-{LABELS[model]}",
            )
        axis.set_title(TITLES[noise])
        axis.set(xlabel="particles", xscale="log")
    axes[0].set(ylabel="mean 3-D RMSE [m]", ylim=(0, None))
    axes[1].legend()
    return figure


def fig4_values(frame: pd.DataFrame) -> dict[str, Estimate]:
    """The claims on the base layout, filter by filter."""
    found = {}
    for r in frame.to_dict("records"):
        key = f"fig4/{r['noise']}/{r['estimator']}"
        if r["model"] != "vmf":
            found[f"{key}/above_own_vmf"] = Estimate(r["above_vmf_percent"], r["above_vmf_se"])
        elif r["family"] != "pf":
            found[f"{key}/median"] = Estimate(r["q50"], r["median_se"])
    for noise, rows in frame.groupby("noise"):
        found |= {f"fig4/{noise}/{key}": value for key, value in _closest(rows).items()}
    return found


def layouts_values(frame: pd.DataFrame) -> dict[str, Estimate]:
    """The claims on each layout, summed up: for "every filter" the one with the lowest confidence
    bound counts.
    """
    found = {}
    for (layout, noise), rows in frame.groupby(["layout", "noise"]):
        key = f"layouts/{layout}/{noise}"
        ae = [
            Estimate(r["above_vmf_percent"], r["above_vmf_se"])
            for r in rows.to_dict("records")
            if r["model"] != "vmf"
        ]
        found[f"{key}/least_above_own_vmf"] = min(ae, key=lambda e: e.value - 3 * e.se)
        for r in rows.to_dict("records"):
            if r["estimator"] in ("ekf_vmf", "ukf_vmf"):
                found[f"{key}/{r['estimator']}/median"] = Estimate(r["q50"], r["median_se"])
        found |= {f"{key}/{name}": value for name, value in _closest(rows).items()}
    return found


def _closest(rows: pd.DataFrame) -> dict[str, Estimate]:
    """PF-AE-adaptive against the better of the other AE particle filters."""
    at = {r["estimator"]: r for r in rows.to_dict("records")}
    pf = at["pf_ae_adaptive"]
    against = [
        Estimate(pf[f"above_{m}_percent"], pf[f"above_{m}_se"]) for m in ("ae_nominal", "ae_fitted")
    ]
    return {"pf_adaptive_closest": max(against, key=_z)}


def _z(e: Estimate) -> float:
    return e.value / e.se


def particles_values(frame: pd.DataFrame) -> dict[str, Estimate]:
    """By how many percent the RMSE at a third of 10^4 particles exceeds that at 10^4, paired."""
    third = frame[frame["particles"] == 3162]
    return {
        f"particles/{r['noise']}/{r['estimator']}": Estimate(
            r["above_largest_percent"], r["above_largest_se"]
        )
        for r in third.to_dict("records")
    }
