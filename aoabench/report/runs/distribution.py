"""Distributions of errors or of a metric: functions, boxes and violins."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from aoabench.report import plots
from aoabench.report.runs import look
from aoabench.report.runs.look import Sheet, Words

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

_ROW = 0.24  # inches of a box or violin


def cdf(points: pd.DataFrame, quantiles: pd.DataFrame, words: Words) -> Figure:
    """Draw distribution functions with their bands (see `values.cdf_points`); a line ends below 1
    where fixes have no position.
    """
    log = look.is_heavy(quantiles)
    ends = look.limits(quantiles, log, whole=False)
    made = look.sheet(points, words)
    median = dict(zip(quantiles["group"], quantiles["q50"])) if len(made.axes) == 1 else {}
    median = {name: f"median {m:.3g}" if m == m else "no value" for name, m in median.items()}
    for panel, group, mine in look.groups_of(points):
        style = made.style(group) | {"marker": None}
        name = f"{group}: {median[group]}" if group in median else group
        axis = made.axes[panel]
        x, share = [*mine["x"], ends[1]], [*mine["share"], mine["share"].iloc[-1]]
        axis.step(x, share, where="post", label=name, **style)
        axis.fill_between(
            mine["x"], mine["low"], mine["high"], color=style["color"], alpha=0.15, linewidth=0
        )
    for axis in made.axes.values():
        look.scale(axis, "x", log, ends)
        axis.set(xlim=ends, ylim=(0, 1.005))
    look.legend(made, words.by)
    return made.figure


def box(quantiles: pd.DataFrame, words: Words) -> Figure:
    """Draw a box for each estimator (see `plots.boxes`); a maximum beyond the axis is an arrow."""
    log = look.is_heavy(quantiles)
    ends = look.limits(quantiles, log, whole=True)
    made = _rows(quantiles, words)
    for panel, mine in look.panels_of(quantiles):
        axis, y = made.axes[panel], [float(made.groups.index(g)) for g in mine["group"]]
        rows = mine.assign(
            minimum=mine["minimum"].where(mine["minimum"] >= ends[0]),
            maximum=mine["maximum"].where(mine["maximum"] <= ends[1]),
        )
        colours = [made.style(g)["color"] for g in mine["group"]]
        seen = [(r, p, c) for r, p, c in zip(rows.to_dict("records"), y, colours) if r["n"]]
        if seen:
            plots.boxes(axis, *map(list, zip(*seen)))  # type: ignore[arg-type]
        _finish(axis, mine, y, ends, log, made)
    return made.figure


def violin(samples: pd.DataFrame, quantiles: pd.DataFrame, words: Words) -> Figure:
    """Draw the estimated density of each estimator's values, with median and quartiles."""
    log = look.is_heavy(quantiles)
    ends = look.limits(quantiles, log, whole=True)
    made = _rows(quantiles, words)
    values = {(panel, group): mine["x"] for panel, group, mine in look.groups_of(samples)}
    for panel, mine in look.panels_of(quantiles):
        axis, y = made.axes[panel], [float(made.groups.index(g)) for g in mine["group"]]
        for row, place in zip(mine.to_dict("records"), y):
            if not row["n"]:
                continue
            at, density = density_of(values[panel, row["group"]].to_numpy(), ends, log)
            colour = made.style(row["group"])["color"]
            axis.fill_between(
                at, place - density, place + density, color=colour, alpha=0.6, linewidth=1
            )
            axis.plot([row["q25"], row["q75"]], [place, place], color="black", linewidth=2.5)
            axis.plot(row["q50"], place, "o", color="white", markersize=3, markeredgecolor="black")
        _finish(axis, mine, y, ends, log, made)
    return made.figure


def density_of(
    x: np.ndarray, ends: tuple[float, float], log: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Points (K,) between the least and the largest value inside `ends`, and the half-width (K,) of
    a violin there, at most 0.4: a Gaussian kernel's density (Scott's rule) of these values of x
    (N,), or with `log` of their logarithms.
    """
    from matplotlib.mlab import GaussianKDE

    inside = x[(x >= ends[0]) & (x <= ends[1])]
    if len(inside) < 2 or np.ptp(inside) == 0:
        return np.repeat(inside[:1], 2), np.array([-0.4, 0.4])[: 2 * len(inside[:1])]
    scaled = np.log10(inside) if log else inside
    at = np.linspace(scaled.min(), scaled.max(), 200)
    density = GaussianKDE(scaled).evaluate(at)
    return 10**at if log else at, 0.4 * density / density.max()


def _rows(quantiles: pd.DataFrame, words: Words) -> Sheet:
    """A figure whose panels have a row for each group, the first at the top."""
    count = quantiles["group"].nunique()
    made = look.sheet(quantiles, words, height=0.4 + _ROW * count, groups=False)
    for axis in made.axes.values():
        axis.set_ylim(count - 0.4, -0.6)
        axis.grid(visible=False, axis="y")
    return made


def _finish(
    axis: Any,
    rows: pd.DataFrame,
    y: list[float],
    ends: tuple[float, float],
    log: bool,
    made: Sheet,
) -> None:
    """Set the axes of a panel; mark values beyond them, and rows without any value."""
    look.scale(axis, "x", log, ends)
    axis.set_xlim(ends)
    axis.set_yticks(range(len(made.groups)), made.groups)
    for row, place in zip(rows.to_dict("records"), y):
        at = {"xycoords": ("axes fraction", "data"), "va": "center", "fontsize": 6}
        if not row["n"]:
            axis.annotate("no value", (0.02, place), color=plots.GREY, **at)
        elif row["maximum"] > ends[1]:
            text = f"max {row['maximum']:.3g} \u2192"
            axis.annotate(text, (0.995, place - 0.3), ha="right", **at)
