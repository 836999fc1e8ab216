"""Repeat one replication of a run by its number, with everything that an estimator saw and said."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from aoabench import metrics, montecarlo, store, tables
from aoabench.config import construct, did_you_mean, import_plugins
from aoabench.types import UserError


def replay(run: Path, replication: int, estimator: str, cell: str | None = None, plugins: Sequence[str] = ()) -> str:
    """Write <run>/replay/<cell>-<estimator>-<replication>.parquet (a row per step) and return a text about it.

    `plugins` are the packages of the user's own that the run used. Raises UserError for a run, cell, estimator or
    replication that is not there.
    """
    if not (run / "cells").is_dir():
        raise UserError(f"{run}: no results here; allowed: the runner.out folder of a finished run")
    records = {r["cell"]: r for r in tables.records(run)}
    if cell is None and len(records) > 1:
        raise UserError(f"--cell: this run has several; allowed: {', '.join(records)}")
    if not records:
        raise UserError(f"{run}: no results here; allowed: the runner.out folder of a finished run")
    cell = cell or next(iter(records))
    if cell not in records:
        raise UserError(f"--cell={cell}: not in this run{did_you_mean(cell, records)}; allowed: {', '.join(records)}")
    record = records[cell]
    config = record["config"]
    presets = {**(config["filter"] or {}), **(config["estimator"] or {})}
    if estimator not in presets:
        hint = did_you_mean(estimator, presets) or f"; allowed: {', '.join(presets)}"
        raise UserError(f"--estimator={estimator}: not in this run{hint}")
    reps = record["estimators"][estimator]["reps"]
    if not 0 <= replication < reps:
        raise UserError(f"--replication={replication} is not in this run; allowed: 0 to {reps - 1}")
    import_plugins(plugins)
    scenario, noise = (construct(config[g], g, plugins) for g in ("scenario", "noise"))
    draws = montecarlo.Draws(scenario, noise, record["seed"])
    method = construct(presets[estimator], estimator, plugins)
    size = montecarlo.tile_of(method)
    first = replication - replication % size
    truth, estimates = montecarlo.estimate_tile(draws, method, first)
    i = replication - first
    _, batch = draws.tile(first, size)
    columns: dict[str, np.ndarray] = {"step": np.arange(truth.shape[1])}
    for axis, name in enumerate("xyz"):
        columns[f"true_{name}_m"] = truth[i, :, axis]
        columns[f"{name}_m"] = estimates.position[i, :, axis]
        if estimates.covariance is not None:
            columns[f"sigma_{name}_m"] = np.sqrt(np.maximum(estimates.covariance[i, :, axis, axis], 0.0))
    if estimates.covariance is not None:
        columns["covariance_xy_m2"] = estimates.covariance[i, :, 0, 1]
    for j in range(batch.azimuth.shape[2]):
        columns[f"azimuth_{j}_rad"] = batch.azimuth[i, :, j]
        columns[f"elevation_{j}_rad"] = batch.elevation[i, :, j]
    columns["error_3d_m"] = np.linalg.norm(estimates.position[i] - truth[i, :, :3], axis=-1)
    path = run / "replay" / f"{cell}-{estimator}-{replication}.parquet"
    kinds = {name: "int64" if name == "step" else "double" for name in columns}
    store.write_table(path, columns, store.schema(kinds, store.provenance(config)))
    rmse = float(metrics.per_replication(estimates, truth[..., :3])["rmse_3d_m"][i])
    rows = pd.read_parquet(run / "replications.parquet" / f"{cell}.parquet")
    stored = rows[(rows["estimator"] == estimator) & (rows["replication"] == replication)]["rmse_3d_m"].iloc[0]
    same = rmse == stored or (np.isnan(rmse) and np.isnan(stored))
    says = "as stored" if same else f"stored is {stored:.17g}: code or libraries have changed since"
    return f"cell {cell}, {estimator}, replication {replication}: rmse_3d_m = {rmse:.17g} ({says})\ntrace: {path}"
