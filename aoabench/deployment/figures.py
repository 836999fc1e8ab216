"""The figures of `locate`: the map and, with known truth, the distribution of the errors."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from aoabench.deployment.located import Located
from aoabench.maths.geometry import Array
from aoabench.report import campaign, located, plots
from aoabench.types import Tracks

if TYPE_CHECKING:
    import pandas as pd


def write(found: Located, out: Path, walls: Array | None = None) -> list[tuple[str, Path]]:
    """Draw the map beside the table `out` and, with known truth, the errors; return what each
    figure shows and its path. walls (W, 2, 2) m.
    """
    asked, frame = found.asked, found.frame
    anchors = asked.scenario.true_anchors
    position, rotation = anchors.position[0, 0], anchors.rotation[0, 0]
    names = asked.scenario.anchors_file.ids
    paths = _paths(asked.scenario.tracks, len(names))
    around = located.Surroundings(position, names, rotation, walls, found.rejected, paths)
    title = f"{_log(asked.scenario.path)}: {_counted(frame)}, {asked.name}"
    drawn = [("map", out.with_suffix(".png"))]
    plots.save(lambda: located.figure(frame, around, title), drawn[0][1])
    if found.with_truth:
        known = frame["true_x_m"].notna() & frame["true_y_m"].notna()
        errors = {asked.name: np.asarray(frame["error_xy_m"][known], dtype=float)}
        drawn.append(("errors", out.with_name(f"{out.stem}-errors.png")))
        plots.save(lambda: campaign.cdf(errors), drawn[1][1])
    return drawn


def _paths(tracks: Tracks, count: int) -> dict[int, Array]:
    """Where each anchor that moves measured, (K, 2) m in the order of time, by its number; a row of
    NaN ends a track, and each point where times are unknown.
    """
    if tracks.poses is None:
        return {}
    heard = np.isfinite(tracks.measured.azimuth) | np.isfinite(tracks.measured.elevation)
    place = np.where(heard[..., None], tracks.poses.position[0, :, :, :2], np.nan)
    timed, found = bool(np.isfinite(tracks.time).all()), {}
    for b in range(count):
        own = place[:, tracks.columns == b].reshape(-1, 2)
        track = np.repeat(np.arange(len(tracks.counts)), tracks.counts * (len(own) // len(place)))
        known = np.isfinite(own[:, 0])
        own, track = own[known], track[known]
        if len(own) and np.ptp(own, axis=0).any():
            ends = np.diff(track) != 0 if timed else np.full(len(own) - 1, True)
            found[b] = np.insert(own, np.flatnonzero(ends) + 1, np.nan, axis=0)
    return found


def _log(path: object) -> str:
    """The name of a log, or how many files it has."""
    if isinstance(path, str):
        return Path(path).name.replace("$", r"\$")
    return f"{len(path)} files" if isinstance(path, Sequence) else str(path)


def _counted(frame: pd.DataFrame) -> str:
    """The numbers of fixes and tags."""
    fixes, tags = len(frame), frame["tag"].nunique()
    of = f" of {tags} tags" if tags > 1 else ""
    return f"{fixes} fix{'es' * (fixes != 1)}{of}"
