"""Plotting style and small helpers; figures themselves belong to the studies."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from aoabench.maths.estimate import stored
from aoabench.store.files import write_atomically

if TYPE_CHECKING:
    import numpy as np
    import pandas as pd
    from matplotlib.figure import Figure

STYLE = Path(__file__).with_name("house.mplstyle")
COLUMN = 3.5  # inches: width of one column in print
PAGE = 7.2  # inches: width of two columns

# Okabe and Ito's colours, which colour-blind readers can distinguish; each measurement model has
# the same colour in all figures
COLOURS = {
    "vmf": "#0072B2",
    "ae_nominal": "#D55E00",
    "ae_fitted": "#E69F00",
    "ae_adaptive": "#009E73",
}
GREY = "#555555"
LABELS = {
    "vmf": "VMF",
    "ae_nominal": "AE-nominal",
    "ae_fitted": "AE-fitted",
    "ae_adaptive": "AE-adaptive",
}
MARKERS = {"vmf": "o", "ae_nominal": "s", "ae_fitted": "D", "ae_adaptive": "^"}


BOUND = {
    "color": "black",
    "lw": 1.2,
    "ls": "--",
    "zorder": 5,
}  # style of the square root of the Cramér-Rao bound in all figures
BOUND_LABEL = "square root of the CRB"
# Dates and versions are left out, as they would make equal figures differ
_METADATA: dict[str, dict[str, Any]] = {
    "png": {"Software": None},
    "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
    "svg": {"Date": None, "Creator": None},
}
FORMATS = tuple(_METADATA)


def new(
    width: float = COLUMN, height: float | None = None, rows: int = 1, cols: int = 1, **kwargs: Any
) -> tuple[Figure, Any]:
    """A figure and its axes in the house style, `width` and `height` in inches."""
    import matplotlib.pyplot as plt

    size = (width, height if height is not None else 0.72 * width)
    return plt.subplots(rows, cols, figsize=size, layout="constrained", **kwargs)


def save(
    make: Callable[[], Figure], path: Path, formats: tuple[str, ...] = ("png",), dpi: int = 200
) -> Path:
    """Draw in the house style, write `path` in each format; the files depend on the data alone."""
    import matplotlib.pyplot as plt

    with plt.style.context(str(STYLE)):
        figure = make()
        try:
            for form in formats:
                given: dict[str, Any] = {"format": form, "dpi": dpi, "metadata": _METADATA[form]}
                write_atomically(path.with_suffix(f".{form}"), partial(figure.savefig, **given))
        finally:
            plt.close(figure)
    return path


def bound(axis: Any, x: Any, y: Any) -> None:
    """Draw the square root of the Cramér-Rao bound as a curve."""
    axis.plot(x, y, label=BOUND_LABEL, **BOUND)


def bound_ratio(axis: Any, label: str | None = None) -> None:
    """Draw the bound in a panel of ratios to it: the line at 1."""
    axis.axhline(1, label=label, **BOUND)


BARS = math.erf(3 / math.sqrt(2))  # confidence of error bars: three standard errors if normal


def error_bars(
    rows: pd.DataFrame, name: str, se: str = "", log: bool = False, confidence: float = BARS
) -> np.ndarray:
    """Lengths (2, N) of error bars below and above a column's estimates, from their intervals of
    a confidence (see `Estimate.columns`, whose names are `name` and `se`).

    With `log`, lower bars are cut to end above 0, as a logarithmic axis requires.
    """
    import numpy as np

    found = [stored(row, name, se) for row in rows.to_dict("records")]
    value = np.array([e.value for e in found])
    low, high = np.array([e.interval(confidence) for e in found]).reshape(-1, 2).T
    below = np.minimum(value - low, 0.9 * abs(value)) if log else value - low
    return np.array([np.maximum(below, 0.0), np.maximum(high - value, 0.0)])


def boxes(
    axis: Any, groups: list[Any], positions: list[float], colours: list[str], width: float = 0.6
) -> None:
    """Horizontal boxes from rows with q05, q25, q50, q75, q95, minimum and maximum: the levels of
    Nurminen's Fig. 4.

    The box spans 25..75 %, the line is the median, whiskers reach 5 and 95 %, asterisks mark
    minimum and maximum.
    """
    statistics = [
        {
            "med": g["q50"],
            "q1": g["q25"],
            "q3": g["q75"],
            "whislo": g["q05"],
            "whishi": g["q95"],
            "fliers": [g["minimum"], g["maximum"]],
        }
        for g in groups
    ]
    drawn = axis.bxp(
        statistics,
        positions=positions,
        orientation="horizontal",
        widths=width,
        patch_artist=True,
        flierprops={"marker": "*", "markersize": 4, "markeredgewidth": 0.5},
        medianprops={"color": "black", "linewidth": 1.2},
    )
    for box, flier, colour in zip(drawn["boxes"], drawn["fliers"], colours):
        box.set(facecolor=colour, alpha=0.75, linewidth=0.6)
        flier.set(markerfacecolor=colour, markeredgecolor=colour)
