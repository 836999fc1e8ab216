"""Map of the fixes of a recording over the floor plan."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from aoabench.devices.readers.sources import natural
from aoabench.report import plots

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

ELLIPSES = 60  # at most
MOST_DRAWN = 5000  # fixes, evenly spaced
MOST_NAMED = 40  # anchors with names
SCALE = "cividis"
MARKERS = "oDsv^<>PXp"
TAGS = "tab10"  # colours of the tags' lines and of the edges of their fixes
LEVEL_95 = 2.4477468306808164  # standard deviations in the plane that hold 95 %


@dataclass(frozen=True)
class Surroundings:
    """What lies around the fixes: anchors (B, 3) m with their names and rotations (B, 3, 3), global
    to anchor's frame; walls (W, 2, 2) m or None; rejected (K, 2) m: positions of rejected fixes;
    paths (K, 2) m, NaN where one ends: of anchors that move, by their places in `anchors`.
    """

    anchors: np.ndarray
    names: Sequence[str]
    rotation: np.ndarray
    walls: np.ndarray | None = None
    rejected: np.ndarray | None = None
    paths: Mapping[int, np.ndarray] = field(default_factory=dict)


def figure(frame: pd.DataFrame, around: Surroundings, title: str) -> Figure:
    """Fixes (a table of `locate`) in the colour of their time with ellipses of 95 %, anchors with
    the directions they face, walls, truth and rejected fixes. Fixes far outside anchors, walls and
    the other fixes are counted and not drawn.
    """
    from matplotlib.ticker import MaxNLocator

    extent = _extent(frame, around)
    wide, high = np.diff(extent, axis=0)[0]
    width = plots.PAGE
    made, axis = plots.new(width, float(np.clip(0.85 * width * high / wide, 2.5, 10.0)) + 0.8)
    if around.walls is not None:
        _walls(axis, around.walls)
    _truth(axis, frame)
    drawn = _tracks(axis, frame)
    _ellipses(axis, frame)
    _crosses(axis, frame, around.rejected)
    _anchors(axis, around, float(max(wide, high)))
    _paths(axis, around)
    axis.set(aspect="equal", xlabel="x [m]", ylabel="y [m]", title=title)
    axis.set(xlim=extent[:, 0], ylim=extent[:, 1])
    axis.grid(False)
    if drawn is not None:
        timed = frame["time_s"].notna().all()
        bar = made.colorbar(drawn, ax=axis, label="time [s]" if timed else "fix", shrink=0.8)
        if not timed:
            bar.locator = MaxNLocator(integer=True)
    _legend(made, axis, _outside(frame, extent))
    return made


def _extent(frame: pd.DataFrame, around: Surroundings) -> np.ndarray:
    """Lower and upper corner (2, 2) m of anchors, walls, truth and nearly all fixes."""
    fixes = _finite(frame, "x_m", "y_m")
    parts = [around.anchors[:, :2][np.isfinite(around.anchors[:, :2]).all(axis=1)]]
    parts += [path[np.isfinite(path[:, 0])] for path in around.paths.values()]
    parts += [] if around.walls is None else [around.walls.reshape(-1, 2)]
    parts += [np.quantile(fixes, [0.01, 0.99], axis=0)] if len(fixes) else []
    parts += [_finite(frame, "true_x_m", "true_y_m")] if "true_x_m" in frame else []
    every = np.concatenate(parts)
    if not len(every):
        return np.array([[-1.0, -1.0], [1.0, 1.0]])
    low, high = every.min(axis=0), every.max(axis=0)
    margin = max(0.08 * float((high - low).max()), 0.5)
    return np.stack([low - margin, high + margin])


def _finite(frame: pd.DataFrame, *columns: str) -> np.ndarray:
    values = frame[list(columns)].to_numpy(dtype=float)
    return values[np.isfinite(values).all(axis=1)]


def _walls(axis: Any, walls: np.ndarray) -> None:
    from matplotlib.collections import LineCollection

    axis.add_collection(LineCollection(list(walls), colors="black", linewidths=0.8, zorder=1))


def _truth(axis: Any, frame: pd.DataFrame) -> None:
    if "true_x_m" in frame and len(known := _finite(frame, "true_x_m", "true_y_m")):
        thin = known[:: -(-len(known) // MOST_DRAWN)]
        look = {"marker": "+", "markersize": 4, "markeredgewidth": 0.8, "linestyle": "none"}
        axis.plot(*thin.T, color=plots.GREY, label="truth", zorder=2, **look)


def _tracks(axis: Any, frame: pd.DataFrame) -> Any:
    """Draw the fixes with a position; return what the colour bar describes, None without any."""
    from matplotlib.colors import Normalize

    frame = frame.assign(at=_at(frame))
    given = frame[frame["x_m"].notna()]
    given = given.iloc[:: max(-(-len(given) // MOST_DRAWN), 1)]
    if not len(given):
        return None
    norm = Normalize(given["at"].min(), given["at"].max())
    tags = sorted(set(given["tag"].fillna("")), key=natural)
    drawn = None
    colour = _colours(tags)
    for _, one in given.groupby("track", sort=True):
        line = {"color": colour[one["tag"].fillna("").iloc[0]], "linewidth": 0.6, "zorder": 3}
        axis.plot(one["x_m"], one["y_m"], **line)
    for i, tag in enumerate(tags):
        mine = given[given["tag"].fillna("") == tag]
        marker = MARKERS[i % len(MARKERS)]
        many = len(tags) > 1 and i < len(MARKERS)
        look = {"s": 14 if len(given) < 500 else 8, "marker": marker, "linewidths": 0.7 * many}
        look |= {"edgecolors": colour[tag]} if many else {}
        drawn = axis.scatter(
            mine["x_m"], mine["y_m"], c=mine["at"], cmap=SCALE, norm=norm, zorder=4,
            label=f"tag {tag}" if many else None if i else "fix", **look,
        )  # fmt: skip
    return drawn


def _colours(tags: Sequence[str]) -> dict[str, Any]:
    """The colour of each tag's lines; grey for a single tag, and for more than have markers."""
    from matplotlib import colormaps

    own = colormaps[TAGS].colors if len(tags) > 1 else ()  # type: ignore[attr-defined]
    return {tag: own[i] if i < len(own) else "0.7" for i, tag in enumerate(tags)}


