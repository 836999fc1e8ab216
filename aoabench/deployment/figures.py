"""The figures of `locate`: the map and, with known truth, the distribution of the errors."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from aoabench.deployment.located import Located
from aoabench.maths.geometry import Array
from aoabench.report import campaign, located, plots

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
    around = located.Surroundings(position, names, rotation, walls, found.rejected)
    title = f"{_log(asked.scenario.path)}: {_counted(frame)}, {asked.name}"
    drawn = [("map", out.with_suffix(".png"))]
    plots.save(lambda: located.figure(frame, around, title), drawn[0][1])
    if found.with_truth:
        known = frame["true_x_m"].notna() & frame["true_y_m"].notna()
        errors = {asked.name: np.asarray(frame["error_xy_m"][known], dtype=float)}
        drawn.append(("errors", out.with_name(f"{out.stem}-errors.png")))
        plots.save(lambda: campaign.cdf(errors), drawn[1][1])
    return drawn


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
