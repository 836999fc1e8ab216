"""Figures 5 to 8: the discrepancy filter and all methods in the synthetic campaign."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from aoabench.maths import statistics
from aoabench.maths.estimate import Estimate
from aoabench.store.fixes import Fixes

from .common import (
    ERRORS,
    METHODS,
    Runs,
    columns,
    difference,
    discarded,
    error,
    filters,
    lost,
    medians,
    only,
    printed_grids,
    rejected,
    unused,
    within,
)
from .resampled import Resampled, measures

UNNAMED = ("ls_anchor_discarding", "rssi_anchor")  # the printed panel without a name is of one


def curve(name: str, e: np.ndarray, **more: Any) -> list[dict[str, Any]]:
    """Rows of the distribution function of the given errors (R, T), with standard errors over
    campaigns.
    """
    n = np.isfinite(e).sum(axis=1)
    shares = [statistics.ratio((e <= limit).sum(axis=1), n) for limit in ERRORS]
    return [
        {"method": name, "error_m": limit, **columns(cdf=p), "fixes": int(n.sum()), **more}
        for limit, p in zip(ERRORS, shares)
    ]


def fig5(runs: Runs) -> pd.DataFrame:
    """CDFs of the discrepancy filter for each R_sigma, and with its second stage left out (R_sigma
    NaN).
    """
    _, fixes = only(runs)
    rows = []
    for r, f in filters(fixes).items():
        rows += curve(f"df {r:g}", error(f), r_sigma=r, lost=lost(f).value)
    return pd.DataFrame(
        rows + curve("no vote", error(fixes["df_without_vote"]), r_sigma=np.nan, lost=0.0)
    )


FIRST = 0.2  # R_sigma from which the rise of RMSE and CEP90 is counted
EARLY = (0.6, 0.8)  # R_sigmas between which the fall of R_d is compared with other falls


RISING = ("rmse_m", "cep90_m")  # of which the paper says that they rise with R_sigma


def fig6(runs: Runs) -> pd.DataFrame:
    """Measures of the errors, P(error <= 1 m) and both discard ratios against R_sigma.

    NAME_more is a number minus that of the next smaller R_sigma, NAME_less the opposite, NAME_rise
    the number minus that of R_sigma FIRST. NAME_slower is the fall of a discard ratio over EARLY
    minus that over the last 0.2. All are paired over campaigns.
    """
    _, fixes = only(runs)
    found = filters(fixes)
    errors = {r: error(found[r]) for r in sorted(found)}
    counts = {
        "lost": {r: rejected(f) for r, f in found.items()},
        "discarded": {r: unused(f, fixes["df_without_vote"]) for r, f in found.items()},
    }
    of = {r: measures(e) for r, e in errors.items()}
    rows: list[dict[str, Any]] = []
    before = None
    for r, e in errors.items():
        row = {"r_sigma": r, "fixes": int(np.isfinite(e).sum()), "campaigns": len(e)}
        row |= columns(within_1m=within(e), lost=lost(found[r]))
        row |= columns(discarded=discarded(found[r], fixes["df_without_vote"]))
        row |= columns(**{name: number.estimate for name, number in of[r].items()})
        if r > FIRST:
            row |= columns(**_rise("rise", of[FIRST], of[r]))
        if before is not None:
            row |= columns(**_rise("more", of[before], of[r]))
            row |= columns(within_1m_more=difference(e, errors[before]))
            row |= columns(**{f"{name}_less": _fall(c, before, r) for name, c in counts.items()})
        if round(r - 0.2, 1) in errors:
            row |= columns(**{f"{name}_slower": _slower(c, r) for name, c in counts.items()})
        rows.append(row)
        before = r
    return pd.DataFrame(rows)


def _rise(suffix: str, a: dict[str, Resampled], b: dict[str, Resampled]) -> dict[str, Estimate]:
    """The measures RISING of b minus those of a, paired over campaigns."""
    return {f"{name}_{suffix}": (b[name] - a[name]).estimate for name in RISING}


Counts = dict[float, tuple[np.ndarray, np.ndarray]]  # by R_sigma: those discarded, and all


def _fall(counts: Counts, a: float, b: float) -> Estimate:
    """How far a discard ratio falls from the R_sigma a to b."""
    return statistics.ratio_difference(*counts[a], *counts[b])


def _slower(counts: Counts, r: float) -> Estimate:
    """The fall of a discard ratio over EARLY minus that over the 0.2 before r."""
    first, second = EARLY
    third = round(r - 0.2, 1)
    numbers = [counts[at][0] for at in (first, second, third, r)]
    return statistics.ratio(numbers[0] - numbers[1] - numbers[2] + numbers[3], counts[r][1])


def at_lost(fixes: Mapping[str, Fixes], share: float) -> tuple[float, Fixes]:
    """The discrepancy filter whose R_d is nearest to a share, and its R_sigma."""
    found = filters(fixes)
    r = min(found, key=lambda r: abs(lost(found[r]).value - share))
    return r, found[r]


def fig7(runs: Runs) -> pd.DataFrame:
    """CDFs of all methods, of the discrepancy filter in three readings, and of each other method on
    the fixes that each reading accepts.
    """
    _, fixes = only(runs)
    df = {"df R_sigma = 1": filters(fixes)[1.0], "df R_sigma = 0.2": filters(fixes)[0.2]}
    r, f = at_lost(fixes, 0.2)
    df[f"df R_d = 0.2 (R_sigma = {r:g})"] = f
    rows = []
    for name, f in (*((m, fixes[m]) for m in METHODS), *df.items()):
        e = error(f)
        rows += curve(name, e, on="own fixes")
        if name not in df:
            for other, g in df.items():
                rows += curve(name, np.where(np.isfinite(error(g)), e, np.nan), on=other)
    return pd.DataFrame(rows)


def fig8(runs: Runs) -> pd.DataFrame:
    """Per method and point: the median error as a mean over campaigns, its standard error and its
    spread from campaign to campaign (5 and 95 %), the printed one, and the median error minus that
    of A_1 (`more`, paired over campaigns)."""
    cell, fixes = only(runs)
    points = np.array(cell.scenario.points_m)
    printed = printed_grids()
    shown = {m: fixes[m] for m in METHODS} | {"discrepancy": filters(fixes)[1.0]}
    of_a1 = medians(error(fixes["single_anchor_1"]), len(points))
    rows = []
    for name, f in shown.items():
        m = medians(error(f), len(points))
        unnamed = name in UNNAMED
        for i, (x, y) in enumerate(points):
            each = m[:, i][np.isfinite(m[:, i])]
            mean = statistics.mean(each).columns("median_m", "median_se")
            low, high = np.quantile(each, [0.05, 0.95]) if len(each) else (np.nan, np.nan)
            row = {"method": name, "x_m": x, "y_m": y, **mean, "low_m": low, "high_m": high}
            row |= columns(more_m=statistics.mean(m[:, i] - of_a1[:, i]))
            row |= {"printed_m": printed[name][i] if name in printed else np.nan}
            row |= {"unnamed_m": printed["unnamed"][i] if unnamed else np.nan}
            rows.append(row)
    return pd.DataFrame(rows)
