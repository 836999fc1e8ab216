"""Our numbers by their ids, from the items' tables."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from aoabench.maths.estimate import Estimate, combined, stored

Values = dict[str, Estimate]
THRESHOLD_M = 0.5  # the uncertainty beyond which the paper prefers the centroid


def table1_values(frame: pd.DataFrame) -> Values:
    """The preset's values."""
    return {f"table1/{r['quantity']}": Estimate(r["value"], 0.0) for r in frame.to_dict("records")}


def fig2_values(frame: pd.DataFrame) -> Values:
    """Properties of our map for which the paper prints numbers of its map."""
    walls, an = frame[frame["kind"] == "wall"], frame[frame["kind"] == "access node"]
    route = frame[frame["kind"] == "route"]
    x, y = (np.concatenate([walls[f"{c}_m"], walls[f"{c}1_m"]]) for c in "xy")
    step = np.linalg.norm(np.diff(route[["x_m", "y_m"]], axis=0), axis=1) / frame["step_s"].iloc[0]
    found = {
        "length_m": float(np.ptp(x)),
        "width_m": float(np.ptp(y)),
        "an_height_m": float(an["z_m"].mean()),
        "speed_m_s": float(np.median(step)),
        "z_start_m": float(route["z_m"].iloc[0]),
        "z_end_m": float(route["z_m"].iloc[-1]),
        "least_line_of_sight": float(route["line_of_sight"].min()),
        "per_25_m2": 25 * len(an) / float(frame["area_m2"].iloc[0]),
    }
    return {f"fig2/{name}": Estimate(value, 0.0) for name, value in found.items()}


def fig3_values(frame: pd.DataFrame) -> dict[str, tuple[Estimate, float]]:
    """Shares of the errors within the printed limits, thermal errors and ratios of deviations, each
    with its trials. The ids of settings other than the chosen one contain the setting.
    """
    found = {}
    for r in frame[frame["kind"] != "cdf"].to_dict("records"):
        setting = "" if r["setting"] == "chosen" else f"{r['setting']}/"
        found[f"fig3/{setting}{r['name']}"] = (stored(r, "value", "se"), float(r["trials"]))
    return found


# --- Figure 4 -------------------------------------------------------------------------------------


def fig4_values(frame: pd.DataFrame) -> dict[str, tuple[Estimate, float]]:
    """Per kind of error, uncertainty and method: errors in space (3d) and height (z), the rate of
    divergence, and the uncertainties at which the methods cross; each with its trials.

    The errors are the RMSE of all trials (rmse), the RMSE of those that do not diverge (kept) and
    the median of the trials' RMSEs (median, for the parts that the table has). Of the latter two
    there are the excess over the centroid (`above_wcg`, percent) and, beyond THRESHOLD_M, the
    growth from there on (`slope`, m per m) and its excess over the centroid's (`steeper`).
    """
    by_row = frame.dropna(subset=["an_sigma_m"]).to_dict("records")
    rows = {(r["an_error"], r["an_sigma_m"], r["estimator"]): r for r in by_row}
    found: dict[str, tuple[Estimate, float]] = {}
    for (kind, sigma, name), row in rows.items():
        key, trials = f"fig4/{kind}/{sigma:g}/{name}", float(row["trials"])
        centroid = rows[kind, sigma, "wcg"]
        start = tuple(rows.get((kind, THRESHOLD_M, n)) for n in (name, "wcg"))
        numbers = _of_all_trials(row) | _against_centroid(row, centroid)
        if sigma > THRESHOLD_M and None not in start:
            numbers |= _growth(row, centroid, *start)
        found |= {f"{key}/{number}": (estimate, trials) for number, estimate in numbers.items()}
    crossings = frame[frame["an_sigma_m"].isna()].to_dict("records")
    range_m = float(frame["an_sigma_m"].max())
    return found | {k: v for r in crossings for k, v in _crossing(r, range_m).items()}


def _measures(row: Mapping[str, Any]) -> list[str]:
    """The errors that have a variance and that the row has."""
    return [
        f"{m}_{part}" for part in ("3d", "z") for m in ("median", "kept") if f"{m}_{part}" in row
    ]


def _of_all_trials(row: Mapping[str, Any]) -> Values:
    """Errors, divergence, and the excess of the mean over that of the centroid."""
    found = {f"rmse_{part}": stored(row, f"rmse_{part}") for part in ("3d", "z")}
    found |= {measure: stored(row, measure) for measure in _measures(row)}
    found["diverged"] = stored(row, "diverged").percent()
    if row["estimator"] != "wcg":
        found["mean_3d/above_wcg"] = stored(row, "above_wcg")
        found["mean_z/above_wcg"] = stored(row, "above_wcg_z")
    return found


