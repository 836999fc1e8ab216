"""Figures of a recording: its errors where the truth is known, else the positions found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from aoabench.report import campaign, plots
from aoabench.store.tracks import track_steps
from aoabench.types import Tracks

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

_COLUMNS = ("x_m", "y_m", "error_xy_m", "outcome")
_MOST_ARMS = 1.5  # extents of the anchors beyond which a position is not drawn
_MOST_NAMED = 10  # tags with names


def write(
    out: Path,
    cell: str,
    estimators: Mapping[str, str],
    tracks: Tracks,
    anchors: np.ndarray,
    bounds: Any = None,
) -> list[Path]:
    """Draw <out>/figures/<cell>-cdf.png and -median_map.png of the errors from the stored steps of
    a recording, or -positions.png without ground truth, and return their paths.

    estimators: the names to show by those stored; anchors (B, 2) m; bounds (2, 2) m or None.
    """
    steps = {shown: track_steps(out, cell, n, _COLUMNS) for n, shown in estimators.items()}
    count = min(map(len, steps.values()))
    truth = tracks.truth[:count, :2]
    known = np.isfinite(truth).all(axis=1)
    starts = tracks.starts[tracks.starts < count]
    folder = out / "figures"
    if not known.any():
        found = {name: _positions(frame[:count]) for name, frame in steps.items()}
        begins = dict(zip(starts.tolist(), tracks.tags))
        made = folder / f"{cell}-positions.png"
        return [plots.save(lambda: positions(found, begins, anchors, bounds), made)]
    errors = {name: _errors(frame[:count])[known] for name, frame in steps.items()}
    one = {name: error[None] for name, error in errors.items()}
    begin = np.searchsorted(np.flatnonzero(known), starts)
    distribution, where = (folder / f"{cell}-{n}.png" for n in ("cdf", "median_map"))
    return [
        plots.save(lambda: campaign.cdf(errors), distribution),
        plots.save(
            lambda: campaign.maps(truth[known], one, anchors, bounds, begin.tolist()), where
        ),
    ]


def _given(frame: pd.DataFrame) -> np.ndarray:
    return ~frame["outcome"].isin(["failed", "rejected"]).to_numpy()


def _errors(frame: pd.DataFrame) -> np.ndarray:
    """Errors in the plane (F,) m of the positions that an estimator gives, NaN for the others."""
    return np.where(_given(frame), frame["error_xy_m"].to_numpy(), np.nan)


def _positions(frame: pd.DataFrame) -> np.ndarray:
    """The positions (F, 2) m that an estimator gives, NaN for the others."""
    xy = frame[["x_m", "y_m"]].to_numpy(dtype=float)
    return np.where(_given(frame)[:, None], xy, np.nan)


def positions(
    found: Mapping[str, np.ndarray],
    begins: Mapping[int, str],
    anchors: np.ndarray,
    bounds: Any = None,
) -> Figure:
    """A map for each method: the positions (F, 2) m, a colour for each tag; `begins` has the index
    at which each track begins, and its tag. Positions far from the anchors are counted, not drawn.
    """
    centre = np.nanmean(anchors, axis=0)
    reach = _MOST_ARMS * max(float(np.nanmax(np.ptp(anchors, axis=0), initial=0.0)), 5.0)
    near = {n: xy[(np.abs(xy - centre) <= reach).all(axis=1)] for n, xy in found.items()}
    extent = campaign.extent_of(np.concatenate([*near.values(), anchors]), anchors, bounds)
    figure, axes, _ = campaign.panels(len(found), extent)
    for axis, (name, xy) in zip(axes, found.items()):
        given = xy[np.isfinite(xy[:, 0])]
        beyond = len(given) - len(near[name])
        title = f"{name}: {len(given)} of {len(xy)} fixes"
        _draw_tracks(axis, np.split(xy, list(begins)[1:]), list(begins.values()), extent)
        campaign.finish(axis, title + f", {beyond} beyond" * bool(beyond), anchors, bounds, extent)
    campaign.legend(figure, axes)
    return figure


def _draw_tracks(
    axis: Any, each: Sequence[np.ndarray], tags: Sequence[str], extent: np.ndarray
) -> None:
    """Draw tracks of positions (T, 2) m, those of a tag in one colour."""
    step = -(-sum(map(len, each)) // campaign.MOST_DRAWN)
    colours = {tag: f"C{i % 10}" for i, tag in enumerate(dict.fromkeys(tags))}
    named = set() if len(colours) <= _MOST_NAMED else set(colours)
    for tag, part in zip(tags, each):
        shown = part[np.isfinite(part[:, 0])][::step]
        label = f"tag {tag}" if tag and tag not in named else None
        named.add(tag)
        style = ".-" if campaign.is_path(shown, extent) else "."
        look: dict[str, Any] = {"linewidth": 0.5, "markersize": 2, "label": label}
        axis.plot(*shown.T, style, color=colours[tag], **look)
