"""Figures of a measurement campaign: distributions of the errors in the plane, and maps of the
errors.

Errors are in m, NaN where a method gave no position.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from aoabench.report import plots

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_POINTS = 80  # true positions; more of them are a track, not reference points
MOST_DRAWN = 5000  # of a track's fixes, evenly spaced; and of a distribution's steps
_BEYOND = 1.5  # times the largest 95 % quantile of errors, where the axis of a distribution ends
STYLES = ("-", "--", "-.", ":")
SCALE = "cividis"  # uniform in lightness, readable by colour-blind readers


def maps(
    truth: np.ndarray,
    errors: Mapping[str, np.ndarray],
    anchors: np.ndarray,
    bounds: Any = None,
    starts: Sequence[int] = (0,),
) -> Figure:
    """Maps of the median errors at the true positions (T, 2) m; of a track, or of several that
    begin at `starts`, of the errors (R, T) m in the first replication.
    """
    import pandas as pd

    points, place = places(truth)
    if len(points) > MOST_POINTS:
        return track_maps(truth, {n: e[0] for n, e in errors.items()}, anchors, bounds, starts)
    medians = {}
    for name, e in errors.items():
        where = np.tile(place, len(e))
        medians[name] = pd.Series(e.ravel()).groupby(where).median().to_numpy()
    return median_maps(points, medians, anchors, bounds)


def places(
    truth: np.ndarray, within_m: float = 0.1, most: int = MOST_POINTS
) -> tuple[np.ndarray, np.ndarray]:
    """Points (P, 2) m such that each position (T, 2) m lies within `within_m` of one, and the index
    (T,) of that point.

    The search ends at `most` + 1 points, as a target with more of them moves.
    """
    distinct, which = np.unique(truth, axis=0, return_inverse=True)
    place = np.full(len(distinct), -1)
    points: list[np.ndarray] = []
    while len(points) <= most and (place < 0).any():
        points.append(distinct[np.argmax(place < 0)])
        place[(place < 0) & (np.hypot(*(distinct - points[-1]).T) <= within_m)] = len(points) - 1
    return np.array(points), place[which.ravel()]


def cdf(
    errors: Mapping[str, np.ndarray],
    bands: Mapping[str, tuple[np.ndarray, np.ndarray, np.ndarray]] | None = None,
) -> Figure:
    """Plot the share of fixes whose error (N,) is at most x; a method that gives fewer fixes ends
    below 1. The axis ends at _BEYOND times the largest 95 % quantile, if errors go on; the legend
    counts those beyond.

    bands: for some of the methods, errors (K,) and the pointwise lower and upper limits (K,) of the
    share at these errors.
    """
    figure, axis = plots.new(plots.COLUMN * 1.35, plots.COLUMN)
    finite = {name: np.asarray(e, dtype=float)[np.isfinite(e)] for name, e in errors.items()}
    reach = max((_reach(given) for given in finite.values() if len(given)), default=0.0)
    for i, (name, given) in enumerate(finite.items()):
        e = np.asarray(errors[name], dtype=float)
        share, beyond = len(given) / max(len(e), 1), int((given > reach).sum())
        middle = f"median {np.median(given):.3g} m, " if len(given) else ""
        line = axis.step(
            *distribution(e),
            where="post",
            linestyle=STYLES[i % len(STYLES)],
            label=f"{name}: {middle}{share:.1%} of {len(e):,} fixes"
            + (f", {beyond:,} beyond the axis" if beyond else ""),
        )[0]
        if bands and name in bands:
            at, low, high = bands[name]
            axis.fill_between(at, low, high, color=line.get_color(), alpha=0.2, linewidth=0)
    axis.set(xlabel="error in the plane [m]", ylabel="share of all fixes", ylim=(0, 1.005))
    axis.set_xlim(0, 1.02 * reach or 1.0)
    axis.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=1 if len(errors) < 7 else 2)
    return figure


def _reach(errors: np.ndarray) -> float:
    """The error at which an axis ends."""
    return min(float(errors.max()), _BEYOND * float(np.quantile(errors, 0.95)))


def distribution(errors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Steps of the distribution of errors (N,), of which at most MOST_DRAWN are kept: errors (K,)
    from 0 on, and the share (K,) of all N that is at most as large.
    """
    given = np.sort(errors[np.isfinite(errors)])
    rank = np.unique(np.linspace(0, len(given), MOST_DRAWN).astype(int))
    return np.concatenate([[0.0], given])[rank], rank / max(len(errors), 1)


