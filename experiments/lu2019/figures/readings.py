"""What the paper leaves open: how much it matters."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from aoabench.maths.estimate import Estimate, stored
from aoabench.report.plots import PAGE, new
from aoabench.report.text import interval_text

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
MEASURES = ("median", "worse", "excess")
HIGHEST_M = 5.0  # the highest uncertainty


def readings_values(frame: pd.DataFrame) -> dict[str, tuple[Estimate, float]]:
    """Per setting, kind of error, uncertainty and method: median errors in m in space and height,
    the rate of divergence and, of a filter, the share of trials in which it errs more than the
    centroid and its median excess over it, all in percent; each with its trials.
    """
    found = {}
    for r in frame.to_dict("records"):
        key = f"readings/{r['setting']}/{r['an_error']}/{r['an_sigma_m']:g}/{r['estimator']}"
        numbers = {"diverged": stored(r, "diverged").percent()}
        for part in ("3d", "z"):
            of = {n: stored(r, n) for n in (f"{m}_{part}" for m in MEASURES)}
            numbers[f"median_{part}"] = of[f"median_{part}"]
            if r["estimator"] != "wcg":
                numbers[f"worse_{part}"] = of[f"worse_{part}"].percent()
                numbers[f"excess_{part}"] = of[f"excess_{part}"]
        found |= {f"{key}/{name}": (e, float(r["trials"])) for name, e in numbers.items()}
    return found


def readings(frame: pd.DataFrame) -> Figure:
    """Errors of the filters over those of the centroid at the highest uncertainty, by reading."""
    figure, axes = new(PAGE, 3.8, cols=2, sharey=True)
    lines = [(s, kind) for s in SETTINGS for kind in ("independent", "common")]
    part = frame[frame["an_sigma_m"] == HIGHEST_M]
    rows = part.set_index(["setting", "an_error", "estimator"])
    for axis, (number, title) in zip(axes, (("3d", "in space"), ("z", "in height"))):
        for k, name in enumerate(n for n in NAMES if n != "wcg"):
            chosen = rows.loc[[(*line, name) for line in lines]]
            ratio, low, high = (
                1 + chosen[f"excess_{number}{end}"].to_numpy() / 100
                for end in ("", "_low", "_high")
            )
            bars = [np.where(np.isfinite(x), abs(x - ratio), np.nan) for x in (low, high)]
            look = {**STYLES[name], "ls": "", "ms": 4, "capsize": 2, "elinewidth": 0.8}
            y = [-i - 0.2 * k + 0.1 for i in range(len(lines))]
            axis.errorbar(ratio, y, xerr=bars, label=NAMES[name], **look)
        axis.axvline(1, color="black", lw=0.8, ls=":")
        axis.set(xscale="log", title=title, xlabel="error over that of WCG, ratio")
        axis.set_xticks([1, 2, 5, 10, 20], ["1", "2", "5", "10", "20"])
        axis.set_xticks([], minor=True)
    texts = [f"{SETTINGS[setting]}, {kind}" for setting, kind in lines]
    axes[0].set_yticks([-i for i in range(len(lines))], texts)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure


def readings_table(frame: pd.DataFrame) -> pd.DataFrame:
    """Median errors in m of each method at each uncertainty, and the share of trials in which the
    filter without times diverges, as texts with 95 % intervals: a row for each reading.
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
                    line[f"{label} at {sigma:g} m [m]"] = _text(stored(r, "median_3d"))
            r = rows.loc[setting, kind, HIGHEST_M, "ekf_aoa"]
            share = _text(stored(r, "diverged").percent(), 0.0, 100.0)
            line[f"{NAMES['ekf_aoa']}, diverged at {HIGHEST_M:g} m [%]"] = share
            found.append(line)
    return pd.DataFrame(found)


def _text(number: Estimate, least: float = 0.0, most: float = np.inf) -> str:
    """A number that lies between two values, with its 95 % interval."""
    low, high = number.interval()
    return interval_text(number.value, max(low, least), min(high, most))
