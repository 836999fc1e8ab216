"""The summary row of one estimator in one cell, with standard errors and intervals clustered by
position where replications share their positions.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from aoabench.columns import IDENTITY, SUMMARY
from aoabench.maths import intervals
from aoabench.maths.statistics import Array, Estimate, mean, pooled_rmse, quantile, rate
from aoabench.maths.tails import largest_share, usual_share
from aoabench.store.accuracy import Errors, accuracy
from aoabench.store.clusters import AXES, Clusters

if TYPE_CHECKING:
    import pandas as pd

    Columns = Mapping[str, np.ndarray] | pd.DataFrame  # of the replications table

QUANTILES = (0.05, 0.25, 0.50, 0.75, 0.95)


def summarise(
    rows: Columns,
    clusters: Clusters | None = None,
    reasons: pd.DataFrame | None = None,
    errors: Errors | None = None,
) -> dict[str, Any]:
    """One row of the summary table (columns.SUMMARY, without the cell) from the replications of one
    estimator in one cell; columns that nothing fills are NaN.

    `reasons` counts the fixes that are not ok (see store.folder.reasons); None where unknown. With
    `clusters`, standard errors and intervals of RMSE, and the standard error of iterations, are
    clustered by position (`se_by`); those of quantiles and of the failure rate, whose 95 % interval
    is Wilson's, are always over replications. `errors` of every fix fill the columns of `accuracy`.
    """
    n = len(rows["outcome"])
    bad = int(np.isin(np.asarray(rows["outcome"]), ["failed", "diverged"]).sum())
    result: dict[str, Any] = {name: math.nan for name in SUMMARY if name not in IDENTITY}
    result |= {"replications": n} | _means(rows, clusters) | _tail(rows, clusters)
    for q in QUANTILES:
        result |= _two(f"rmse_q{round(100 * q):02d}_3d_m", quantile(rows["rmse_3d_m"], q))
    low, high = intervals.quantile_interval(rows["rmse_3d_m"], 0.5)
    result |= {"rmse_q50_3d_m_low": max(low, 0.0), "rmse_q50_3d_m_high": high}
    result |= _two("failure_rate", rate(bad, n))
    result["failure_rate_low"], result["failure_rate_high"] = intervals.rate_interval(bad, n)
    result |= _two("nees_mean", mean(rows["nees"]))
    fixes = max(int(np.sum(rows["n_fixes"])), 1)
    for name in ("ok", "rejected", "oscillated", "diverged", "failed", "unmeasured", "imprecise"):
        result[f"share_{name}"] = float(np.sum(np.asarray(rows[f"n_{name}"])) / fixes)
    reason, count = (None, math.nan) if reasons is None else commonest(reasons)
    result |= {"reason": reason, "share_reason": count / fixes}
    result["se_by"] = "replication" if clusters is None else "position"
    return result | accuracy(errors, rows["n_ok"], rows["n_fixes"])


def commonest(reasons: pd.DataFrame) -> tuple[str, int]:
    """The commonest of some `reasons` with their counts `n`, and its count; ("", 0) without any. Of
    two that are equally common, the first in the alphabet.
    """
    if reasons.empty:
        return "", 0
    count = reasons.groupby("reason")["n"].sum()
    return str(count.idxmax()), int(count.max())


def commonest_of_each(reasons: pd.DataFrame) -> dict[int, str]:
    """The commonest of the `reasons` of one outcome by replication, as `commonest` chooses it."""
    order = reasons.sort_values(["replication", "n", "reason"], ascending=[True, False, True])
    first = order.drop_duplicates("replication")
    return dict(zip(first["replication"].tolist(), first["reason"].tolist()))


def _two(name: str, estimate: Estimate) -> dict[str, float]:
    return {name: estimate.value, f"{name}_se": estimate.se}


def means(rows: Columns, clusters: Clusters | None = None) -> dict[str, Estimate]:
    """Pooled and mean RMSE on each axis, and the mean iterations, by their columns of the summary,
    with their errors over replications, or clustered by position with `clusters`.
    """
    accepted = _accepted(rows)
    found = {"iterations_mean": mean(rows["iterations"])}
    for axis in AXES:
        rmse = rows[f"rmse_{axis}_m"]
        found[f"rmse_pooled_{axis}_m"] = pooled_rmse(rmse, accepted)
        found[f"rmse_mean_{axis}_m"] = mean(rmse)
    return found if clusters is None else clusters.estimates(found)


def _means(rows: Columns, clusters: Clusters | None) -> dict[str, float]:
    """The means with standard errors, and 95 % intervals of the RMSE."""
    result: dict[str, float] = {}
    for name, estimate in means(rows, clusters).items():
        result |= _two(name, estimate)
        if name.startswith("rmse"):
            low, high = estimate.interval()
            result |= {f"{name}_low": max(low, 0.0), f"{name}_high": high}
    return result


def _accepted(rows: Columns) -> Array:
    """Number of fixes (N,) with a position."""
    return np.asarray(rows["n_ok"] + rows["n_oscillated"] + rows["n_diverged"])


def _tail(rows: Columns, clusters: Clusters | None) -> dict[str, float | bool]:
    """The largest unit's share of the sum of squared 3-D errors, and whether it is too large."""
    squares = np.asarray(rows["rmse_3d_m"], dtype=float) ** 2 * _accepted(rows)
    if clusters is not None:
        squares = clusters.totals[0][clusters.fixes > 0]
    share, n = largest_share(squares), int(np.isfinite(squares).sum())
    return {"largest_share": share, "heavy_tail": share > usual_share(n)}
