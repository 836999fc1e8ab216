"""What the paper leaves open: how much it matters."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pandas as pd

from aoabench.maths.statistics import Estimate
from aoabench.report.plots import PAGE, new
from aoabench.report.text import number_text

from .drawing import NAMES, STYLES

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SETTINGS = {
    "chosen": "as chosen",
    "all_in_sight": "all access nodes in sight report",
    "cosine_0.001": "cosines kept above 0.001",
    "cosine_0.1": "cosines kept above 0.1",
    "noise_figure_5_db": "noise figure 5 dB",
    "noise_figure_13_db": "noise figure 13 dB",
}
NUMBERS = ("median_3d", "median_z", "excess_3d", "excess_z")
HIGHEST_M = 5.0  # the highest uncertainty


def readings_values(frame: pd.DataFrame) -> dict[str, tuple[Estimate, float]]:
    """Per setting, kind of error, uncertainty and method: median errors in space and height, a
    filter's median excess over the centroid in percent, and the rate of divergence; each with its
    trials.
    """
    found = {}
    for r in frame.to_dict("records"):
        key = f"readings/{r['setting']}/{r['an_error']}/{r['an_sigma_m']:g}/{r['estimator']}"
        for name in NUMBERS:
            if r["estimator"] != "wcg" or not name.startswith("excess"):
                found[f"{key}/{name}"] = (Estimate(r[name], r[f"{name}_se"]), float(r["trials"]))
        share = Estimate(r["diverged"], r["diverged_se"]).percent()
        found[f"{key}/diverged"] = (share, float(r["trials"]))
    return found


def readings(frame: pd.DataFrame) -> Figure:
    """Errors of the filters over those of the centroid at the highest uncertainty, by reading."""
    figure, axes = new(PAGE, 3.8, cols=2, sharey=True)
    lines = [(s, kind) for s in SETTINGS for kind in ("independent", "common")]
    part = frame[frame["an_sigma_m"] == HIGHEST_M]
    rows = part.set_index(["setting", "an_error", "estimator"])
    for axis, (number, title) in zip(axes, (("3d", "in space"), ("z", "in height"))):
        for k, name in enumerate(n for n in NAMES if n != "wcg"):
            value, se = (
                pd.Series([rows.loc[(*line, name), f"excess_{number}{end}"] for line in lines])
                for end in ("", "_se")
            )
            look = {**STYLES[name], "ls": "", "ms": 4, "capsize": 2, "elinewidth": 0.8}
            y = [-i - 0.2 * k + 0.1 for i in range(len(lines))]
            ratio, bars = 1 + value / 100, 3 * se / 100
            low = bars.clip(upper=0.9 * ratio)
            axis.errorbar(ratio, y, xerr=[low, bars], label=NAMES[name], **look)
        axis.axvline(1, color="black", lw=0.8, ls=":")
        axis.set(xscale="log", title=title, xlabel="error over that of WCG, ratio")
    texts = [f"{SETTINGS[setting]}, {kind}" for setting, kind in lines]
    axes[0].set_yticks([-i for i in range(len(lines))], texts)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure


def readings_table(frame: pd.DataFrame) -> pd.DataFrame:
    """Median errors in m of each method at each uncertainty, and the share of trials in which the
    filter without times diverges, as texts: a row for each reading.
    """
    rows = frame.set_index(["setting", "an_error", "an_sigma_m", "estimator"])
    sigmas = sorted(frame["an_sigma_m"].unique())
    found = []
    for setting in SETTINGS:
        for kind in ("independent", "common"):
            line = {"reading": SETTINGS[setting], "errors": kind}
            for sigma in sigmas:
                for name, label in NAMES.items():
                    r = rows.loc[setting, kind, sigma, name]
                    text = number_text(r["median_3d"], r["median_3d_se"])
                    line[f"{label} at {sigma:g} m [m]"] = text
            r = rows.loc[setting, kind, HIGHEST_M, "ekf_aoa"]
            share = number_text(100 * r["diverged"], 100 * r["diverged_se"])
            line[f"{NAMES['ekf_aoa']}, diverged at {HIGHEST_M:g} m [%]"] = share
            found.append(line)
    return pd.DataFrame(found)
