"""Draw the pictures of docs/explanation/angles.md, from aoabench's own geometry.

python docs/figures/angles.py writes them beside this file.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.patches import Arc

from aoabench.maths.directional import kappa_from_sigma, vmf_sample
from aoabench.maths.geometry import euler, in_frames, to_azel, to_unit
from aoabench.report import plots

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ANCHOR = np.array([1.0, 1.0, 2.5])
TAG = np.array([5.0, 3.5, 1.0])
FACING_DEG, PITCH_DEG = 75.0, 40.0
SIGMA_DEG = 5.0
ELEVATIONS_DEG = (0, 60, 85)


def measured(
    facing_deg: float = 0.0, pitch_deg: float = 0.0, roll_deg: float = 0.0
) -> tuple[float, float]:
    """Azimuth and elevation in deg of TAG as an anchor at ANCHOR with this mounting sees it."""
    rotation = euler(np.radians([roll_deg, pitch_deg, facing_deg])).T
    x, y, z = in_frames(TAG[None], ANCHOR[None, None], rotation[None, None])
    azimuth, elevation = np.degrees(to_azel(x, y, z)).ravel()
    return float(azimuth), float(elevation)


def frames() -> Figure:
    """An anchor and a tag, from above and from the side."""
    figure, (above, side) = plots.new(plots.PAGE, 2.9, cols=2)
    azimuth, _ = measured(FACING_DEG)
    _from_above(above, azimuth)
    _from_the_side(side)
    for axis in (above, side):
        axis.set_aspect("equal")
        axis.grid(False)
    return figure


def _from_above(axis: Axes, azimuth: float) -> None:
    _arrow(axis, ANCHOR[:2], (2.4, 0), plots.GREY, "global +x")
    _arrow(axis, ANCHOR[:2], (0, 2.0), plots.GREY, "+y")
    turned = euler([0, 0, np.radians(FACING_DEG)])[:2, 0]
    _arrow(axis, ANCHOR[:2], 3.0 * turned, plots.COLOURS["ae_nominal"], "the anchor's own +x")
    axis.plot(*zip(ANCHOR[:2], TAG[:2]), color=plots.COLOURS["vmf"])
    _arc(axis, ANCHOR[:2], 1.0, 0, FACING_DEG, f"facing_deg = {FACING_DEG:.0f}", at=0.22)
    _arc(
        axis,
        ANCHOR[:2],
        2.0,
        FACING_DEG + azimuth,
        FACING_DEG,
        f"azimuth = {azimuth:.1f} deg",
        at=0.6,
    )
    _ends(axis, ANCHOR[:2], TAG[:2])
    axis.set(title="from above", xlabel="x (m)", ylabel="y (m)", xlim=(0.2, 6.2), ylim=(0.2, 4.6))


def _from_the_side(axis: Axes) -> None:
    """The vertical plane through anchor and tag, towards which the anchor faces."""
    flat = float(np.linalg.norm(TAG[:2] - ANCHOR[:2]))
    bearing = float(np.degrees(np.arctan2(*(TAG - ANCHOR)[1::-1])))
    _, level = measured(bearing)
    _, tilted = measured(bearing, PITCH_DEG)
    here, there = np.array([0, ANCHOR[2]]), np.array([flat, TAG[2]])
    down = euler([0, np.radians(PITCH_DEG), 0])[[0, 2], 0]
    _arrow(axis, here, (2.4, 0), plots.GREY, "horizontal")
    _arrow(axis, here, 2.2 * down, plots.COLOURS["ae_nominal"], "own +x")
    axis.plot(*zip(here, there), color=plots.COLOURS["vmf"])
    _arc(axis, here, 1.2, -PITCH_DEG, 0, f"pitch_deg = {PITCH_DEG:.0f}", at=0.8)
    _ends(axis, here, there)
    axis.set(title="from the side", xlabel="horizontal distance (m)", ylabel="z (m)")
    axis.set(xlim=(-0.6, 5.6), ylim=(-0.6, 3.4))
    text = f"elevation without pitch {level:.1f} deg\nwith pitch {tilted:.1f} deg"
    axis.text(-0.3, -0.4, text, fontsize=7)


def poles() -> Figure:
    """Azimuths and elevations of directions with the same error in space, at three elevations."""
    figure, axes = plots.new(plots.PAGE, 2.5, cols=len(ELEVATIONS_DEG), sharey=True)
    for axis, elevation_deg in zip(axes, ELEVATIONS_DEG):
        azimuth, elevation = spread(elevation_deg)
        axis.plot(azimuth, elevation, ".", ms=1.5, color=plots.COLOURS["vmf"], rasterized=True)
        axis.set(xlim=(-180, 180), ylim=(-25, 95), xticks=[-90, 0, 90])
        axis.set(title=f"elevation {elevation_deg} deg", xlabel="measured azimuth (deg)")
    axes[0].set_ylabel("measured elevation (deg)")
    return figure


def spread(elevation_deg: float, n: int = 1500) -> tuple[np.ndarray, np.ndarray]:
    """Azimuths and elevations (n,) deg of directions about azimuth 0 and this elevation, with a
    von Mises-Fisher error of SIGMA_DEG.
    """
    mean = to_unit(0.0, np.radians(elevation_deg))
    kappa = kappa_from_sigma(np.radians(SIGMA_DEG))
    u = vmf_sample(np.random.default_rng(1), np.broadcast_to(mean, (n, 3)), kappa)
    azimuth, elevation = np.degrees(to_azel(*u.T))
    return azimuth, elevation


def _arrow(axis: Axes, start: np.ndarray, by: Any, colour: str, text: str) -> None:
    end = start + np.asarray(by)
    axis.annotate("", end, start, arrowprops={"arrowstyle": "->", "color": colour, "shrinkA": 0})
    axis.annotate(text, end, (3, 3), textcoords="offset points", color=colour, fontsize=7)


def _arc(
    axis: Axes, centre: np.ndarray, radius: float, start: float, end: float, text: str, at: float
) -> None:
    """An arc from `start` to `end`, deg counter-clockwise, with its name at a fraction of it."""
    axis.add_patch(Arc(tuple(centre), 2 * radius, 2 * radius, theta1=start, theta2=end, lw=0.9))
    angle = np.radians(start + at * (end - start))
    place = centre + (radius + 0.05) * np.array([np.cos(angle), np.sin(angle)])
    label = {"facecolor": "white", "edgecolor": "none", "pad": 0.5}
    axis.annotate(
        text, place, (2, 0), textcoords="offset points", va="center", fontsize=7, bbox=label
    )


def _ends(axis: Axes, anchor: np.ndarray, tag: np.ndarray) -> None:
    for (x, y), text, mark in ((anchor, "anchor", "^"), (tag, "tag", "o")):
        axis.plot(x, y, mark, color="black", ms=5)
        axis.annotate(text, (x, y), (-12, -11), textcoords="offset points", fontsize=7)


if __name__ == "__main__":
    for make in (frames, poles):
        plots.save(make, Path(__file__).with_name(f"angles_{make.__name__}"), ("png",))
