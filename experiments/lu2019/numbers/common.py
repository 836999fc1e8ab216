"""The methods, and a cell of the study."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields
from typing import Any

from aoabench.cell import Cell
from aoabench.config.compose import compose_cells
from aoabench.engine.tiles import Draws, estimate_tile, tile_of
from aoabench.maths.geometry import Array
from aoabench.types import Estimates

METHODS = ("ekf_toa_aoa", "ekf_aoa", "wcg")
FILTERS = "filter=[ekf_toa_aoa,ekf_aoa]"
# What the paper leaves open, each with its overrides; "chosen" is what all other items use: the
# nearest eight of the access nodes in sight report, cosines off broadside are kept above 0.02, and
# the noise figure is 9 dB (-84 dBm of noise)
SETTINGS: dict[str, tuple[str, ...]] = {
    "chosen": (),
    "all_in_sight": ("scenario.nearest=null",),
    "cosine_0.001": ("noise.cosine_floor=0.001",),
    "cosine_0.1": ("noise.cosine_floor=0.1",),
    "noise_figure_5_db": ("noise.noise_dbm=-88",),
    "noise_figure_13_db": ("noise.noise_dbm=-80",),
}


def cell_of(
    *words: str,
    scenario: str = "indoor_map",
    methods: tuple[str, ...] = (FILTERS, "estimator=[wcg]"),
) -> Cell:
    """A cell with the study's noise, from overrides, a scenario and the overrides that choose the
    methods.
    """
    return compose_cells([f"scenario={scenario}", "noise=ofdm_crlb", *methods, *words])[0]


def estimated(cell: Cell, trials: int) -> Iterator[tuple[str, Array, Estimates]]:
    """Name, true states (R, T, n) and estimates of each method in the first trials, tile by tile.

    All methods of the study take tiles of one size, so that each tile is drawn once.
    """
    draws = Draws(cell.scenario, cell.noise, cell.seed, range(trials))
    (size,) = {tile_of(estimator, cell.scenario) for estimator in cell.estimators.values()}
    for first in range(0, trials, size):
        for name, estimator in cell.estimators.items():
            truth, found = estimate_tile(draws, estimator, first)
            yield name, truth[: trials - first], _first(found, trials - first)


def _first(found: Estimates, count: int) -> Estimates:
    """The estimates of the first replications of a tile, at most `count`."""
    arrays: dict[str, Any] = {f.name: getattr(found, f.name) for f in fields(found)}
    return Estimates(**{name: a if a is None else a[:count] for name, a in arrays.items()})
