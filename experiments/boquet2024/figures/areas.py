"""Median errors by area: the filter against every other method."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from aoabench.maths.estimate import Estimate
from aoabench.report.plots import PAGE, new

from .common import NAMES, estimate, intervals

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SHOWN = {"inner": "#0072B2", "outer": "#D55E00", "farthest": "#555555"}


def areas(frame: pd.DataFrame) -> Figure:
    """Median error of the discrepancy filter minus that of each other method, by area; filled on
    own fixes, open on the fixes that the filter gives.
    """
    figure, axis = new(0.7 * PAGE, 3.4)
    others = [name for name in NAMES if name != "discrepancy"]
    rows = frame[(frame["method"] == "discrepancy") & frame["other"].isin(others)]
    for i, (area, colour) in enumerate(SHOWN.items()):
        for on, look in (("", {}), (" accepted", {"mfc": "white"})):
            part = rows[rows["area"] == area + on].set_index("other").loc[others]
            y = np.arange(len(others)) + 0.25 * (i - 1) + (0.08 if on else -0.04)
            label = {"inner": "inner area", "outer": "outer area", "farthest": "lowest row"}[area]
            style = {"color": colour, "fmt": "o", "ms": 3.5, "elinewidth": 0.8, **look}
            intervals(axis, part, "value", y, label=None if on else label, **style)
    axis.axvline(0, color="black", lw=1, ls=":")
    axis.set_yticks(range(len(others)), [NAMES[name] for name in others])
    axis.invert_yaxis()
    axis.set(xlabel="median error of DF minus that of the other [m]")
    axis.legend()
    return figure


def areas_values(frame: pd.DataFrame) -> dict[str, Estimate]:
    """Median errors by area and method in m, and their differences; rank correlations with GDOP."""
    return {
        "/".join(filter(None, ("areas", r["area"], r["method"], r["other"]))): estimate(r, "value")
        for r in frame.to_dict("records")
    }