def median_maps(
    points: np.ndarray,
    medians: Mapping[str, np.ndarray],
    anchors: np.ndarray,
    bounds: np.ndarray | None = None,
) -> Figure:
    """A map for each method: the median error (P,) at points (P, 2) m as colour and number; –
    stands for no position.

    anchors (B, 2) m; bounds: lower and upper corner (2, 2) m of the room.
    """
    from matplotlib.collections import PatchCollection
    from matplotlib.patches import Rectangle

    extent = extent_of(points, anchors, bounds)
    side = 0.92 * _spacing(points, float(np.diff(extent, axis=0).max()))
    figure, axes, inches = panels(len(medians), extent)
    norm = _norm(np.concatenate([np.asarray(m, dtype=float) for m in medians.values()]))
    size = float(np.clip(72 * inches * side / np.diff(extent[:, 0])[0] / 2.9, 2.5, 8))
    for axis, (name, median) in zip(axes, medians.items()):
        cells = [Rectangle((x - side / 2, y - side / 2), side, side) for x, y in points]
        drawn = PatchCollection(cells, cmap=_scale(), norm=norm, linewidths=0)
        drawn.set_array(np.ma.masked_invalid(median))
        axis.add_collection(drawn)
        for (x, y), value in zip(points, median):
            dark = math.isfinite(value) and norm(value) < 0.55
            colour = "white" if dark else "black"
            axis.text(
                x, y, _short(value), ha="center", va="center", fontsize=size, color=colour, zorder=5
            )
        finish(axis, name, anchors, bounds, extent)
    figure.colorbar(
        drawn, ax=list(axes), label="median error in the plane [m]", extend="max", shrink=0.8
    )
    legend(figure, axes)
    return figure