def _at(frame: pd.DataFrame) -> Any:
    """The time of each fix in s since the first, or its number from 1 on where a time is not
    known.
    """
    time = frame["time_s"]
    return time - time.min() if time.notna().all() else np.arange(1.0, len(frame) + 1)


def _ellipses(axis: Any, frame: pd.DataFrame) -> None:
    """Draw ellipses that hold 95 % if the stated deviations hold."""
    from matplotlib.patches import Ellipse

    columns = ["x_m", "y_m", "sigma_major_m", "sigma_minor_m", "ellipse_deg"]
    rows = _finite(frame.sort_values("track", kind="stable"), *columns)  # some of each track
    for number, (x, y, a, b, turn) in enumerate(rows[:: max(-(-len(rows) // ELLIPSES), 1)]):
        size = 2 * LEVEL_95 * a, 2 * LEVEL_95 * b
        look: dict[str, Any] = {"facecolor": plots.COLOURS["vmf"], "linewidth": 0, "zorder": 2.5}
        label = None if number else "95 % ellipse"
        axis.add_patch(Ellipse((x, y), *size, angle=turn, label=label, alpha=0.1, **look))


def _crosses(axis: Any, frame: pd.DataFrame, rejected: np.ndarray | None) -> None:
    """Draw rejected and diverged fixes."""
    look: dict[str, Any] = {"marker": "x", "s": 18, "linewidths": 0.8, "zorder": 5}
    if rejected is not None and len(rejected):
        axis.scatter(*rejected.T, color=plots.COLOURS["ae_nominal"], label="rejected", **look)
    diverged = _finite(frame[frame["outcome"] == "diverged"], "x_m", "y_m")
    if len(diverged):
        axis.scatter(*diverged.T, color=plots.COLOURS["ae_fitted"], label="diverged", **look)


def _anchors(axis: Any, around: Surroundings, extent: float) -> None:
    """Draw the anchors that stand still, an arrow along the local x of each that faces sideways,
    and the names.
    """
    still = [b for b in range(len(around.anchors)) if b not in around.paths]
    x, y = around.anchors[still, 0], around.anchors[still, 1]
    if not still:
        return
    look = {"s": 34, "facecolor": "white", "edgecolor": "#D55E00", "linewidth": 1.2}
    axis.scatter(x, y, marker="^", label="anchor", zorder=6, **look)
    ahead = around.rotation[still, 0, :2]
    sideways = np.hypot(*ahead.T) > 0.5
    if sideways.any():
        arrows = {"angles": "xy", "scale_units": "xy", "scale": 1 / (0.05 * extent)}
        place = x[sideways], y[sideways], *ahead[sideways].T
        axis.quiver(*place, color="#D55E00", width=0.003, zorder=6, **arrows)
    if len(x) <= MOST_NAMED:
        for b, place in zip(still, zip(x, y)):
            _named(axis, around.names[b], place)


def _named(axis: Any, name: str, place: Sequence[float]) -> None:
    offset = {"xytext": (4, 4), "textcoords": "offset points", "fontsize": 7}
    text = str(name).replace("$", r"\$")
    axis.annotate(text, place, zorder=7, annotation_clip=True, **offset)


def _paths(axis: Any, around: Surroundings) -> None:
    """Draw where the receivers that move have measured, and their names where they begin."""
    for number, (b, path) in enumerate(around.paths.items()):
        thin = path[:: -(-len(path) // MOST_DRAWN)]
        look = {"color": "#D55E00", "linewidth": 0.8, "marker": ".", "markersize": 3, "zorder": 2.2}
        axis.plot(*thin.T, label=None if number else "receiver's path", **look)
        if len(around.paths) <= MOST_NAMED:
            _named(axis, around.names[b], path[0])


def _outside(frame: pd.DataFrame, extent: np.ndarray) -> int:
    fixes = _finite(frame, "x_m", "y_m")
    return int(((fixes < extent[0]) | (fixes > extent[1])).any(axis=1).sum())


def _legend(made: Figure, axis: Any, outside: int) -> None:
    """The legend, with the number of fixes beyond the map."""
    handles, labels = axis.get_legend_handles_labels()
    if outside:
        from matplotlib.lines import Line2D

        handles.append(Line2D([], [], linestyle="none"))
        labels.append(f"beyond the map: {outside}")
    columns = min(len(labels), 6)
    made.set_figheight(made.get_figheight() + 0.25 * ((len(labels) - 1) // columns))
    made.legend(handles, labels, loc="outside lower center", ncols=columns, markerscale=1.5)