def _against_centroid(row: Mapping[str, Any], centroid: Mapping[str, Any]) -> Values:
    """Excess of a filter's errors over the centroid's in percent, by the delta method as if both
    were independent: too wide, as they share their draws.
    """
    if row["estimator"] == "wcg":
        return {}
    found = {}
    for measure in _measures(row):
        a, b = stored(row, measure), stored(centroid, measure)
        ratio = a.value / b.value
        parts = (a * (100 / b.value), b * (-100 * ratio / b.value))
        found[f"{measure}/above_wcg"] = combined(100 * (ratio - 1), *parts)
    return found


def _growth(
    row: Mapping[str, Any],
    centroid: Mapping[str, Any],
    start: Mapping[str, Any],
    centroid_start: Mapping[str, Any],
) -> Values:
    """Growth of a method's errors per metre of uncertainty since THRESHOLD_M, and its excess over
    the centroid's; standard errors as if all were independent.
    """
    per_m = 1 / (row["an_sigma_m"] - THRESHOLD_M)
    found = {}
    for measure in _measures(row):
        slope = per_m * (stored(row, measure) - stored(start, measure))
        found[f"{measure}/slope"] = slope
        if row["estimator"] != "wcg":
            other = per_m * (stored(centroid, measure) - stored(centroid_start, measure))
            found[f"{measure}/steeper"] = slope - other
    return found


def _crossing(row: Mapping[str, Any], range_m: float) -> dict[str, tuple[Estimate, float]]:
    """Where a filter's median error reaches the centroid's; if it does not, the end of the range
    under an id that says `beyond`. An interval that has no end within the range has no standard
    error.
    """
    key = f"fig4/{row['an_error']}/crossing/{row['estimator']}"
    low, high = row["crossing_low_m"], row["crossing_high_m"]
    if np.isinf(low):
        return {f"{key}/beyond": (Estimate(range_m, 0.0), math.nan)}
    se = 0.5 * (high - low) / 1.96 if np.isfinite(high) else math.nan
    return {key: (Estimate(row["crossing_m"], se), math.nan)}


# --- Table II, errata, consistency ----------------------------------------------------------------


def table2_values(frame: pd.DataFrame) -> Values:
    """Counts (exact) and times (measured once: no standard error)."""
    found = {}
    for r in frame.to_dict("records"):
        for name in ("printed_formula", "textbook", "ours"):
            if r[name] == r[name]:
                found[f"table2/{r['estimator']}/{name}"] = Estimate(r[name], 0.0)
        found[f"table2/{r['estimator']}/time"] = Estimate(r["microseconds_per_step"], math.nan)
    return found


def operations_values(frame: pd.DataFrame) -> Values:
    """By method and form: the factor by which the operations grow as M or n doubles, at the largest
    of the table; those of a filter over the centroid's; and what one access node more costs the
    centroid.
    """
    count = {
        (r["estimator"], r["form"], r["M"], r["n"]): r["operations"]
        for r in frame.to_dict("records")
    }
    found: dict[str, float] = {}
    for (name, form, M, n), value in count.items():
        key = f"operations/{name}/{form}"
        if (name, form, M // 2, n) in count and frame["M"].max() == M:
            found[f"{key}/twice_M"] = value / count[name, form, M // 2, n]
        if (name, form, M, n // 2) in count and frame["n"].max() == n:
            found[f"{key}/twice_n"] = value / count[name, form, M, n // 2]
        if name != "wcg" and frame["n"].min() == n and M <= 16:
            found[f"{key}/over_wcg/{M}"] = value / count["wcg", form, M, n]
        if name == "wcg" and M == 1:
            found[f"{key}/per_node"] = float(count[name, form, 2, n] - value)
    return {key: Estimate(value, 0.0) for key, value in found.items()}


def errata_values(frame: pd.DataFrame) -> Values:
    """Median RMSE of the trials, and the share that diverges in percent."""
    found = {}
    for r in frame.to_dict("records"):
        key = f"errata/{r['variant']}/{r['an_sigma_m']:g}/{r['estimator']}"
        found[f"{key}/median"] = stored(r, "median_m", "median_se")
        found[f"{key}/diverged"] = stored(r, "diverged").percent()
    return found


def consistent(trials: int) -> tuple[float, float]:
    """The 95 % band of the mean over trials of a consistent filter's NEES (3 dof)."""
    from scipy.stats import chi2

    low, high = chi2.ppf([0.025, 0.975], 3 * trials) / trials
    return float(low), float(high)


def nees_values(frame: pd.DataFrame, transient_s: float = 10.0) -> Values:
    """Share in percent of the times after the transient at which the mean NEES lies in its 95 %
    band; no standard error, as the times of a trial are dependent.
    """
    found = {}
    for (scenario, sigma, name), rows in frame.groupby(["scenario", "an_sigma_m", "estimator"]):
        low, high = consistent(int(rows["trials"].iloc[0]))
        late = rows[rows["time_s"] > transient_s]["nees"]
        share = 100 * float(((late >= low) & (late <= high)).mean())
        found[f"nees/{scenario}/{sigma:g}/{name}"] = Estimate(share, math.nan)
    return found
