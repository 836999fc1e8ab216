"""The figures of `locate`: the map and, with known truth, the distribution of the errors."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from aoabench.deployment.located import Located
from aoabench.maths.geometry import Array
from aoabench.report import campaign, located, plots


def write(found: Located, out: Path, walls: Array | None = None) -> list[tuple[str, Path]]:
    """Draw the map beside the table `out` and, with known truth, the errors; return what each
    figure shows and its path. walls (W, 2, 2) m.
    """
    asked, frame = found.asked, found.frame
    anchors = asked.scenario.true_anchors
    position, rotation = anchors.position[0, 0], anchors.rotation[0, 0]
    names = asked.scenario.anchors_file.ids
    around = located.Surroundings(position, names, rotation, walls, found.rejected)
    title = f"{asked.name}: {len(frame)} fixes"
    drawn = [("map", out.with_suffix(".png"))]
    plots.save(lambda: located.figure(frame, around, title), drawn[0][1])
    if found.with_truth:
        known = frame["true_x_m"].notna() & frame["true_y_m"].notna()
        errors = {asked.name: np.asarray(frame["error_xy_m"][known], dtype=float)}
        drawn.append(("errors", out.with_name(f"{out.stem}-errors.png")))
        plots.save(lambda: campaign.cdf(errors), drawn[1][1])
    return drawn
