"""The errata one by one, and positions and deviations that the paper does not have."""

from __future__ import annotations

import pandas as pd

from aoabench.maths import statistics
from aoabench.roles import Scenario

from .common import PROPOSED, Runs, mean_square
from .curves import accuracy


def errata(runs: Runs) -> pd.DataFrame:
    """Per deviation and variant: the columns of `accuracy`, and the RMSE above that of the
    corrected variant ("meant").
    """
    rows, squares = [], {}
    for cell, fixes in runs:
        options = cell.config["estimator"][PROPOSED]
        invariant = options["start"] == "invariant"
        if options["as_printed"] and invariant:
            continue
        variant = options["as_printed"] or ("invariant" if invariant else "meant")
        for row in accuracy(cell, fixes):
            name = row["estimator"]
            if name == "ls" and variant not in ("meant", "invariant"):
                continue
            squares[row["sigma_deg"], name, variant] = mean_square(fixes[name].error_3d_m)
            rows.append({"variant": variant, **row})
    for row in rows:
        key = row["sigma_deg"], row["estimator"]
        change = statistics.ratio(squares[*key, row["variant"]], squares[*key, "meant"]).root() - 1
        row |= change.percent().columns("above_meant_percent", "above_meant_se")
    return pd.DataFrame(rows)


def zones(runs: Runs) -> pd.DataFrame:
    """Per zone, deviation and estimator the columns of `accuracy`."""
    return pd.DataFrame(
        [{"zone": zone(cell.scenario), **row} for cell, f in runs for row in accuracy(cell, f)]
    )


def zone(scenario: Scenario) -> str:
    """The name of a zone in tables and figures."""
    return "none" if scenario.zone == "none" else f"{scenario.zone} {scenario.clearance_m:g} m"


def pole(runs: Runs) -> pd.DataFrame:
    """Per horizontal distance from a column, deviation and estimator the columns of `accuracy`."""
    return pd.DataFrame(
        [
            {"distance_m": cell.scenario.clearance_m, **row}
            for cell, f in runs
            for row in accuracy(cell, f)
        ]
    )
