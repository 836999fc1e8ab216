"""Table I, Figures 2 and 3: pilots, map, and the errors of the measurements."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pandas as pd

from aoabench.cell import Cell
from aoabench.engine.tiles import Draws
from aoabench.maths import statistics
from aoabench.maths.geometry import LIGHT
from aoabench.maths.places import at_places

from .common import SETTINGS, cell_of

Errors = dict[str, np.ndarray]  # of all measurements of a trial, by name
GRIDS = {
    "toa_m": np.linspace(-12, 12, 97),
    "azimuth_deg": np.linspace(-1, 1, 81),
    "elevation_deg": np.linspace(-1, 1, 81),
    "thermal_cm": np.geomspace(1e-3, 10, 81),
}
# of each trial's errors: (kind of number, number)
NUMBERS: dict[str, tuple[str, Callable[[Errors], float]]] = {
    "azimuth_within_half_degree": ("share", lambda e: _within(e["azimuth_deg"], 0.5)),
    "elevation_within_half_degree": ("share", lambda e: _within(e["elevation_deg"], 0.5)),
    "toa_within_10_m": ("share", lambda e: _within(e["toa_m"], 10.0)),
    "thermal_median_cm": ("median", lambda e: float(np.median(e["thermal_cm"]))),
    "all_over_thermal": ("ratio", lambda e: 100 * _rms(e["toa_m"]) / np.median(e["thermal_cm"])),
    "toa_over_across": ("ratio", lambda e: _rms(e["toa_m"]) / _rms(e["across_m"])),
}

# the readings of the claims on the errors; 10 dB is where azimuths have the printed 95 %
READINGS = SETTINGS | {"noise_figure_10_db": ("noise.noise_dbm=-83",)}


def _within(error: np.ndarray, limit: float) -> float:
    """Share in percent of the errors within +- `limit`."""
    return 100 * float(np.mean(np.abs(error) <= limit))


def _rms(error: np.ndarray) -> float:
    return float(np.sqrt(np.mean(error**2)))


def table1(scale: str) -> pd.DataFrame:
    """Pilot parameters as the preset has them; the bandwidth follows from two of them."""
    noise = cell_of().noise
    rows = [
        ("carrier_ghz", noise.carrier_ghz),
        ("subcarrier_khz", noise.subcarrier_khz),
        ("subcarriers", noise.subcarriers),
        ("bandwidth_mhz", 1e-3 * noise.subcarrier_khz * noise.subcarriers),
        ("power_dbm", noise.power_dbm),
        ("array_gain_db", noise.array_gain_db),
    ]
    return pd.DataFrame(
        [(name, float(value)) for name, value in rows], columns=["quantity", "value"]
    )


def fig2(scale: str) -> pd.DataFrame:
    """Walls (x_m, y_m to x1_m, y1_m), access nodes (facing x1_m, y1_m) and the points of the route,
    each with its number of access nodes in line of sight.
    """
    scenario = cell_of().scenario
    anchors, route = scenario.true_anchors, scenario.truth(np.random.default_rng(0))[:, :3]
    sees = scenario.line_of_sight(route).sum(axis=1)
    rows: list[tuple[Any, ...]] = [
        ("wall", *a, np.nan, *b, np.nan) for a, b in scenario.wall_segments
    ]
    facing = anchors.rotation[0, 0, :, 0, :2]
    rows += [("access node", *s, *f, np.nan) for s, f in zip(anchors.position[0, 0], facing)]
    rows += [("route", *p, np.nan, np.nan, n) for p, n in zip(route, sees)]
    frame = pd.DataFrame(
        rows, columns=["kind", "x_m", "y_m", "z_m", "x1_m", "y1_m", "line_of_sight"]
    )
    return frame.assign(area_m2=scenario.visited_area_m2, step_s=scenario.dt)


def fig3(scale: str) -> pd.DataFrame:
    """Distribution functions of the errors (kind `cdf`), and means over trials of the NUMBERS in
    each of the READINGS, with their standard errors.
    """
    trials = {"quick": 8, "paper": 200}[scale]
    rows: list[dict[str, Any]] = []
    for setting, words in READINGS.items():
        cell = cell_of(*words)
        draws = Draws(cell.scenario, cell.noise, cell.seed, range(trials))
        found = [e for first in range(0, trials, 8) for e in tile_errors(cell, draws, first)]
        if setting == "chosen":
            for name, grid in GRIDS.items():
                each = [np.searchsorted(np.sort(f[name]), grid) / len(f[name]) for f in found]
                cdf = np.mean(each, axis=0)
                of = {"kind": "cdf", "setting": setting, "name": name}
                rows += [of | {"x": x, "value": p, "trials": trials} for x, p in zip(grid, cdf)]
        for name, (kind, number) in NUMBERS.items():
            mean = statistics.mean([number(f) for f in found])
            row = {"kind": kind, "setting": setting, "name": name, "trials": trials}
            rows.append(row | mean.columns("value", "se"))
    clock = LIGHT * 1e-9 * cell_of().noise.clock_ns
    exact = {"kind": "exact", "setting": "chosen", "name": "clock_m", "trials": 0}
    rows.append(exact | {"value": clock, "se": 0.0})
    columns = ["kind", "setting", "name", "x", "value", "se", "se_skew", "se_units", "trials"]
    return pd.DataFrame(rows, columns=columns)


def tile_errors(cell: Cell, draws: Draws, first: int) -> Iterator[Errors]:
    """Errors of the measurements of each of eight trials, thermal deviations of the times, and
    errors of the angles across the line of sight in m, azimuths first.
    """
    truth, batch = draws.tile(first, 8, heard_only=True)
    assert batch.delay is not None
    anchors = cell.scenario.true_anchors
    position = at_places(anchors.position, batch.numbers, np.nan)
    rotation = at_places(anchors.rotation, batch.numbers, np.nan)
    offset = truth[:, :, None, :3] - position
    local = (rotation @ offset[..., None])[..., 0]
    d = np.linalg.norm(local, axis=-1)
    azimuth = np.arctan2(local[..., 1], local[..., 0])
    elevation = np.arcsin(local[..., 2] / d)
    turn, rise = batch.azimuth - azimuth, batch.elevation - elevation
    errors = {
        "toa_m": LIGHT * batch.delay - d,
        "azimuth_deg": np.rad2deg(turn),
        "elevation_deg": np.rad2deg(rise),
        "thermal_cm": 100 * LIGHT * cell.noise.delay_sigma(batch.rssi),
        "across_m": np.stack([d * np.cos(elevation) * turn, d * rise], axis=-1),
    }
    for r, seen in enumerate(np.isfinite(batch.azimuth)):
        yield {name: value[r][seen] for name, value in errors.items()}
