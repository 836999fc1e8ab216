"""The misfits of the fitted noise, and the time per fix."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from aoabench.maths.estimate import Estimate, stored
from aoabench.report.plots import GREY, PAGE, error_bars, new

from .common import NAMES

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def misfit(frame: pd.DataFrame) -> Figure:
    """Our number minus the printed one, for each number that the noise is fitted to, in units of
    the fit's tolerances.
    """
    rows = frame[frame["misfit"].notna()].iloc[::-1]
    figure, axis = new(PAGE, 3.6)
    y = np.arange(len(rows))
    axis.axvspan(-1, 1, color=GREY, alpha=0.12, lw=0)
    axis.axvline(0, color="black", lw=0.8)
    tolerance = (rows["ours"] - rows["printed"]) / rows["misfit"]
    look = {"fmt": "o", "ms": 4, "color": "#0072B2", "capsize": 2}
    axis.errorbar(
        rows["misfit"], y, xerr=error_bars(rows, "ours", "se") / tolerance.to_numpy(), **look
    )
    labels = [f"{r.what}: {r.printed:.3g} | {r.ours:.3g}" for r in rows.itertuples()]
    axis.set_yticks(y, labels)
    axis.set(xlabel="misfit in units of the fit's tolerance; labels: printed | ours")
    return figure


def misfit_values(frame: pd.DataFrame) -> dict[str, Estimate]:
    """Our number for each number that the noise is fitted to."""
    return {f"misfit/{r['id']}": stored(r, "ours", "se") for r in frame.to_dict("records")}


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
    """Milliseconds per fix."""
    return {
        f"speed/{r['method']}": Estimate(r["us_per_fix"] / 1000, r["us_se"] / 1000)
        for r in frame.to_dict("records")
    }
