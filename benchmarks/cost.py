"""Cost against size: replications, particles, anchors and steps, each with its slope.

The slope is that of log(processor time) over log(size) by least squares over the upper half of the
sizes; 1 means that the cost grows as the work does.
"""

from __future__ import annotations

import statistics
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.ticker import NullFormatter

from aoabench.cell import Cell
from aoabench.engine import runner
from aoabench.report import plots
from benchmarks.timing import Laps, Row, cell_of

WHAT = "cost against"
REPLICATIONS = (100, 1_000, 10_000, 100_000)
PARTICLES = (100, 1_000, 10_000, 100_000, 1_000_000)
ANCHORS = (1, 2, 5, 10, 20, 50, 100, 200)
DT = (1.0, 0.3, 0.1, 0.03)  # s
STEEPEST = "at most 1.1"
# of what the processor time is, by axis, its unit and the unit's seconds
MEASURED = {
    "replications": ("a run", "s", 1.0),
    "particles": ("a step", "us", 1e-6),
    "anchors": ("a step", "us", 1e-6),
    "steps": ("a walk", "ms", 1e-3),
}


def cost(repeats: int) -> Iterator[Row]:
    """Milliseconds of processor time for each size, and the slopes."""
    yield from _replications()
    yield from _sizes("particles", _particles(), "a lap of 64 steps, 4 anchors, 8 replications")
    yield from _sizes("anchors", _anchors(), "128 laps of 64 steps; pf_vmf with 1000 particles")
    yield from _sizes("steps", _steps(), "walks on the indoor map, 8 access nodes report")


def _replications() -> Iterator[Row]:
    """Whole runs on one process: simulation, filters, parts and tables."""
    for name in ("ekf_vmf", "pf_vmf"):
        more = ["filter.pf_vmf.particles=100"] if name == "pf_vmf" else []
        seconds: dict[int, float] = {}
        with tempfile.TemporaryDirectory() as folder:
            for reps in REPLICATIONS[: 3 if more else 4]:
                words = [f"reps={reps}", "runner.n_jobs=1", f"runner.out={folder}/{reps}", *more]
                cell = cell_of(*words, filters=[name])
                seconds[reps] = _cpu(lambda cell=cell: runner.run([cell], progress=False), 1)  # type: ignore[misc]
        how = "a whole run on one process, tables and timing included"
        yield from _rows("replications", name, seconds, how + ("; 100 particles" if more else ""))


def _particles() -> Iterator[tuple[str, int, Callable[[], Any]]]:
    for name in ("pf_vmf", "pf_ae_nominal"):
        for count in PARTICLES:
            cell = cell_of(f"filter.{name}.particles={count}", filters=[name])
            yield name, count, Laps(cell, name, tiles=1)


def _anchors() -> Iterator[tuple[str, int, Callable[[], Any]]]:
    for name in ("ekf_vmf", "ukf_vmf", "pf_vmf", "ls"):
        for count in ANCHORS[1 if name == "ls" else 0 :]:
            yield name, count, Laps(_around(name, count), name, tiles=1)


def _around(name: str, count: int) -> Cell:
    """A square track among `count` anchors on a circle of 6 m."""
    turn = 2 * np.pi * (np.arange(count) + 0.5) / count
    places = np.stack([2.5 + 6 * np.cos(turn), 2.5 + 6 * np.sin(turn), 0 * turn], -1).round(3)
    words = [f"scenario.anchors.position_m={places.tolist()}", "scenario.anchors.facing=null"]
    words += ["filter.pf_vmf.particles=1000"] if name == "pf_vmf" else []
    role = "estimators" if name == "ls" else "filters"
    return cell_of(*words, **{role: [name]})  # type: ignore[arg-type]


def _steps() -> Iterator[tuple[str, int, Callable[[], Any]]]:
    for name in ("ekf_toa_aoa", "ekf_vmf"):
        for dt in DT:
            words = ["scenario=indoor_map", "noise=ofdm_crlb", f"scenario.dt={dt}"]
            laps = Laps(cell_of(*words, filters=[name]), name, tiles=1)
            yield name, laps.batches[0].azimuth.shape[1], laps


