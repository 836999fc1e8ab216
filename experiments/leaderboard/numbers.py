"""Leaderboard: every estimator that runs in a scenario, on the same draws, paired with the best of
those that do not see the truth.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np
import pandas as pd

from aoabench import bounds
from aoabench.cell import Cell
from aoabench.engine.draws import Draws
from aoabench.maths import statistics
from aoabench.maths.estimate import Estimate
from aoabench.maths.tails import largest_share, usual_share
from aoabench.noise.angular import NormalAngles
from aoabench.roles import Estimator
from aoabench.store.fixes import Fixes
from aoabench.types import Outcome

Runs = Iterable[tuple[Cell, Mapping[str, Fixes]]]
Excess = tuple[Estimate, tuple[float, float]]  # in percent, with its 95 % interval
TITLES = {"ae_flip": "Model I: normal angles, flipped", "vmf": "Model II: von Mises-Fisher"}


def square_track(runs: Runs) -> pd.DataFrame:
    """Mean 3-D RMSE per data model."""
    return _board(runs, lambda cell: TITLES[cell.noise_name], _over_replications)


def indoor_map(runs: Runs) -> pd.DataFrame:
    """Mean 3-D RMSE per deviation of the access nodes' positions."""

    def title(cell: Cell) -> str:
        return f"access nodes known to {cell.config['noise']['an_sigma_m']:g} m"

    return _board(runs, title, _over_replications)


def ble_room(runs: Runs) -> pd.DataFrame:
    """Mean horizontal RMSE of a campaign."""
    return _board(runs, lambda _: "synthetic campaigns", _over_replications, "horizontal")


def bs_grid(runs: Runs) -> pd.DataFrame:
    """3-D RMSE per deviation of the angles, paired over the positions, which all replications
    share.
    """

    def title(cell: Cell) -> str:
        return f"{round(float(np.rad2deg(cell.noise.sigma)), 9):g} deg"

    return _board(runs, title, _over_positions)


def _board(
    runs: Runs, title: Callable[[Cell], str], over: Callable[..., Any], metric: str = "3-D"
) -> pd.DataFrame:
    """The rows of all cells. `over` gives, from the errors (R, T) m by estimator, the unit of the
    statistics, the mean square of each unit by estimator, each RMSE, and the function that compares
    two estimators.
    """
    rows = []
    for cell, found in runs:
        errors = {name: _errors(fixes, metric) for name, fixes in found.items()}
        unit, squares, rmse, compare = over(errors)
        kinds = {name: kind_of(cell.estimators[name]) for name in found}
        order = sorted(rmse, key=lambda name: rmse[name].value)
        best = next(name for name in order if kinds[name] != "limit")
        head = {"setting": title(cell), "metric": metric, "over": unit, "n": len(squares[best])}
        head |= {"best": best, "bound_m": bound_m(cell)}
        rank = 0
        for name in order:
            rank += kinds[name] != "limit"
            row = {**head, "rank": 0 if kinds[name] == "limit" else rank, "estimator": name}
            row |= {"kind": kinds[name], **rmse[name].columns("rmse_m", "rmse_se")}
            row |= _excess(compare(name, best)) | _spread(errors[name]) | _tail(squares[name])
            rows.append(row | {"share_ok": float((found[name].outcome == Outcome.OK).mean())})
    return pd.DataFrame(rows)


def kind_of(estimator: Estimator) -> str:
    """`limit` for an estimator that sees the truth, else `filter` or `snapshot`."""
    if "truth" in estimator.needs:
        return "limit"
    return "filter" if estimator.needs & {"motion", "prior"} else "snapshot"


def bound_m(cell: Cell) -> float:
    """Square root in m of the Cramér-Rao bound on the mean square 3-D error over the positions that
    all replications share, for normal angles; else NaN.
    """
    if not (isinstance(cell.noise, NormalAngles) and cell.scenario.shares_positions):
        return float("nan")
    truth = Draws(cell.scenario, cell.noise, cell.seed).tile(0, 1)[0][0]
    covariance = bounds.crb(cell.noise.information(truth, cell.scenario.true_anchors))
    return float(np.sqrt(np.trace(covariance, axis1=-2, axis2=-1).mean()))


def _errors(fixes: Fixes, metric: str) -> np.ndarray:
    """Errors (R, T) m of the fixes that an estimator gives, else NaN."""
    error = fixes.error_3d_m if metric == "3-D" else fixes.error_xy_m
    given = ~np.isin(fixes.outcome, [Outcome.FAILED, Outcome.REJECTED])
    return np.where(given, error.astype(float), np.nan)


def _mean_square(error: np.ndarray, axis: int) -> np.ndarray:
    """Mean squares m^2 along an axis, NaN where there is no fix."""
    count = np.isfinite(error).sum(axis=axis)
    total = np.nansum(error**2, axis=axis)
    return np.divide(total, count, out=np.full(count.shape, np.nan), where=count > 0)


def _over_replications(errors: Mapping[str, np.ndarray]) -> tuple[Any, ...]:
    """Mean of the replications' RMSE; replications without a position form no pair."""
    each = {name: np.sqrt(_mean_square(error, 1)) for name, error in errors.items()}

    def compare(name: str, best: str) -> Excess:
        pair = statistics.paired(each[name], each[best])
        return pair.percent, pair.percent.interval()

    rmse = {name: statistics.mean(values) for name, values in each.items()}
    return "replications", {name: values**2 for name, values in each.items()}, rmse, compare


def _over_positions(errors: Mapping[str, np.ndarray]) -> tuple[Any, ...]:
    """Pooled RMSE, its error and the comparisons over positions."""
    square = {name: _mean_square(error, 0) for name, error in errors.items()}

    def compare(name: str, best: str) -> Excess:
        above = (statistics.ratio(square[name], square[best]).root() - 1).percent()
        return above, above.interval()

    rmse = {name: statistics.pooled_rmse(np.sqrt(values)) for name, values in square.items()}
    return "positions", square, rmse, compare


def _excess(excess: Excess) -> dict[str, float]:
    above, (low, high) = excess
    return {**above.columns("above_percent", "above_se"), "above_low": low, "above_high": high}


def _tail(squares: np.ndarray) -> dict[str, Any]:
    """The share of the sum of squares that the largest unit holds, and whether it is too large for
    the interval of a RMSE, as in summary.parquet.
    """
    share, n = largest_share(squares), int(np.isfinite(squares).sum())
    return {"largest_share": share, "heavy_tail": share > usual_share(n)}


def _spread(error: np.ndarray) -> dict[str, float]:
    """Median and 95 % quantile of the errors of all fixes in m."""
    low, high = np.nanquantile(error, [0.5, 0.95])
    return {"error_q50_m": float(low), "error_q95_m": float(high)}
