"""The summary row of one estimator in one cell, with standard errors and intervals clustered by
position where replications share their positions.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from aoabench.columns import IDENTITY, SUMMARY
from aoabench.maths import intervals
from aoabench.maths.statistics import Array, Estimate, mean, pooled_rmse, quantile, rate, ratio

if TYPE_CHECKING:
    import pandas as pd

    Columns = Mapping[str, np.ndarray] | pd.DataFrame  # of the replications table

CLUSTERED = ("rmse_3d_m", "rmse_xy_m", "rmse_z_m", "iterations")  # metrics of Clusters.influence


QUANTILES = (0.05, 0.25, 0.50, 0.75, 0.95)


@dataclass(frozen=True)
class Clusters:
    """Sums over replications for each of P true positions that all replications share; every array
    (P,).

    replications: number of replications summed; fixes: number of accepted fixes; square_3d,
    square_xy: sums of their squared errors, m^2; iterations: sum of their iterations; influence_3d,
    influence_xy, influence_z: sums of the influence of the position on the replication's RMSE, m.
    With n accepted fixes and mean square error s^2 in a replication, an accepted fix with error e
    has the influence (e^2 - s^2) / (2 s n), its share of the RMSE's change to first order.
    """

    replications: int
    fixes: Array
    square_3d: Array
    square_xy: Array
    iterations: Array
    influence_3d: Array
    influence_xy: Array
    influence_z: Array

    def __add__(self, other: Clusters) -> Clusters:
        return Clusters(*(getattr(self, f.name) + getattr(other, f.name) for f in fields(self)))

    def grouped(self, place: np.ndarray) -> Clusters:
        """The sums over all positions that have the same number, from 0, in `place` (P,)."""
        sums = (
            np.bincount(place, getattr(self, f.name))
            for f in fields(self)
            if f.name != "replications"
        )
        return Clusters(self.replications, *sums)

    def influence(self, metric: str) -> Array | None:
        """Return the influence (P,) of each position on the mean over replications of `metric`, a
        column of the replications table; None for a metric that is not clustered.

        The influence is P times the first-order contribution of the position to the deviation of
        that mean, and sums to 0. The standard error of the mean of these P numbers is the metric's
        standard error, clustered by position.
        """
        if metric == "iterations":
            n = np.maximum(self.fixes, 1e-300)  # without any fix: no warning about a division by 0
            return np.asarray((self.iterations - n * self.iterations.sum() / n.sum()) / n.mean())
        axis = {"rmse_3d_m": "3d", "rmse_xy_m": "xy", "rmse_z_m": "z"}.get(metric)
        return (
            None
            if axis is None
            else len(self.fixes) * getattr(self, f"influence_{axis}") / self.replications
        )

    def standard_errors(self) -> dict[str, float]:
        """Standard errors clustered by position, by the names of the summary columns that they
        belong to.

        Positions are assumed to be drawn independently; all fixes of one position may depend on
        each other.
        """
        n = np.where(self.fixes > 0, self.fixes, np.nan)
        squares = {
            "3d": self.square_3d,
            "xy": self.square_xy,
            "z": np.maximum(self.square_3d - self.square_xy, 0.0),
        }
        found = {}
        for axis, square in squares.items():
            found[f"rmse_pooled_{axis}_m"] = pooled_rmse(np.sqrt(square / n), self.fixes).se
            found[f"rmse_mean_{axis}_m"] = mean(cast(Array, self.influence(f"rmse_{axis}_m"))).se
        found["iterations_mean"] = ratio(self.iterations, self.fixes).se
        return found


def position_sums(
    error_3d: Array, error_xy: Array, iterations: Array, accepted: np.ndarray
) -> Clusters:
    """Sums per position from errors in m, iterations and whether a fix is accepted, each (R, P)."""
    a, n = accepted.astype(float), np.maximum(accepted.sum(axis=1), 1)[:, None]
    square = {"3d": np.where(accepted, error_3d, 0.0).astype(float) ** 2}
    square["xy"] = np.where(accepted, error_xy, 0.0).astype(float) ** 2
    square["z"] = np.maximum(square["3d"] - square["xy"], 0.0)
    influence = {}
    for axis, s in square.items():
        ms = s.sum(axis=1, keepdims=True) / n
        influence[axis] = (a * (s - ms) / (2 * np.sqrt(np.where(ms > 0, ms, np.inf)) * n)).sum(
            axis=0
        )
    counted = np.where(accepted, iterations, 0.0).sum(axis=0)
    sums = a.sum(axis=0), square["3d"].sum(axis=0), square["xy"].sum(axis=0), counted
    return Clusters(len(a), *sums, influence["3d"], influence["xy"], influence["z"])


def summarise(
    rows: Columns, clusters: Clusters | None = None, reasons: pd.DataFrame | None = None
) -> dict[str, Any]:
    """One row of the summary table (columns.SUMMARY, without the cell) from the replications of one
    estimator in one cell; columns that nothing fills are NaN.

    `reasons` counts the fixes that are not ok (see store.folder.reasons); None where unknown. With
    `clusters`, standard errors and intervals of RMSE, and the standard error of iterations, are
    clustered by position (`se_by`); those of quantiles and of the failure rate, whose 95 % interval
    is Wilson's, are always over replications.
    """
    n = len(rows["outcome"])
    bad = int(np.isin(np.asarray(rows["outcome"]), ["failed", "diverged"]).sum())
    result: dict[str, Any] = {name: math.nan for name in SUMMARY if name not in IDENTITY}
    result |= {"replications": n} | _rmse(rows)

    def put(name: str, estimate: Estimate) -> None:
        result[name], result[f"{name}_se"] = estimate.value, estimate.se

    for q in QUANTILES:
        put(f"rmse_q{round(100 * q):02d}_3d_m", quantile(rows["rmse_3d_m"], q))
    put("failure_rate", rate(bad, n))
    result["failure_rate_low"], result["failure_rate_high"] = intervals.rate_interval(bad, n)
    put("nees_mean", mean(rows["nees"]))
    put("iterations_mean", mean(rows["iterations"]))
    fixes = max(int(np.sum(rows["n_fixes"])), 1)
    for name in ("ok", "rejected", "oscillated", "diverged", "failed", "unmeasured", "imprecise"):
        result[f"share_{name}"] = float(np.sum(np.asarray(rows[f"n_{name}"])) / fixes)
    reason, count = (None, math.nan) if reasons is None else commonest(reasons)
    result |= {"reason": reason, "share_reason": count / fixes}
    result["se_by"] = "replication" if clusters is None else "position"
    if clusters is not None:
        result |= _clustered(result, clusters)
    return result


def commonest(reasons: pd.DataFrame) -> tuple[str, int]:
    """The commonest of some `reasons` with their counts `n`, and its count; ("", 0) without any. Of
    two that are equally common, the first in the alphabet.
    """
    if reasons.empty:
        return "", 0
    count = reasons.groupby("reason")["n"].sum()
    return str(count.idxmax()), int(count.max())


def _rmse(rows: Columns) -> dict[str, float]:
    """Pooled and mean RMSE with standard errors and 95 % intervals over replications."""
    accepted = rows["n_ok"] + rows["n_oscillated"] + rows["n_diverged"]
    result: dict[str, float] = {}
    for axis in ("3d", "xy", "z"):
        rmse = rows[f"rmse_{axis}_m"]
        for name, found, ends in (
            ("pooled", pooled_rmse(rmse, accepted), intervals.rmse_interval(rmse, accepted)),
            ("mean", mean(rmse), intervals.mean_interval(rmse)),
        ):
            result |= found.columns(f"rmse_{name}_{axis}_m")
            result |= dict(zip((f"rmse_{name}_{axis}_m_low", f"rmse_{name}_{axis}_m_high"), ends))
    return result


def _clustered(result: dict[str, Any], clusters: Clusters) -> dict[str, float]:
    """Standard errors and, of RMSE, Student's intervals clustered by position; NaN for NaN."""
    found = {}
    for name, se in clusters.standard_errors().items():
        estimate = Estimate(result[name], se)
        found[f"{name}_se"] = estimate.se
        if name.startswith("rmse"):
            half = intervals.student_quantile(len(clusters.fixes) - 1) * estimate.se
            found[f"{name}_low"] = max(estimate.value - half, 0.0)
            found[f"{name}_high"] = estimate.value + half
    return found