def _sizes(
    axis: str, actions: Iterator[tuple[str, int, Callable[[], Any]]], how: str
) -> Iterator[Row]:
    """The rows of an axis; each action is made, timed and dropped in turn."""
    seconds: dict[str, dict[int, float]] = {}
    for name, size, action in actions:
        tile = getattr(action, "steps", 1)
        per_step = size if axis == "steps" else 1
        seconds.setdefault(name, {})[size] = _cpu(action, 3) / tile * per_step
    for name, each in seconds.items():
        yield from _rows(axis, name, each, how)


def _cpu(action: Callable[[], Any], repeats: int) -> float:
    """Median seconds of processor time of a call, after one to warm up if there are several."""
    seconds = []
    for turn in range(repeats + (repeats > 1)):
        begin = time.process_time()
        action()
        if turn or repeats == 1:
            seconds.append(time.process_time() - begin)
    return statistics.median(seconds)


def _rows(axis: str, name: str, seconds: dict[int, float], how: str) -> Iterator[Row]:
    _, unit, one = MEASURED[axis]
    for size, value in seconds.items():
        yield Row(f"{WHAT} {axis} in sizes", f"{name}, {size}", value / one, unit, "", how)
    sizes = ", ".join(f"{n:,}" for n in seconds)
    slope = slope_of(list(seconds), list(seconds.values()))
    yield Row(f"{WHAT} {axis}", f"{name}, slope", slope, "", STEEPEST, f"{how}; {sizes}")


def slope_of(sizes: Sequence[float], values: Sequence[float]) -> float:
    """Slope of log(value) over log(size) by least squares over the upper half of the sizes."""
    half = min(len(sizes) // 2, len(sizes) - 2)
    fit = np.polyfit(np.log(sizes[half:]), np.log(values[half:]), 1)
    return float(fit[0])


def draw(frame: pd.DataFrame, path: Path) -> None:
    """Write a figure with a panel for each size, on logarithmic axes."""
    rows = frame[frame["what"].str.startswith(WHAT) & frame["what"].str.endswith(" in sizes")]
    if len(rows):
        plots.save(lambda: _figure(frame, rows), path)


def _figure(frame: pd.DataFrame, rows: pd.DataFrame) -> Any:
    figure, axes = plots.new(plots.PAGE, 4.6, rows=2, cols=2)
    for axis, (name, (measured, unit, _)) in zip(np.ravel(axes), MEASURED.items()):
        slopes = frame[frame["what"] == f"{WHAT} {name}"]
        part = rows[rows["what"] == f"{WHAT} {name} in sizes"]
        if len(part):
            _panel(axis, part, slopes)
        axis.set_xlabel(f"number of {name}")
        axis.set_ylabel(f"processor time of {measured} in {unit.replace('us', 'µs')}")
    return figure


def _panel(axis: Any, part: pd.DataFrame, slopes: pd.DataFrame) -> None:
    """Draw the cost of each estimator; the legend has its slope."""
    split = part["detail"].str.rsplit(", ", n=1)
    markers = "osD^"
    for i, name in enumerate(dict.fromkeys(split.str[0])):
        mine = part[split.str[0] == name]
        sizes = mine["detail"].str.rsplit(", ", n=1).str[1].astype(int)
        slope = slopes.loc[slopes["detail"] == f"{name}, slope", "value"].iloc[0]
        label = f"{name}, slope {slope:.2f}"
        axis.plot(sizes, mine["value"], marker=markers[i], markersize=3.5, lw=1.2, label=label)
    axis.set(xscale="log", yscale="log")
    lowest, highest = axis.get_ylim()
    axis.set_ylim(10 ** np.floor(np.log10(lowest)), 10 ** np.ceil(np.log10(highest)))
    for one in (axis.xaxis, axis.yaxis):
        one.set_minor_formatter(NullFormatter())
    axis.grid(which="major", linewidth=0.4)
    axis.legend(fontsize=6, loc="best")