def track_maps(
    points: np.ndarray,
    errors: Mapping[str, np.ndarray],
    anchors: np.ndarray,
    bounds: np.ndarray | None = None,
    starts: Sequence[int] = (0,),
) -> Figure:
    """A map for each method: the track (T, 2) m, or several that begin at `starts`, coloured by its
    error (T,); crosses mark fixes without a position.
    """
    step = -(-len(points) // MOST_DRAWN)
    points = points[::step]
    errors = {name: np.asarray(error, dtype=float)[::step] for name, error in errors.items()}
    extent = extent_of(points, anchors, bounds)
    figure, axes, _ = panels(len(errors), extent)
    norm = _norm(np.concatenate(list(errors.values())))
    path = np.insert(points, [i for i in -(-np.array(starts) // step) if i], np.nan, axis=0)
    for axis, (name, error) in zip(axes, errors.items()):
        if is_path(points, extent):
            axis.plot(*path.T, color="0.8", linewidth=0.5, zorder=1)
        given = np.isfinite(error)
        if not given.all():
            look = {"marker": "x", "s": 8, "linewidths": 0.5, "color": "0.4", "zorder": 2}
            axis.scatter(*points[~given].T, label="no position", **look)
        look = {"s": 7, "cmap": _scale(), "norm": norm, "linewidths": 0, "zorder": 3}
        drawn = axis.scatter(*points[given].T, c=error[given], **look)
        finish(axis, name, anchors, bounds, extent)
    figure.colorbar(drawn, ax=list(axes), label="error in the plane [m]", extend="max", shrink=0.8)
    legend(figure, axes)
    return figure


def is_path(points: np.ndarray, extent: np.ndarray) -> bool:
    """Whether positions (T, 2) m form a continuous track instead of jumping about the room."""
    if len(points) < 2:
        return False
    step = np.median(np.hypot(*np.diff(points, axis=0).T))
    return bool(step < 0.05 * np.diff(extent, axis=0).max())


# --- pieces ---------------------------------------------------------------------------------------


def _short(value: float) -> str:
    """A number with about three digits; – for NaN."""
    return (
        "–"
        if math.isnan(value)
        else f"{value:.{2 if value < 9.995 else 1 if value < 99.95 else 0}f}"
    )


def _scale() -> Any:
    import matplotlib

    return matplotlib.colormaps[SCALE].with_extremes(bad="0.85")


def _norm(values: np.ndarray) -> Any:
    """A colour scale from 0 to the 95 % quantile of the values."""
    from matplotlib.colors import Normalize

    known = values[np.isfinite(values)]
    return Normalize(0.0, float(np.quantile(known, 0.95)) or 1.0 if len(known) else 1.0)


def extent_of(points: np.ndarray, anchors: np.ndarray, bounds: Any) -> np.ndarray:
    """Lower and upper corner (2, 2) m of points, anchors and bounds, with a margin."""
    corners = [points, anchors] + ([np.asarray(bounds, dtype=float)] if bounds is not None else [])
    every = np.concatenate(corners)
    low, high = every.min(axis=0), every.max(axis=0)
    margin = max(
        0.05 * float((high - low).max()), 0.25 * _spacing(points, float((high - low).max())), 1e-3
    )
    return np.stack([low - margin, high + margin])


def _spacing(points: np.ndarray, extent: float) -> float:
    """Distance in m that 90 % of the points keep from their nearest neighbour, limited by the
    extent.
    """
    if len(points) < 2 or len(points) > 2000:
        return extent / 10
    distance = np.linalg.norm(points[:, None] - points[None], axis=-1)
    distance[distance == 0] = np.inf
    return float(np.clip(np.quantile(distance.min(axis=1), 0.1), extent / 40, extent / 4))


def panels(count: int, extent: np.ndarray) -> tuple[Figure, Any, float]:
    """A figure with `count` panels, their axes in order, and the width of one map in inches."""
    cols = 2 if count == 4 else min(count, 3)
    rows = math.ceil(count / cols)
    width = plots.PAGE if cols > 1 else plots.COLUMN * 1.2
    wide, high = np.diff(extent, axis=0)[0]
    inches = 0.78 * width / cols
    height = min(inches * high / wide, 1.6 * inches)
    inches = height * wide / high
    figure, axes = plots.new(
        width, rows * (height + 0.25) + 0.8, rows, cols, squeeze=False, sharex=True, sharey=True
    )
    for axis in axes.ravel()[count:]:
        axis.set_visible(False)
    for i in range(count):
        axes.ravel()[i].set_xlabel("x [m]" if i + cols >= count else "")
        axes.ravel()[i].tick_params(labelbottom=i + cols >= count)
    for axis in axes[:, 0]:
        axis.set_ylabel("y [m]")
    return figure, axes.ravel()[:count], float(inches)


def finish(axis: Any, name: str, anchors: np.ndarray, bounds: Any, extent: np.ndarray) -> None:
    from matplotlib.patches import Rectangle

    look = {"s": 34, "facecolor": "none", "edgecolor": "#D55E00", "linewidth": 1.2}
    axis.scatter(*anchors.T, marker="^", label="anchor", zorder=4, **look)
    if bounds is not None:
        low, high = np.asarray(bounds, dtype=float)
        axis.add_patch(
            Rectangle(low, *(high - low), fill=False, edgecolor=plots.GREY, linewidth=0.8)
        )
    axis.set(title=name, aspect="equal", xlim=extent[:, 0], ylim=extent[:, 1])
    axis.grid(False)


def legend(figure: Figure, axes: Any) -> None:
    named = {
        label: handle for axis in axes for handle, label in zip(*axis.get_legend_handles_labels())
    }
    figure.legend(named.values(), named.keys(), loc="outside lower center", ncols=len(named))
