"""An animated track from the traces that `aoabench replay` writes, one per estimator, of one
replication:

python -m aoabench.report.animation TRACE [TRACE ...] --out FILE.gif

Without --out it writes results/draft/figures/track.gif, with COMMIT=1 in the environment the
committed results/figures/track.gif.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from aoabench.report import plots
from aoabench.resources import output_folder
from aoabench.store.files import read_provenance, write_atomically

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

INSIDE_95 = 2.4477  # sqrt of the 95 % quantile of chi square with 2 degrees of freedom


def ellipse(row: pd.Series, points: int = 60) -> np.ndarray:
    """The 95 % ellipse (points, 2) m of the horizontal position, from the covariance of one step of
    a trace.
    """
    xx, yy, xy = row["sigma_x_m"] ** 2, row["sigma_y_m"] ** 2, row["cov_xy_m2"]
    spread, axes = np.linalg.eigh([[xx, xy], [xy, yy]])
    turn = np.linspace(0, 2 * np.pi, points)
    circle = np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    return (
        np.array([row["x_m"], row["y_m"]])
        + INSIDE_95 * (circle * np.sqrt(np.maximum(spread, 0))) @ axes.T
    )


def frame(
    traces: Mapping[str, pd.DataFrame], step: int, anchors: Mapping[str, Any], tail: int = 8
) -> Figure:
    """One picture: the truth so far, and each estimator's last positions with its 95 % ellipse."""
    figure, axis = plots.new(plots.COLUMN, plots.COLUMN)
    position = np.array(anchors["position_m"], dtype=float)
    _anchors(axis, position, anchors.get("facing"))
    _truth(axis, next(iter(traces.values()))[: step + 1])
    for name, trace in traces.items():
        _estimate(axis, name, trace[max(0, step - tail) : step + 1])
    low, high = position[:, :2].min(axis=0), position[:, :2].max(axis=0)
    axis.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    axis.set(xlim=(low[0] - 1, high[0] + 1), ylim=(low[1] - 2, high[1] + 2))
    axis.set(title="95 % ellipses as each filter reports them")
    figure.legend(*axis.get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return figure


def _anchors(axis: Any, position: np.ndarray, facing: Any) -> None:
    """Draw anchors (B, 3) m, and 20 m of the axis of each pole (B, 3) if they are known."""
    if facing is not None:
        ends = position + 20 * np.array(facing, dtype=float)
        for line in np.stack([position, ends], axis=1)[..., :2]:
            axis.plot(*line.T, color=plots.GREY, ls=":", lw=0.7)
    label = "anchor and its pole"
    axis.plot(position[:, 0], position[:, 1], "X", color=plots.GREY, ms=6, label=label)


def _truth(axis: Any, trace: pd.DataFrame) -> None:
    """Draw the true positions of a trace, with a dot at the last."""
    x, y = trace["true_x_m"], trace["true_y_m"]
    axis.plot(x, y, color="black", lw=0.8)
    axis.plot(x.iloc[-1], y.iloc[-1], "o", color="black", ms=5, label="truth")


def _estimate(axis: Any, name: str, trace: pd.DataFrame) -> None:
    """Draw an estimator's positions, with its ellipse about the last."""
    family, _, model = name.partition("_")
    colour = plots.COLOURS.get(model, plots.GREY)
    look = {"color": colour, "marker": plots.MARKERS.get(model, "o"), "ms": 2.5, "lw": 0.9}
    label = f"{family.upper()}-{plots.LABELS.get(model, model)}"
    axis.plot(trace["x_m"], trace["y_m"], label=label, **look)
    outline = ellipse(trace.iloc[-1])
    axis.fill(*outline.T, facecolor=colour, alpha=0.25, edgecolor=colour, lw=1.0)


def write(
    traces: Mapping[str, pd.DataFrame], anchors: Mapping[str, Any], path: Path, dpi: int = 120
) -> Path:
    """Write the GIF of all steps to `path` and return `path`."""
    import matplotlib.pyplot as plt
    from PIL import Image

    pictures = []
    with plt.style.context(str(plots.STYLE)):
        for step in range(min(len(trace) for trace in traces.values())):
            figure = frame(traces, step, anchors)
            figure.set_dpi(dpi)
            figure.canvas.draw()
            pixels = np.asarray(figure.canvas.buffer_rgba())[..., :3]  # type: ignore[attr-defined]
            pictures.append(Image.fromarray(pixels.copy()).quantize(112, dither=Image.Dither.NONE))
            plt.close(figure)

    def save(temporary: Path) -> None:
        pictures[0].save(
            temporary,
            "GIF",
            save_all=True,
            append_images=pictures[1:],
            duration=160,
            loop=0,
            optimize=True,
        )

    write_atomically(path, save)
    return path


def main(arguments: Sequence[str] | None = None) -> None:
    """Read traces and write the animation."""
    import matplotlib
    import pandas as pd

    matplotlib.use("Agg")
    parser = argparse.ArgumentParser(
        prog="python -m aoabench.report.animation", description=__doc__
    )
    parser.add_argument(
        "traces",
        nargs="+",
        type=Path,
        metavar="TRACE",
        help="<cell>-<estimator>-<replication>.parquet",
    )
    parser.add_argument("--out", type=Path, default=output_folder() / "figures" / "track.gif")
    given = parser.parse_args(arguments)
    traces = {path.stem.split("-")[1]: pd.read_parquet(path) for path in given.traces}
    anchors = read_provenance(given.traces[0])["config"]["scenario"]["anchors"]
    path = write(traces, anchors, given.out)
    print(f"{path}: {path.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
