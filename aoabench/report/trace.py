"""Picture of one replayed replication: path, errors, innovations and effective particles."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from aoabench.report import plots

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

ELLIPSES = 40  # at most
POSITIONS = ("true_x_m", "true_y_m", "x_m", "y_m")
COMPONENTS = {
    "azimuth_rad": "azimuth",
    "elevation_rad": "elevation",
    "x": "x",
    "y": "y",
    "z": "z",
    "range_m": "range",
}


def figure(
    frame: pd.DataFrame,
    title: str,
    anchors: np.ndarray,
    walls: np.ndarray | None = None,
    moving: bool = True,
) -> Figure:
    """Plan and errors of a trace (see `engine.replay.replay`), without known truth the stated
    deviations; below them innovations and effective particles, if any.

    anchors (B, 3) m, walls (W, 2, 2) m or None; `moving`: the positions are one path, not separate
    points.
    """
    seen = [c for c in frame.columns if c.startswith("innovation_") and not c.endswith("range_m")]
    panels = [_errors, *([_innovations] if seen else []), *([_effective] if "ess" in frame else [])]
    made, axes = plots.new(
        plots.PAGE,
        3.4 if len(panels) < 3 else 4.2,
        rows=len(panels),
        cols=2,
        gridspec_kw={"width_ratios": [1, 1.1]},
    )
    grid = np.atleast_2d(axes)
    for axis in grid[:, 0]:
        axis.remove()
    _plan(made.add_subplot(grid[0, 0].get_gridspec()[:, 0]), frame, anchors, walls, moving)
    for axis, draw in zip(grid[:, 1], panels):
        axis.margins(x=0.01)
        draw(axis, frame)
    if not moving and grid[0, 1].lines:
        grid[0, 1].lines[0].set(linestyle="none", marker=".", markersize=2)
    for axis in grid[:-1, 1]:
        axis.set_xticklabels([])
    grid[-1, 1].set_xlabel("step" if moving else "point")
    made.suptitle(title, fontsize=9)
    return made


def _plan(
    axis: Any, frame: pd.DataFrame, anchors: np.ndarray, walls: np.ndarray | None, moving: bool
) -> None:
    """Draw walls, true and estimated positions and anchors from above."""
    from matplotlib.collections import LineCollection

    if walls is not None:
        axis.add_collection(LineCollection(list(walls), colors="black", linewidths=0.8))
    (_path if moving else _points)(axis, frame)
    failed = frame[frame["outcome"] == "failed"]
    if len(failed):
        look = {"color": plots.COLOURS["ae_nominal"], "markersize": 4, "label": "failed"}
        axis.plot(failed["true_x_m"].to_numpy(), failed["true_y_m"].to_numpy(), "x", **look)
    near = np.isfinite(anchors[:, :2]).all(axis=1)
    look = {"color": "black", "markersize": 4 if near.sum() < 30 else 2, "linestyle": "none"}
    axis.plot(*anchors[near, :2].T, "^", label="anchors", **look)
    axis.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
    axis.legend(loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=4)


def _path(axis: Any, frame: pd.DataFrame) -> None:
    """Draw the true and the estimated path, with ellipses."""
    x, y, at, to = (frame[c].to_numpy() for c in POSITIONS)
    blue, marker = plots.COLOURS["vmf"], "." if len(frame) <= 300 else "none"
    if np.isfinite(x).any():
        axis.plot(x, y, color=plots.GREY, linewidth=2.2, alpha=0.7, label="truth")
    axis.plot(at, to, color=blue, marker=marker, markersize=3, linewidth=0.8, label="estimate")
    _ellipses(axis, frame, blue)


def _points(axis: Any, frame: pd.DataFrame) -> None:
    """Draw separate true positions, each with a line to its estimate."""
    from matplotlib.collections import LineCollection

    x, y, at, to = (frame[c].to_numpy() for c in POSITIONS)
    axis.plot(x, y, ".", color=plots.GREY, markersize=3, label="truth")
    both = np.stack([np.stack([x, y], axis=-1), np.stack([at, to], axis=-1)], axis=1)
    known = list(both[np.isfinite(both).all((1, 2))])
    lines = LineCollection(known, colors=plots.COLOURS["vmf"], linewidths=0.6)
    lines.set_label("to the estimate")
    axis.add_collection(lines)


def _ellipses(axis: Any, frame: pd.DataFrame, colour: str) -> None:
    """Draw ellipses of two standard deviations about some of the estimates."""
    from matplotlib.patches import Ellipse

    if "cov_xx_m2" not in frame:
        return
    for _, row in frame.iloc[:: -(-len(frame) // ELLIPSES)].iterrows():
        P = np.array([[row["cov_xx_m2"], row["cov_xy_m2"]], [row["cov_xy_m2"], row["cov_yy_m2"]]])
        if np.isfinite(P).all():
            spread, axes = np.linalg.eigh(P)
            width, height = 4 * np.sqrt(np.maximum(spread, 0.0))
            turn = np.degrees(np.arctan2(axes[1, 0], axes[0, 0]))
            place = (row["x_m"], row["y_m"])
            axis.add_patch(Ellipse(place, width, height, angle=turn, facecolor=colour, alpha=0.12))


def _errors(axis: Any, frame: pd.DataFrame) -> None:
    known = frame["error_3d_m"].notna().any() or frame["true_x_m"].notna().any()
    if known:
        look = {"color": plots.COLOURS["vmf"], "linewidth": 1.0, "label": "error"}
        axis.plot(frame["step"], frame["error_3d_m"], **look)
    if "cov_xx_m2" in frame:
        z = frame["cov_zz_m2"].fillna(0.0)  # of a position in the plane
        stated = np.sqrt(np.maximum(frame["cov_xx_m2"] + frame["cov_yy_m2"] + z, 0.0))
        axis.fill_between(
            frame["step"],
            0,
            stated,
            color=plots.GREY,
            alpha=0.2,
            linewidth=0,
            label="stated, 1 sigma",
        )
    axis.set_ylabel("3-D error [m]" if known else "standard deviation [m]")
    axis.set_ylim(bottom=0)
    _legend_above(axis)


def _innovations(axis: Any, frame: pd.DataFrame) -> None:
    for number, (component, label) in enumerate(COMPONENTS.items()):
        columns = [
            c
            for c in frame.columns
            if c.startswith("innovation_") and c.split("_", 2)[2] == component
        ]
        if not columns or component == "range_m":
            continue
        angle = component.endswith("_rad")
        values = frame[columns].to_numpy()
        step = np.repeat(frame["step"].to_numpy(), len(columns))
        axis.plot(
            step,
            (np.degrees(values) if angle else values).ravel(),
            ".",
            markersize=2,
            color=f"C{number % 5}",
            label=label,
        )
        axis.set_ylabel("innovation [°]" if angle else "innovation")
    _legend_above(axis)


def _legend_above(axis: Any) -> None:
    if not axis.get_legend_handles_labels()[0]:
        return
    axis.legend(
        loc="lower right", bbox_to_anchor=(1.0, 0.96), ncols=3, handlelength=1.5, borderaxespad=0
    )


def _effective(axis: Any, frame: pd.DataFrame) -> None:
    axis.semilogy(frame["step"], frame["ess"], color=plots.COLOURS["ae_adaptive"], linewidth=1.0)
    axis.set_ylabel("effective particles")
