"""Coverage of the intervals: many small runs of one setting, and the share of their intervals that
contain the value of all runs together.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from aoabench.cell import Cell
from aoabench.config.compose import compose_cells
from aoabench.engine.block import run_block
from aoabench.maths import intervals as limits
from aoabench.maths import statistics
from aoabench.maths.estimate import Estimate
from aoabench.roles import Scenario
from aoabench.scenarios.bs_grid import BsGrid
from aoabench.scenarios.room import Room
from aoabench.store.accuracy import Errors
from aoabench.store.clusters import influences, position_sums
from aoabench.store.summary import summarise
from aoabench.types import Outcome

NOMINAL = 0.95
LEAST = 0.93  # the upper limit of the coverage must reach it where nothing is flagged
POOLED, MEAN, MEDIAN, CHANGE = "pooled RMSE", "mean RMSE", "median", "change"
SUMMARY = {POOLED: "rmse_pooled_3d_m", MEAN: "rmse_mean_3d_m", MEDIAN: "rmse_q50_3d_m"}
CEP = "cep50_m"  # the median of all fixes, where replications share their positions


@dataclass(frozen=True)
class Setting:
    """A cell whose runs are repeated with `seeds` seeds; `judged` are estimators, compared with
    `baseline`; a run has the first replications of its seed, as many as `sizes` say.

    positions: the number of positions that replications share and each seed draws anew.
    """

    name: str
    words: tuple[str, ...]
    judged: tuple[str, ...]
    baseline: str
    positions: int | None = None
    sizes: tuple[int, ...] = (10, 25, 100)
    seeds: int = 1000


_TRACK = "noise=vmf", "filter=[ekf_vmf,ukf_ae_adaptive]"
_GRID = (
    "scenario=bs_grid", "noise=ae_normal", "noise.sigma_deg=2",
    "estimator=[ml_arctan,ml_atan2,ml_kcorr]",
)  # fmt: skip
_ROOM = (
    "scenario=ble_room", "scenario.packets=1", "scenario.days=1", "noise=ble_multipath",
    "estimator=[discrepancy,ls_lines]",
)  # fmt: skip
_WALK = (
    "scenario=indoor_map", "scenario.route=[[17.5,24.5],[47.5,24.5]]", "noise=ofdm_crlb",
    "filter=[ekf_aoa,ekf_toa_aoa]",
)  # fmt: skip


def square_track(scale: str) -> pd.DataFrame:
    """Filters on the square track."""
    judged = ("ekf_vmf", "ukf_ae_adaptive")
    return _table([Setting("", _TRACK, judged, "ekf_vmf")], scale)


def corridor(scale: str) -> pd.DataFrame:
    """The filter of angles alone in 30 m of a corridor, two uncertainties of the access nodes."""
    return _table(
        [
            Setting(
                f"nodes known to {sigma:g} m",
                (*_WALK, f"noise.an_sigma_m={sigma:g}"),
                ("ekf_aoa",),
                "ekf_toa_aoa",
            )
            for sigma in (0.5, 0)
        ],
        scale,
    )


def bs_grid(scale: str) -> pd.DataFrame:
    """Maximum likelihood without phase-jump correction at random positions among base stations."""
    judged = ("ml_arctan", "ml_atan2")
    return _table(_at_positions(_GRID, judged, "ml_kcorr"), scale)


def room(scale: str) -> pd.DataFrame:
    """The discrepancy filter at random points of a room."""
    return _table(_at_positions(_ROOM, ("discrepancy",), "ls_lines"), scale)


def _at_positions(words: tuple[str, ...], judged: tuple[str, ...], baseline: str) -> list[Setting]:
    """Runs at 100 and at 1000 positions."""
    return [Setting("", words, judged, baseline, positions) for positions in (100, 1000)]


def _table(settings: list[Setting], scale: str) -> pd.DataFrame:
    """A row for each setting, estimator, size of a run and quantity."""
    if scale == "quick":
        settings = [_small(s) for s in settings if s.sizes[0] == 10 and s.positions in (None, 100)]
    return pd.DataFrame([row for setting in settings for row in _rows(setting)])


def _small(setting: Setting) -> Setting:
    positions = None if setting.positions is None else 20
    return replace(setting, seeds=3, sizes=(10,), positions=positions)


def _rows(setting: Setting) -> list[dict[str, Any]]:
    """The rows of one setting."""
    runs: dict[tuple[str, int], list[dict[str, Any]]] = {}
    cell = compose_cells(list(setting.words))[0]
    for seed in range(1, setting.seeds + 1):
        for key, found in _run(setting, cell, seed).items():
            runs.setdefault(key, []).append(found)
    return [
        _row(setting, estimator, size, quantity, found)
        for (estimator, size), found in runs.items()
        for quantity in (POOLED, MEAN, MEDIAN, CHANGE)
        if quantity in found[0]
    ]


@dataclass(frozen=True)
class _Interval:
    """An estimate with its standard error, and the interval shown for it."""

    value: float
    se: float
    low: float
    high: float
    pool: Any  # the data whose median or ratio, over all runs, is the reference


def _run(setting: Setting, cell: Cell, seed: int) -> dict[tuple[str, int], dict[str, Any]]:
    """The intervals of one seed's runs by quantity, and whether a run has a heavy tail, by
    estimator and size.
    """
    scenario = cell.scenario
    if setting.positions is not None:
        scenario = _at_new_positions(scenario, seed, setting.positions)
    blocks = run_block(scenario, cell.noise, cell.estimators, seed, 0, max(setting.sizes))
    found = {}
    for size in setting.sizes:
        tables = {
            name: {kind: _first(rows, size) for kind, rows in block.items()}
            for name, block in blocks.items()
        }
        for name in setting.judged:
            pair = tables[name], tables[setting.baseline]
            found[name, size] = _summary(tables[name]) | (
                {} if name == setting.baseline else {CHANGE: _change(*pair)}
            )
    return found


def _at_new_positions(scenario: Scenario, seed: int, positions: int) -> Scenario:
    """The scenario with positions of its own for this seed; the grid draws them by itself."""
    if isinstance(scenario, Room):
        points = np.random.default_rng([seed, positions]).random((positions, 2))
        return replace(scenario, points_m=(points * scenario.size_m[:2]).tolist())
    assert isinstance(scenario, BsGrid)
    return replace(scenario, positions=positions)


def _first(rows: Mapping[str, np.ndarray], size: int) -> dict[str, np.ndarray]:
    return {name: column[:size] for name, column in rows.items()}


def _summary(tables: Mapping[str, Mapping[str, np.ndarray]]) -> dict[str, Any]:
    """The intervals of the summary by quantity, and its flag."""
    rows, fixes = tables["rows"], tables.get("fixes")
    clusters = errors = None
    if fixes is not None:
        clusters = position_sums(*_errors(fixes))
        xy = np.where(_errors(fixes)[3], fixes["error_xy_m"], np.nan)
        place = np.arange(xy.shape[1])
        errors = Errors(xy, np.full(xy.shape, np.nan), fixes["outcome"] == Outcome.OK, place)
    row = summarise(dict(rows), clusters, errors=errors)
    names = SUMMARY if fixes is None else SUMMARY | {MEDIAN: CEP}
    pool = rows["rmse_3d_m"] if errors is None else errors.xy[np.isfinite(errors.xy)]
    found: dict[str, Any] = {
        quantity: _Interval(
            row[name], row.get(f"{name}_se", np.nan), row[f"{name}_low"], row[f"{name}_high"], pool
        )
        for quantity, name in names.items()
    }
    return found | {"heavy_tail": row["heavy_tail"]}


def _errors(fixes: Mapping[str, np.ndarray]) -> tuple[np.ndarray, ...]:
    """Errors in 3-D and in the plane, iterations, and whether a fix is accepted, each (R, T)."""
    accepted = ~np.isin(fixes["outcome"], [Outcome.FAILED, Outcome.REJECTED])
    accepted &= np.isfinite(fixes["error_xy_m"])
    return fixes["error_3d_m"], fixes["error_xy_m"], fixes["iterations"], accepted


def _change(
    of: Mapping[str, Mapping[str, np.ndarray]], baseline: Mapping[str, Mapping[str, np.ndarray]]
) -> _Interval:
    """The change that `compare` shows, in percent."""
    a, b = (tables["rows"]["rmse_3d_m"] for tables in (of, baseline))
    cells = None
    if "fixes" in of:
        u, v = (influences("rmse_3d_m", *_errors(tables["fixes"])) for tables in (of, baseline))
        cells = u, v
    change = statistics.paired(a, b, cells).percent
    means = np.array([np.nanmean(a), np.nanmean(b)])
    return _Interval(change.value, change.se, *change.interval(NOMINAL), means)


def _row(
    setting: Setting, estimator: str, size: int, quantity: str, runs: list[dict[str, Any]]
) -> dict[str, Any]:
    """Coverage of one quantity's intervals over all runs and over those that are not flagged."""
    found = [run[quantity] for run in runs]
    value, se, low, high = (
        np.array([getattr(one, name) for one in found]) for name in ("value", "se", "low", "high")
    )
    truth = _reference(quantity, value, [one.pool for one in found])
    flagged = np.array([run["heavy_tail"] for run in runs], dtype=bool)
    inside = (low <= truth.value) & (truth.value <= high)
    z = limits.normal_quantile(NOMINAL)
    symmetric = np.abs(value - truth.value) <= z * se if np.isfinite(se).all() else np.array([])
    return {
        "setting": setting.name,
        "estimator": estimator,
        "baseline": setting.baseline if quantity == CHANGE else "",
        "positions": -1 if setting.positions is None else setting.positions,
        "replications": size,
        "quantity": quantity,
        "reference": truth.value,
        "reference_se": truth.se,
        "half_width": float(np.median((high - low) / 2)),
        "flagged": float(flagged.mean()),
        **_coverage("coverage", inside),
        **_coverage("unflagged", inside[~flagged]),
        "symmetric": float(symmetric.mean()) if len(symmetric) else np.nan,
    }


def _reference(quantity: str, values: np.ndarray, pools: list[np.ndarray]) -> Estimate:
    """The value of all runs together, each of which has a weight of 1 / their number."""
    if quantity == POOLED:
        return statistics.mean(values**2).root()
    if quantity == CHANGE:
        a, b = np.array(pools).T
        return (statistics.ratio(a, b) - 1).percent()
    of_means = statistics.mean(values)
    if quantity == MEDIAN:
        return replace(of_means, value=float(np.median(np.concatenate(pools))))
    return of_means


def _coverage(name: str, inside: np.ndarray) -> dict[str, float]:
    """The share of intervals that contain the reference, its 95 % interval, and their number."""
    low, high = limits.rate_interval(int(inside.sum()), len(inside))
    share = float(inside.mean()) if len(inside) else np.nan
    return {name: share, f"{name}_low": low, f"{name}_high": high, f"{name}_runs": len(inside)}
