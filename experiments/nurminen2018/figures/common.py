"""Names, order and colours of the filters, shared by the figures."""

from __future__ import annotations

from typing import Any

import pandas as pd

from aoabench.maths.estimate import Estimate, stored
from aoabench.report.plots import COLOURS, LABELS

TITLES = {"ae_flip": "Model I: normal angles, flipped", "vmf": "Model II: von Mises-Fisher"}
MODELS = ("vmf", "ae_adaptive", "ae_fitted", "ae_nominal")
ORDER = [f"{family}_{model}" for family in ("pf", "ekf", "ukf") for model in MODELS]
ORDER.insert(ORDER.index("ukf_ae_adaptive") + 1, "ukf_ae_adaptive_augmented")


def label(estimator: str) -> str:
    """The label of a filter in figures, e.g. UKF-VMF for `ukf_vmf`."""
    family, _, model = estimator.partition("_")
    augmented = " (aug.)" if model.endswith("_augmented") else ""
    return f"{family.upper()}-{LABELS[model.removesuffix('_augmented')]}{augmented}"


def colour(estimator: str) -> str:
    """The colour of a filter's measurement model."""
    return COLOURS[estimator.partition("_")[2].removesuffix("_augmented")]


def counts(frame: pd.DataFrame) -> str:
    """Particles and replications of a table, in words."""
    return f"{frame['particles'].iloc[0]} particles, {frame['replications'].iloc[0]} replications"


def numbers_of(r: dict[str, Any], key: str) -> dict[str, Estimate]:
    """Numbers in percent for the claims on one filter, from its row.

    For an AE filter: the mean RMSE above that of the same filter with VMF, the share of laps with a
    smaller RMSE, and the excess beyond that of the particle filter with the same model; for a VMF
    filter the difference from PF-VMF; for AE-adaptive also that from the other AE models.
    """

    def estimate(name: str) -> Estimate:
        return stored(r, f"{name}_percent", f"{name}_se")

    found = {}
    if r["model"] != "vmf":
        found["above_own_vmf"] = estimate("above_vmf")
        if "wins_percent" in r:  # a table of an earlier version has neither
            found["wins"] = estimate("wins")
            if r["family"] != "pf":
                found["beyond_pf"] = estimate("beyond_pf")
    elif r["family"] != "pf":
        found["mean"] = estimate("above_pf_vmf")
        found["median"] = stored(r, "q50", "median_se")
    if r["model"].startswith("ae_adaptive"):
        for other in ("ae_nominal", "ae_fitted"):
            found[f"above_{other}"] = estimate(f"above_{other}")
    return {f"{key}/{name}": value for name, value in found.items()}
