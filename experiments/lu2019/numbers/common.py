"""The methods, and a cell of the study."""

from __future__ import annotations

from aoabench.cell import Cell
from aoabench.config.compose import compose_cells

METHODS = ("ekf_toa_aoa", "ekf_aoa", "wcg")
FILTERS = "filter=[ekf_toa_aoa,ekf_aoa]"


def cell_of(
    *words: str,
    scenario: str = "indoor_map",
    methods: tuple[str, ...] = (FILTERS, "estimator=[wcg]"),
) -> Cell:
    """A cell with the study's noise, from overrides, a scenario and the overrides that choose the
    methods.
    """
    return compose_cells([f"scenario={scenario}", "noise=ofdm_crlb", *methods, *words])[0]
