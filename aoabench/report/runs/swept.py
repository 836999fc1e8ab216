"""A metric over swept parameters: curves with intervals, and heat maps."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from aoabench.report.campaign import SCALE
from aoabench.report.runs import look
from aoabench.report.runs.look import Words
from aoabench.report.runs.source import ordered, value_text

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

_MOST_TICKS = 12
_ROOM = 35  # letters of all texts below an axis that stand beside each other


def curve(means: pd.DataFrame, over: str, words: Words) -> Figure:
    """Draw the estimates (see `values.means`) over a parameter, a line for each group, with their
    95 % intervals; points alone where the parameter's values are texts.
    """
    made = look.sheet(means, words)
    numeric = means[over].dtype.kind in "iuf"
    names = ordered(means[over])
    places = means[over] if numeric else means[over].map(value_text)
    at = places if numeric else places.map({value_text(v): i for i, v in enumerate(names)})
    log_x = numeric and look.is_even_in_log(at.to_numpy(dtype=float))
    log_y = look.spans_decades(means["value"].to_numpy(dtype=float))
    step = _step(np.unique(at.dropna().to_numpy(dtype=float)), log_x, len(made.groups))
    frame = means.assign(at=at.astype(float))
    seen = set(means["group"][means["value"].notna()])
    for panel, group, mine in look.groups_of(frame):
        offset = step * (made.groups.index(group) - (len(made.groups) - 1) / 2)
        x = mine["at"] * np.exp(offset) if log_x else mine["at"] + offset
        style = made.style(group) | ({} if numeric else {"linestyle": "none"})
        name = group if group in seen else f"{group} (no value)"
        order = np.argsort(x.to_numpy())
        axis = made.axes[panel]
        axis.plot(x.to_numpy()[order], mine["value"].to_numpy()[order], label=name, **style)
        _intervals(axis, x.to_numpy(), mine, style["color"])
    for axis in made.axes.values():
        look.scale(axis, "x", log_x, at)
        look.scale(axis, "y", log_y, means[["value", "low", "high"]])
        if not numeric:
            texts = [value_text(v) for v in names]
            turned = {"rotation": 30, "ha": "right"} if sum(map(len, texts)) > _ROOM else {}
            axis.set_xticks(range(len(names)), texts, **turned)
            axis.set_xlim(-0.5, len(names) - 0.5)
        elif len(names) <= _MOST_TICKS:
            axis.set_xticks([v for v in names if v == v])
            axis.set_xticklabels([value_text(v) for v in names if v == v])
            axis.xaxis.minorticks_off()
    if not log_y and means["value"].min() >= 0:
        top = float(np.nanmax(means[["value", "high"]].replace(np.inf, np.nan).to_numpy()))
        next(iter(made.axes.values())).set_ylim(0, 1.05 * top or 1.0)
    look.legend(made, words.by)
    return made.figure


def _step(at: np.ndarray, log: bool, groups: int) -> float:
    """The distance by which neighbouring groups are moved apart, so that their bars do not lie on
    each other: at most 2 % of the smallest distance of two values, and 10 % for all groups.
    """
    least = float(np.diff(np.log(at) if log else at).min(initial=np.inf))
    return min(0.02, 0.1 / groups) * (least if np.isfinite(least) else 1.0)


def _intervals(axis: Any, x: np.ndarray, rows: pd.DataFrame, colour: str) -> None:
    """Draw the intervals whose ends are both known."""
    value, low, high = (rows[n].to_numpy(dtype=float) for n in ("value", "low", "high"))
    known = np.isfinite(low) & np.isfinite(high) & np.isfinite(value)
    bars = np.array([value - low, high - value])[:, known].clip(min=0)
    axis.errorbar(
        x[known], value[known], yerr=bars, fmt="none", ecolor=colour, elinewidth=1, capsize=2
    )


def heatmap(means: pd.DataFrame, over: tuple[str, str], words: Words) -> Figure:
    """Draw the estimates as colours and numbers over two parameters, one scale for all panels; a
    field that the run lacks is empty, one without a value has a dash.
    """
    from matplotlib import colormaps
    from matplotlib.colors import LogNorm, Normalize

    values = [ordered(means[name]) for name in over]
    rank = [{value_text(v): i for i, v in enumerate(column)} for column in values]
    height = max(1.6, 0.28 * len(values[1]) + 0.5)
    made = look.sheet(means, words, height=height, groups=False)
    known = means["value"].to_numpy(dtype=float)
    known = known[np.isfinite(known)]
    log = look.spans_decades(known)
    norm = (LogNorm if log else Normalize)(known.min(), known.max())
    drawn: Any = None
    for panel, mine in look.panels_of(means):
        grid = np.full((len(values[1]), len(values[0])), np.nan)
        ran = np.zeros(grid.shape, dtype=bool)
        for row in mine.to_dict("records"):
            j, i = (rank[k][value_text(row[name])] for k, name in enumerate(over))
            grid[i, j], ran[i, j] = row["value"], True
        axis = made.axes[panel]
        shade = colormaps[SCALE].with_extremes(bad="1.0")
        drawn = axis.imshow(grid, cmap=shade, norm=norm, aspect="auto", origin="lower")
        _numbers(axis, grid, ran, norm)
        axis.set_xticks(range(len(values[0])), [value_text(v) for v in values[0]])
        axis.set_yticks(range(len(values[1])), [value_text(v) for v in values[1]])
        axis.grid(visible=False)
    made.figure.colorbar(drawn, ax=list(made.axes.values()), label=words.by, shrink=0.9)
    return made.figure


def _numbers(axis: Any, grid: np.ndarray, ran: np.ndarray, norm: Any) -> None:
    """Write each field's number, as far as there is room."""
    size = 6.5 if grid.shape[1] <= 8 else 5.0
    if grid.shape[1] > 14:
        return
    for i, j in np.argwhere(ran):
        value = grid[i, j]
        known = np.isfinite(value)
        colour = "white" if known and norm(value) < 0.55 else "black"
        text = f"{value:.3g}" if known else "\u2013"
        axis.text(j, i, text, ha="center", va="center", fontsize=size, color=colour)
