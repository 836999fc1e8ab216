"""A robust estimator, which is not of the paper, beside its methods and its filter."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import pandas as pd

from aoabench.store.fixes import Fixes

from .common import METHODS, SCORED, Runs, columns, difference, error, filters, only, within
from .comparisons import covered, thresholded

VARIANTS = {  # estimators of the experiment, by what differs from robust_ml
    "robust_ml": "student",
    "robust_huber": "huber",
    "robust_truncated": "truncated",
    "robust_normal": "normal",
    "robust_half": "student, half the deviations",
    "robust_double": "student, twice the deviations",
}


def robust(runs: Runs) -> pd.DataFrame:
    """P(error <= 1 m) of each of VARIANTS minus that of others, paired over campaigns.

    `at`: `all` (each on its own fixes), `accepted` (both on the fixes that the filter gives),
    `coverage` (methods reject their fixes of the worst score until they give as many as the filter
    of `r_sigma`), `curve` (P(error <= 1 m) of a method alone, by coverage).
    """
    _, fixes = only(runs)
    errors = {name: error(fixes[name]) for name in (*VARIANTS, *METHODS)}
    rows = list(_curves(fixes))
    for name in VARIANTS:
        for other in METHODS:
            rows.append(_row("all", name, other, np.nan, errors[name], errors[other]))
    for r, f in filters(fixes).items():
        df = error(f)
        given = np.isfinite(df)
        others = {f"df {r:g}": df}
        others |= {m: thresholded(fixes[m], given.mean()) for m in SCORED}
        for name in VARIANTS:
            same = np.where(given, errors[name], np.nan)
            as_many = thresholded(fixes[name], given.mean())
            rows.append(_row("accepted", name, f"df {r:g}", r, same, df))
            rows += [_row("coverage", name, m, r, as_many, e) for m, e in others.items()]
    return pd.DataFrame(rows)


def _row(
    at: str, method: str, other: str, r: float, a: np.ndarray, b: np.ndarray
) -> dict[str, Any]:
    """A row of `robust` from the errors of both methods (R, T)."""
    found = columns(more=difference(a, b), within_1m=within(a))
    known = {"loss": VARIANTS[method], "other": other, "r_sigma": r}
    return {"at": at, "method": method, **known, **found, "coverage": np.isfinite(a).mean()}


def _curves(fixes: Mapping[str, Fixes]) -> Iterator[dict[str, Any]]:
    """Rows of `robust` with each method's share within 1 m by coverage."""
    for name in (*VARIANTS, *SCORED):
        for coverage in np.round(np.arange(0.1, 1.01, 0.05), 2):
            e = thresholded(fixes[name], coverage)
            yield {"at": "curve", "loss": VARIANTS.get(name, ""), **covered(name, e)}
    for r, f in filters(fixes).items():
        yield {"at": "curve", "loss": "", **covered("df boxes", error(f), r)}
