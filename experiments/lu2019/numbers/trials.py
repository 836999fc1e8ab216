"""Figure 4, errata and consistency: statistics of the methods over many trials."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from aoabench.engine import metrics
from aoabench.maths import statistics

from .common import FILTERS, METHODS, cell_of, estimated

DIVERGED_M = 15.0  # 3-D RMSE beyond which a trial counts as diverged


def fig4(runs: pd.DataFrame) -> pd.DataFrame:
    """Per kind of error, uncertainty and method: RMSEs with and without diverged trials, paired
    against the centroid.

    Rows with sigma NaN hold the uncertainty at which a filter's curve crosses the centroid's,
    `crossing_m`, and its 95 % interval.
    """
    rows = []
    keys = ["noise.an_error", "noise.an_sigma_m"]
    for (kind, sigma), group in runs.groupby(keys):
        wide = {
            c: group.pivot(index="replication", columns="estimator", values=c)
            for c in ("rmse_3d_m", "rmse_z_m")
        }
        for name in METHODS:
            d3, dz = wide["rmse_3d_m"][name].to_numpy(), wide["rmse_z_m"][name].to_numpy()
            diverged = d3 > DIVERGED_M
            row = {"an_error": kind, "an_sigma_m": sigma, "estimator": name, "trials": len(d3)}
            for key, estimate in {
                "rmse_3d": statistics.pooled_rmse(d3),
                "rmse_z": statistics.pooled_rmse(dz),
                "kept_3d": statistics.pooled_rmse(d3[~diverged]),
                "kept_z": statistics.pooled_rmse(dz[~diverged]),
                "diverged": statistics.rate(int(diverged.sum()), len(d3)),
                "median_3d": statistics.quantile(d3, 0.5),
                "median_z": statistics.quantile(dz, 0.5),
                "above_wcg": statistics.paired(d3, wide["rmse_3d_m"]["wcg"]).percent,
                "above_wcg_z": statistics.paired(dz, wide["rmse_z_m"]["wcg"]).percent,
            }.items():
                row |= estimate.columns(key)
            rows.append(row)
    for kind, group in runs.groupby("noise.an_error"):
        for name in METHODS[:2]:
            rows.append({"an_error": kind, "estimator": name, **crossing(group, name)})
    return pd.DataFrame(rows)


def crossing(runs: pd.DataFrame, name: str, resamplings: int = 1000) -> dict[str, float]:
    """Smallest uncertainty at which the filter's median RMSE reaches the centroid's, by linear
    interpolation.

    The interval is a bootstrap over whole trials, which have the same draws at every uncertainty.
    Infinite if the curve does not cross within the range.
    """
    wide = runs.pivot(
        index="replication", columns=["estimator", "noise.an_sigma_m"], values="rmse_3d_m"
    )
    a, b = wide[name], wide["wcg"]
    sigma = np.sort(a.columns.to_numpy(dtype=float))
    difference = (a[sigma].to_numpy(), b[sigma].to_numpy())
    rng = np.random.default_rng(2019)
    each = []
    for pick in [np.arange(len(wide)), *rng.integers(len(wide), size=(resamplings, len(wide)))]:
        d = np.median(difference[0][pick], axis=0) - np.median(difference[1][pick], axis=0)
        above = np.flatnonzero(d >= 0)
        i = above[0] if len(above) else 0
        each.append(
            sigma[i - 1] - d[i - 1] * (sigma[i] - sigma[i - 1]) / (d[i] - d[i - 1])
            if i > 0
            else np.inf
        )
    low, high = np.quantile(each[1:], [0.025, 0.975], method="nearest")
    return {"crossing_m": each[0], "crossing_low_m": low, "crossing_high_m": high}


def errata(runs: pd.DataFrame) -> pd.DataFrame:
    """Per uncertainty, method and erratum as printed: pooled and median RMSE of the trials, rate of
    divergence.
    """
    found: dict[tuple[float, str, str], np.ndarray] = {}
    for _, group in runs.groupby("cell"):
        first = group.iloc[0]
        gain = first.get("noise.as_printed", "[]") == '["gain"]'
        flags = first["filter.ekf_toa_aoa.as_printed"].strip('[]"')
        if gain and flags:
            continue  # one erratum at a time
        for name, rows in group.groupby("estimator"):
            if name.startswith("wcg") and flags:
                continue
            variant = "gain" if gain else flags or "meant"
            if name == "wcg_as_printed":
                name, variant = "wcg", "alpha" if not gain else "both"
            values = rows.set_index("replication")["rmse_3d_m"].sort_index().to_numpy()
            found[float(first["noise.an_sigma_m"]), name, variant] = values
    rows = []
    for (sigma, name, variant), rmse in found.items():
        if variant == "both":
            continue
        row = {"an_sigma_m": sigma, "estimator": name, "variant": variant, "trials": len(rmse)}
        row |= statistics.pooled_rmse(rmse).columns("rmse_m", "rmse_se")
        row |= statistics.quantile(rmse, 0.5).columns("median_m", "median_se")
        row |= statistics.rate(int((rmse > DIVERGED_M).sum()), len(rmse)).columns("diverged")
        rows.append(row)
    return pd.DataFrame(rows).sort_values(["an_sigma_m", "estimator", "variant"], ignore_index=True)


def nees(scale: str) -> pd.DataFrame:
    """Mean over trials of the position's NEES at each time, on the route and with the truth from
    the filter's model.
    """
    trials = {"quick": 16, "paper": 400}[scale]
    rows = []
    for scenario in ("indoor_map", "indoor_map_model"):
        for sigma in (0.0, 0.5, 5.0):
            cell = cell_of(f"noise.an_sigma_m={sigma}", scenario=scenario, methods=(FILTERS,))
            total: dict[str, Any] = dict.fromkeys(cell.estimators, 0.0)
            for name, truth, found in estimated(cell, trials):
                assert found.covariance is not None
                error = found.position - truth[..., :3]
                total[name] = total[name] + metrics.nees(error, found.covariance).sum(0)
            for name, value in total.items():
                each = 5 if scenario == "indoor_map" else 1
                rows += [
                    (scenario, sigma, name, k * cell.scenario.dt, v / trials, trials)
                    for k, v in list(enumerate(value, 1))[::each]
                ]
    return pd.DataFrame(
        rows, columns=["scenario", "an_sigma_m", "estimator", "time_s", "nees", "trials"]
    )
