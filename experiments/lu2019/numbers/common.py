"""The methods, and a cell of the study."""

from __future__ import annotations

from aoabench.cell import Cell
from aoabench.config.compose import compose_cells

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
