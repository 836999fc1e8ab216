"""Leaderboard: every estimator that runs in a scenario, on the same draws, paired with the best."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import pandas as pd

from aoabench.cell import Cell
from aoabench.maths import statistics
from aoabench.maths.statistics import Estimate
from aoabench.store.fixes import Fixes
from aoabench.types import Outcome


def square_track(frame: pd.DataFrame) -> pd.DataFrame:
    """Mean 3-D RMSE per data model."""
    titles = {"ae_flip": "Model I: normal angles, flipped", "vmf": "Model II: von Mises-Fisher"}
    return _over_replications(frame, frame["noise"].map(titles), "3d")


def indoor_map(frame: pd.DataFrame) -> pd.DataFrame:
    """Mean 3-D RMSE per deviation of the access nodes' positions."""
    settings = frame["noise.an_sigma_m"].map(lambda s: f"access nodes known to {float(s):g} m")
    return _over_replications(frame, settings, "3d")


def ble_room(frame: pd.DataFrame) -> pd.DataFrame:
    """Mean horizontal RMSE of a campaign."""
    return _over_replications(frame, pd.Series("synthetic campaigns", index=frame.index), "xy")


def bs_grid(runs: Iterable[tuple[Cell, dict[str, Fixes]]]) -> pd.DataFrame:
    """3-D RMSE per deviation of the angles, paired over the positions, which all replications
    share.
    """
    rows = []
    for cell, fixes in runs:
        setting = f"{round(float(np.rad2deg(cell.noise.sigma)), 9):g} deg"
        square = {
            name: np.nanmean(f.error_3d_m.astype(float) ** 2, axis=0) for name, f in fixes.items()
        }
        rmse = {name: statistics.pooled_rmse(np.sqrt(s)) for name, s in square.items()}
        best = min(rmse, key=lambda name: rmse[name].value)
        ok = {name: float((f.outcome == Outcome.OK).mean()) for name, f in fixes.items()}
        above = {name: _above(s, square[best]) for name, s in square.items()}
        rows += _ranked(setting, "3-D", "positions", len(square[best]), rmse, above, ok)
    return pd.DataFrame(rows)


def _above(square: np.ndarray, other: np.ndarray) -> tuple[Estimate, tuple[float, float]]:
    """Excess of an RMSE over another one in percent, with its 95 % interval, from the mean squares
    (P,) m^2 per position of both.
    """
    above = (statistics.ratio(square, other).root() - 1).percent()
    return above, above.interval()


def _over_replications(frame: pd.DataFrame, settings: pd.Series, axis: str) -> pd.DataFrame:
    """Rows of the leaderboard from replications; replications without a position have no RMSE and
    form no pair.
    """
    rows = []
    for setting, part in frame.groupby(settings, sort=False):
        wide = part.pivot(index="replication", columns="estimator", values=f"rmse_{axis}_m")
        rmse = {str(name): statistics.mean(wide[name]) for name in wide}
        best = min(rmse, key=lambda name: rmse[name].value)
        pairs = {name: statistics.paired(wide[name], wide[best]) for name in rmse}
        above = {name: (p.percent, p.percent.interval()) for name, p in pairs.items()}
        fixes = part.groupby("estimator")[["n_ok", "n_fixes"]].sum()
        ok = (fixes["n_ok"] / fixes["n_fixes"]).to_dict()
        metric = {"3d": "3-D", "xy": "horizontal"}[axis]
        rows += _ranked(str(setting), metric, "replications", len(wide), rmse, above, ok)
    return pd.DataFrame(rows)


def _ranked(
    setting: str, metric: str, unit: str, n: int, rmse: Mapping[str, Estimate],
    above: Mapping[str, tuple[Estimate, tuple[float, float]]], ok: Mapping[str, float],
) -> list[dict[str, Any]]:  # fmt: skip
    order = sorted(rmse, key=lambda name: rmse[name].value)
    return [
        {
            "setting": setting,
            "rank": i + 1,
            "estimator": name,
            "metric": metric,
            "over": unit,
            "n": n,
            **rmse[name].columns("rmse_m", "rmse_se"),
            "above_percent": above[name][0].value,
            "above_se": above[name][0].se,
            "above_low": above[name][1][0],
            "above_high": above[name][1][1],
            "share_ok": ok[name],
        }
        for i, name in enumerate(order)
    ]
