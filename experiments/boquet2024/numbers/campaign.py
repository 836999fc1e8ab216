"""Figures 5 to 8: the discrepancy filter and all methods in the synthetic campaign."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from aoabench.maths import statistics
from aoabench.store.fixes import Fixes
from aoabench.types import Outcome

from .common import (
    ERRORS,
    METHODS,
    Runs,
    columns,
    discarded,
    error,
    filters,
    lost,
    medians,
    only,
    printed_grids,
    rms,
    within,
)


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


def fig6(runs: Runs) -> pd.DataFrame:
    """RMSE, CEP90, P(error <= 1 m) and both discard ratios against R_sigma.

    `lost_less` is the decrease of R_d from the next smaller R_sigma.
    """
    _, fixes = only(runs)
    found, rows, before = filters(fixes), [], None
    for r in sorted(found):
        f = found[r]
        e, rejected = error(f), (f.outcome == Outcome.REJECTED).astype(float)
        row = {"r_sigma": r, "fixes": int(np.isfinite(e).sum()), "campaigns": len(e)}
        row |= columns(
            rmse_m=statistics.jackknife(e, rms),
            cep90_m=statistics.jackknife(e, lambda e: float(np.nanquantile(e, 0.9))),
            within_1m=within(e),
            lost=lost(f),
            discarded=discarded(f, fixes["df_without_vote"]),
        )
        if before is not None:  # paired: the same packets
            row |= columns(lost_less=statistics.mean(np.mean(before - rejected, axis=1)))
        rows.append(row)
        before = rejected
    return pd.DataFrame(rows)


def at_lost(fixes: dict[str, Fixes], share: float) -> tuple[float, Fixes]:
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
    spread from campaign to campaign (5 and 95 %), and the printed one."""
    cell, fixes = only(runs)
    points = np.array(cell.scenario.points_m)
    printed = printed_grids()
    shown = {m: fixes[m] for m in METHODS} | {"discrepancy": filters(fixes)[1.0]}
    rows = []
    for name, f in shown.items():
        m = medians(error(f), len(points))
        unnamed = name in (
            "ls_anchor_discarding",
            "rssi_anchor",
        )  # the paper's unnamed panel shows one of them
        for i, (x, y) in enumerate(points):
            each = m[:, i][np.isfinite(m[:, i])]
            mean = statistics.mean(each).columns("median_m", "median_se")
            low, high = np.quantile(each, [0.05, 0.95]) if len(each) else (np.nan, np.nan)
            row = {"method": name, "x_m": x, "y_m": y, **mean, "low_m": low, "high_m": high}
            row |= {"printed_m": printed[name][i] if name in printed else np.nan}
            row |= {"unnamed_m": printed["unnamed"][i] if unnamed else np.nan}
            rows.append(row)
    return pd.DataFrame(rows)
