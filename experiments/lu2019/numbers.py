"""Lu et al. 2019: the numbers behind each table and figure, one function per item, each giving one
frame.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from aoabench import metrics, statistics
from aoabench.composing import compose_cells
from aoabench.geometry import LIGHT
from aoabench.montecarlo import Draws, estimate_tile, time_estimators

METHODS = ("ekf_toa_aoa", "ekf_aoa", "wcg")
DIVERGED_M = 15.0  # 3-D RMSE beyond which a trial counts as diverged
FILTERS = "filter=[ekf_toa_aoa,ekf_aoa]"


def _cell(
    *words: str,
    scenario: str = "indoor_map",
    methods: tuple[str, ...] = (FILTERS, "estimator=[wcg]"),
) -> Any:
    return compose_cells([f"scenario={scenario}", "noise=ofdm_crlb", *methods, *words])[0]


# --- Table I, Figures 2 and 3 ---------------------------------------------------------------------


def table1(scale: str) -> pd.DataFrame:
    """Pilot parameters as the preset has them; the bandwidth follows from two of them."""
    noise = _cell().noise
    rows = [
        ("carrier_ghz", noise.carrier_ghz), ("subcarrier_khz", noise.subcarrier_khz),
        ("subcarriers", noise.subcarriers),
        ("bandwidth_mhz", 1e-3 * noise.subcarrier_khz * noise.subcarriers), ("power_dbm", noise.power_dbm),
        ("array_gain_db", noise.array_gain_db),
    ]  # fmt: skip
    return pd.DataFrame(
        [(name, float(value)) for name, value in rows], columns=["quantity", "value"]
    )


def fig2(scale: str) -> pd.DataFrame:
    """Walls (x_m, y_m to x1_m, y1_m), access nodes (facing x1_m, y1_m) and the route's points, with
    what they see.
    """
    scenario = _cell().scenario
    anchors, route = scenario.known_anchors, scenario.truth(np.random.default_rng(0))[:, :3]
    sees = scenario.line_of_sight(route).sum(axis=1)
    rows: list[tuple[Any, ...]] = [("wall", *a, np.nan, *b, np.nan) for a, b in scenario.segments]
    facing = anchors.rotation[0, :, 0, :2]
    rows += [("access node", *s, *f, np.nan) for s, f in zip(anchors.position[0], facing)]
    rows += [("route", *p, np.nan, np.nan, n) for p, n in zip(route, sees)]
    frame = pd.DataFrame(
        rows, columns=["kind", "x_m", "y_m", "z_m", "x1_m", "y1_m", "line_of_sight"]
    )
    return frame.assign(area_m2=scenario.visited_area_m2, step_s=scenario.dt)


def fig3(scale: str) -> pd.DataFrame:
    """Distribution functions of the errors, and shares with standard errors over trials (kind
    `share`).
    """
    cell, trials = _cell(), {"quick": 8, "paper": 200}[scale]
    draws, found = Draws(cell.scenario, cell.noise, cell.seed), []
    for first in range(0, trials, 8):
        truth, batch = draws.tile(first, 8)
        assert batch.delay is not None
        offset = truth[:, :, None, :3] - cell.scenario.known_anchors.position
        local = (cell.scenario.known_anchors.rotation[0] @ offset[..., None])[..., 0]
        d = np.linalg.norm(local, axis=-1)
        for r in range(len(truth)):
            seen = np.isfinite(batch.azimuth[r])
            exact = (
                np.arctan2(local[r, ..., 1], local[r, ..., 0]),
                np.arcsin(local[r, ..., 2] / d[r]),
            )
            error = {
                "toa_m": LIGHT * batch.delay[r] - d[r],
                "azimuth_deg": np.rad2deg(batch.azimuth[r] - exact[0]),
                "elevation_deg": np.rad2deg(batch.elevation[r] - exact[1]),
                "thermal_cm": 100 * LIGHT * cell.noise.delay_sigma(batch.rssi[r]),  # type: ignore[index]
            }
            found.append({name: value[seen] for name, value in error.items()})
    rows = []
    grids = {"toa_m": np.linspace(-12, 12, 97), "azimuth_deg": np.linspace(-1, 1, 81)}
    grids |= {"elevation_deg": grids["azimuth_deg"], "thermal_cm": np.geomspace(1e-3, 10, 81)}
    for name, grid in grids.items():
        cdf = np.mean(
            [np.searchsorted(np.sort(f[name]), grid) / len(f[name]) for f in found], axis=0
        )
        rows += [("cdf", name, x, p, np.nan, trials) for x, p in zip(grid, cdf)]
    inside = {
        "angles_within_half_degree": [
            np.mean(np.abs(np.concatenate([f["azimuth_deg"], f["elevation_deg"]])) <= 0.5)
            for f in found
        ],
        "toa_within_10_m": [np.mean(np.abs(f["toa_m"]) <= 10.0) for f in found],
        "thermal_within_printed": [
            np.mean((f["thermal_cm"] >= 0.1) & (f["thermal_cm"] <= 8.0)) for f in found
        ],
    }
    for name, values in inside.items():
        share = statistics.mean(values)
        rows.append(("share", name, np.nan, 100 * share.value, 100 * share.se, trials))
    ratio = statistics.mean(
        [np.sqrt(np.mean(f["toa_m"] ** 2)) / (1e-2 * np.median(f["thermal_cm"])) for f in found]
    )
    rows.append(("ratio", "all_over_thermal", np.nan, ratio.value, ratio.se, trials))
    return pd.DataFrame(rows, columns=["kind", "name", "x", "value", "se", "trials"])


# --- Figure 4 -------------------------------------------------------------------------------------


def fig4(runs: pd.DataFrame) -> pd.DataFrame:
    """Per kind of error, uncertainty and method: RMSEs with and without diverged trials, paired
    against the centroid.

    Rows with sigma NaN hold where a filter's curve crosses the centroid's: `crossing_m` and its 95
    % interval.
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
            row: dict[str, Any] = {
                "an_error": kind,
                "an_sigma_m": sigma,
                "estimator": name,
                "trials": len(d3),
            }
            for key, estimate in {
                "rmse_3d": statistics.pooled_rmse(d3), "rmse_z": statistics.pooled_rmse(dz),
                "kept_3d": statistics.pooled_rmse(d3[~diverged]), "kept_z": statistics.pooled_rmse(dz[~diverged]),
                "diverged": statistics.rate(int(diverged.sum()), len(d3)),
                "median_3d": statistics.quantile(d3, 0.5),
                "above_wcg": statistics.paired(d3, wide["rmse_3d_m"]["wcg"]).percent,
                "above_wcg_z": statistics.paired(dz, wide["rmse_z_m"]["wcg"]).percent,
            }.items():  # fmt: skip
                row |= {key: estimate.value, f"{key}_se": estimate.se}
            rows.append(row)
    for kind, group in runs.groupby("noise.an_error"):
        for name in METHODS[:2]:
            rows.append({"an_error": kind, "estimator": name, **crossing(group, name)})
    return pd.DataFrame(rows)


