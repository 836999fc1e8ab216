"""What the paper leaves open of the discrepancy filter, one option at a time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from aoabench.maths import statistics
from aoabench.store.fixes import Fixes

from .common import Runs, columns, difference, error, lost, rejected, within

AS_HERE = "as here"
READINGS = {  # stems of the estimators in configs/experiment/boquet2024_readings.yaml
    "as_here": AS_HERE,
    "ties_by_area": "ties by area",
    "least_axis_001": "least axis 0.01 m",
    "least_axis_03": "least axis 0.3 m",
    "horizon_5": "horizon 5 deg",
    "sigma_111": "sigma 11.1 deg",
    "centre_of_estimate": "centre of estimate",
}
R_SIGMAS = (0.2, 0.4, 1.0, 2.0)
HEIGHT_M = 1.0  # of the node, where only the filter is varied
WITHOUT_AT = 1.0  # R_sigma of the filter without the vote in Figure 5
WITHOUT = ("as_here", "ties_by_area")  # whose options, but for the vote, the one without it has


def readings(runs: Runs) -> pd.DataFrame:
    """P(error <= 1 m) and R_d of the filter per reading and R_sigma, and differences in
    P(error <= 1 m), paired over campaigns.

    `over_best`: minus that of the best single anchor; `over_no_vote`: minus that without the second
    stage at R_sigma = WITHOUT_AT, `over_no_vote_same` at the same one, for WITHOUT. `effect` and
    `lost_effect`: P(error <= 1 m) and R_d minus those of the reading that the study uses.
    """
    cells = {cell.scenario.known_height_m: fixes for cell, fixes in runs}
    base = cells[HEIGHT_M]
    rows = []
    for height, fixes in cells.items():
        for stem, name in READINGS.items() if height == HEIGHT_M else [("as_here", AS_HERE)]:
            label = name if height == HEIGHT_M else f"height {height:g} m"
            rows += [_row(label, r, stem, fixes, base) for r in R_SIGMAS]
    return pd.DataFrame(rows)


def _row(
    label: str, r: float, stem: str, fixes: Mapping[str, Fixes], base: Mapping[str, Fixes]
) -> dict[str, Any]:
    """A row of `readings`: the filter `stem` in `fixes` against that as here in `base`."""
    f, used = fixes[of(stem, r)], base[of("as_here", r)]
    e = error(f)
    found = {
        "within_1m": within(e),
        "lost": lost(f),
        "over_best": difference(e, error(fixes["best_anchor"])),
    }
    if stem in WITHOUT:
        found["over_no_vote"] = difference(e, error(fixes[of("no_vote", WITHOUT_AT)]))
        found["over_no_vote_same"] = difference(e, error(fixes[of("no_vote", r)]))
    if f is not used:
        found["effect"] = difference(e, error(used))
        found["lost_effect"] = statistics.ratio_difference(*rejected(f), *rejected(used))
    fixes_given = int(np.isfinite(e).sum())
    return {"reading": label, "r_sigma": r, "fixes": fixes_given, **columns(**found)}


def of(stem: str, r: float) -> str:
    """The name of an estimator of the experiment at an R_sigma."""
    return f"df_{stem}_{round(10 * r):02d}"
