"""Names, order and colours of the filters, shared by the figures."""

from __future__ import annotations

import pandas as pd

from aoabench.maths.statistics import Estimate
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


def closest(rows: pd.DataFrame) -> dict[str, Estimate]:
    """Excess in percent of PF-AE-adaptive over the better of the other AE particle filters: the
    larger excess in standard errors.
    """
    at = {r["estimator"]: r for r in rows.to_dict("records")}
    pf = at["pf_ae_adaptive"]
    against = [
        Estimate(pf[f"above_{m}_percent"], pf[f"above_{m}_se"]) for m in ("ae_nominal", "ae_fitted")
    ]
    return {"pf_adaptive_closest": max(against, key=significance)}


def significance(e: Estimate) -> float:
    """An estimate in standard errors."""
    return e.value / e.se