def crossing(runs: pd.DataFrame, name: str, resamplings: int = 1000) -> dict[str, float]:
    """Smallest uncertainty at which the filter's median RMSE reaches the centroid's, by linear
    interpolation.

    The interval is a bootstrap over whole trials, which are the same draws at every uncertainty.
    NaN: not in the range.
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


# --- Table II -------------------------------------------------------------------------------------


def printed_count(method: str, M: int, n: int) -> int:
    """Multiplications of one step by the paper's formulas (V-B)."""
    if method == "wcg":
        return 11 * M
    a, b, c = (21, 144, 3) if method == "ekf_toa_aoa" else (14, 64, 2)
    return a * M * n**2 + b * M**2 * n + c * M * n


def textbook_count(m: int, n: int) -> int:
    """Multiplications of (17), (18) with dense matrices, m measurements and n states.

    F x; F P, (F P) F^T; H x is not needed; P H^T, H (P H^T); the inverse of S by Gauss and Jordan;
    K = (P H^T) S^-1; K v; K (H P).
    """
    return n**2 + 2 * n**3 + n**2 * m + n * m**2 + m**3 + n * m**2 + n * m + n**2 * m


def our_count(method: str, M: int) -> int:
    """Multiplications and divisions of one step at nine states as our code does it, trigonometric
    functions apart.

    For the filters counted by running the kernel's source on numbers that count (a test does it):
    the prediction with the structure of (19), its Cholesky factor and a 3 x 3 update cost 966, each
    access node 148, its time measured or not. The centroid: range, direction, its turn into the map, weight, weighted
    sums.
    """
    return {"ekf_toa_aoa": 966 + 148 * M, "ekf_aoa": 966 + 148 * M, "wcg": 20 * M + 3}[method]


