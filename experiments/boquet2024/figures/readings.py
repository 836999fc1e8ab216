"""The readings of the discrepancy filter, and what each does."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from aoabench.maths.estimate import Estimate
from aoabench.report.plots import PAGE, new

from .common import estimate, intervals

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SHOWN = {0.2: "#D55E00", 1.0: "#0072B2"}  # R_sigmas that Figure 7 may be of
NUMBERS = {  # columns, as they are called in the ids
    "within_1m": "within",
    "lost": "lost",
    "over_best": "over best",
    "over_no_vote": "over no vote",
    "over_no_vote_same": "over no vote of this R_sigma",
    "effect": "effect",
    "lost_effect": "effect on lost",
}


def readings(frame: pd.DataFrame) -> Figure:
    """P(error <= 1 m) of the filter minus that of the best single anchor, by reading."""
    figure, axis = new(0.7 * PAGE, 3.2)
    names = list(frame["reading"].unique())
    for r, colour in SHOWN.items():
        rows = frame[np.isclose(frame["r_sigma"], r)].set_index("reading").loc[names]
        y = np.arange(len(names)) + (0.12 if r == 1 else -0.12)
        style = {"color": colour, "fmt": "o", "ms": 4, "label": rf"$R_\sigma$ = {r:g}"}
        intervals(axis, rows, "over_best", y, scale=100, **style)
    axis.axvline(0, color="black", lw=1, ls=":")
    axis.set_yticks(range(len(names)), [name.replace(" deg", "°") for name in names])
    axis.invert_yaxis()
    axis.set(xlabel="P(error ≤ 1 m) of DF minus that of A best [percentage points]")
    figure.legend(loc="outside upper center", ncols=2)
    return figure


def readings_values(frame: pd.DataFrame) -> dict[str, Estimate]:
    """Shares and differences in percent for each reading and R_sigma."""
    return {
        f"readings/{r['reading']}/{r['r_sigma']:g}/{name}": estimate(r, key).percent()
        for r in frame.to_dict("records")
        for key, name in NUMBERS.items()
        if np.isfinite(r[key])
    }