def table2(scale: str) -> pd.DataFrame:
    """Multiplications at M = 4, n = 9 and the measured time of one step, batched and for one trial
    alone.
    """
    M, n = 4, 9
    cell = _cell("scenario.nearest=4", "noise.an_sigma_m=0.5")
    seconds = time_estimators(
        cell.scenario, cell.noise, cell.estimators, cell.seed, {"quick": 3, "paper": 15}[scale]
    )
    rows = []
    for name in METHODS:
        m = {"ekf_toa_aoa": 3 * M, "ekf_aoa": 2 * M, "wcg": 0}[name]
        spent, trials, steps = seconds[name]
        rows.append(
            {
                "estimator": name, "printed_formula": printed_count(name, M, n),
                "textbook": textbook_count(m, n) if m else np.nan, "ours": our_count(name, M),
                "microseconds_per_step": 1e6 * spent / (trials * steps),
            }
        )  # fmt: skip
    return pd.DataFrame(rows)


# --- errata and consistency -----------------------------------------------------------------------


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
            continue  # one at a time
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
        pooled, diverged = (
            statistics.pooled_rmse(rmse),
            statistics.rate(int((rmse > DIVERGED_M).sum()), len(rmse)),
        )
        middle = statistics.quantile(rmse, 0.5)
        rows.append(
            {
                "an_sigma_m": sigma, "estimator": name, "variant": variant, "trials": len(rmse),
                "rmse_m": pooled.value, "rmse_se": pooled.se, "median_m": middle.value, "median_se": middle.se,
                "diverged": diverged.value, "diverged_se": diverged.se,
            }
        )  # fmt: skip
    return pd.DataFrame(rows).sort_values(["an_sigma_m", "estimator", "variant"], ignore_index=True)


def nees(scale: str) -> pd.DataFrame:
    """Mean over trials of the position's NEES at each time, on the route and with the truth from
    the filter's model.
    """
    trials = {"quick": 16, "paper": 400}[scale]
    rows = []
    for scenario in ("indoor_map", "indoor_map_model"):
        for sigma in (0.0, 0.5, 5.0):
            cell = _cell(f"noise.an_sigma_m={sigma}", scenario=scenario, methods=(FILTERS,))
            draws = Draws(cell.scenario, cell.noise, cell.seed)
            total: dict[str, Any] = dict.fromkeys(cell.estimators, 0.0)
            for first in range(0, trials, 8):
                for name, estimator in cell.estimators.items():
                    truth, found = estimate_tile(draws, estimator, first)
                    assert found.covariance is not None
                    total[name] = total[name] + metrics.nees(
                        found.position - truth[..., :3], found.covariance
                    ).sum(0)
            for name, value in total.items():
                each = 5 if scenario == "indoor_map" else 1
                rows += [
                    (scenario, sigma, name, k * cell.scenario.dt, v / trials, trials)
                    for k, v in list(enumerate(value, 1))[::each]
                ]
    return pd.DataFrame(
        rows, columns=["scenario", "an_sigma_m", "estimator", "time_s", "nees", "trials"]
    )
