"""Repeat one replication of a run by its number, with everything that an estimator saw and said."""

from __future__ import annotations

import re
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from aoabench.config.plugins import construct, import_plugins
from aoabench.engine import metrics, tiles
from aoabench.errors import UserError, did_you_mean
from aoabench.maths.geometry import Array, euler_of
from aoabench.report import plots, trace
from aoabench.store import folder
from aoabench.store.files import provenance, schema, write_atomically, write_table
from aoabench.streams import Streams
from aoabench.types import Batch, Estimates, Outcome


def replay(
    run: Path,
    replication: int,
    estimator: str,
    cell: str | None = None,
    plugins: Sequence[str] = (),
    export: str | None = None,
) -> str:
    """Write <run>/replay/<cell>-<estimator>-<replication>.parquet and its picture (.png), and
    return a text about it.

    The trace has a row per step: true_x_m ..., x_m ..., their stated deviations sigma_x_m ... and
    covariances cov_xx_m2 ..., error_3d_m, nees, outcome, iterations; per anchor j what was measured
    (azimuth_<j>_rad, elevation_<j>_rad, delay_<j>_s, rssi_<j>_dbm); what the estimator's own
    `trace` tells: innovation_<j>_<component>, ess. `plugins` are the packages of the user's own
    that the run used; `export`, csv or parquet, writes what was measured too (see `exported`).
    Raises UserError for a run, cell, estimator or replication that is not there.
    """
    if not (run / "cells").is_dir():
        raise UserError(f"{run}: no results here; allowed: the runner.out folder of a finished run")
    records = {r["cell"]: r for r in folder.records(run)}
    if cell is None and len(records) > 1:
        raise UserError(f"--cell: this run has several; allowed: {', '.join(records)}")
    if not records:
        raise UserError(f"{run}: no results here; allowed: the runner.out folder of a finished run")
    cell = cell or next(iter(records))
    if cell not in records:
        raise UserError(
            f"--cell={cell}: not in this run{did_you_mean(cell, records)}; "
            f"allowed: {', '.join(records)}"
        )
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
    draws = tiles.Draws(scenario, noise, record["seed"])
    method = construct(presets[estimator], estimator, plugins)
    size = tiles.tile_of(method, scenario)
    first = replication - replication % size
    truth, estimates, errors = tiles.try_tile(draws, method, first)
    i = replication - first
    columns = _estimated(truth[i], estimates, i) | _measured(draws.tile(first, size)[1], i)
    if hasattr(method, "trace") and replication not in errors:
        _, batch = draws.tile(first, size)
        streams = Streams(draws.seed, scenario.name, tuple(range(first, first + size)))
        columns |= {
            name: np.asarray(value)[i]
            for name, value in method.trace(batch, scenario, streams).items()
        }
    path = run / "replay" / f"{cell}-{_as_file_name(estimator)}-{replication}.parquet"
    kinds = {name: {"step": "int64", "outcome": "string"}.get(name, "double") for name in columns}
    write_table(path, columns, schema(kinds, provenance(config)))
    rmse = float(metrics.per_replication(estimates, truth[..., :3])["rmse_3d_m"][i])
    rows = pd.read_parquet(run / "replications.parquet" / f"{cell}.parquet")
    stored = rows[(rows["estimator"] == estimator) & (rows["replication"] == replication)][
        "rmse_3d_m"
    ].iloc[0]
    same = rmse == stored or (np.isnan(rmse) and np.isnan(stored))
    says = "as stored" if same else f"stored is {stored:.17g}: code or libraries have changed since"
    title = (
        f"{record['scenario']}, {record['noise']}: {estimator}, "
        f"replication {replication}, RMSE {rmse:.3g} m"
    )
    anchors, walls = (
        np.asarray(scenario.known_anchors.position)[0],
        getattr(scenario, "segments", None),
    )
    frame = pd.read_parquet(path)
    picture = plots.save(
        lambda: trace.figure(frame, title, anchors, walls, scenario.motion is not None),
        path.with_suffix(".png"),
    )
    text = f"cell {cell}, {estimator}, replication {replication}: rmse_3d_m = {rmse:.17g} ({says})"
    wrong = f"\n{errors[replication]}" if replication in errors else ""
    text = f"{text}{wrong}\ntrace: {path}\npicture: {picture}"
    if export is None:
        return text
    batch = draws.tile(first, size)[1]
    return f"{text}\n{exported(path, export, scenario, batch, truth, i, estimator)}"


def _as_file_name(name: str) -> str:
    """The name with whatever could lead out of a folder replaced."""
    return re.sub(r"[^\w.-]|^\.", "_", name)


def _estimated(truth: np.ndarray, estimates: Estimates, i: int) -> dict[str, np.ndarray]:
    """Truth (T, n) and what the estimator said of the tile's i-th replication."""
    columns: dict[str, np.ndarray] = {"step": np.arange(len(truth))}
    position, P = estimates.position[i], estimates.covariance
    for axis, name in enumerate("xyz"):
        columns[f"true_{name}_m"] = truth[:, axis]
        columns[f"{name}_m"] = position[:, axis]
        if P is not None:
            columns[f"sigma_{name}_m"] = np.sqrt(np.maximum(P[i, :, axis, axis], 0.0))
    error = position - truth[:, :3]
    columns["error_3d_m"] = metrics.distance(error)
    columns["outcome"] = np.array(
        [Outcome(int(o)).name.lower() for o in estimates.outcome[i]], dtype=object
    )
    if P is not None:
        for a, b in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)):
            columns[f"cov_{'xyz'[a]}{'xyz'[b]}_m2"] = P[i, :, a, b]
        columns["nees"] = metrics.nees(error[None], P[i : i + 1])[0]
    if estimates.iterations is not None:
        columns["iterations"] = np.asarray(estimates.iterations)[i]
    return columns


def _measured(batch: Batch, i: int) -> dict[str, np.ndarray]:
    """What was measured in the tile's i-th replication."""
    columns = {}
    for j in range(batch.azimuth.shape[2]):
        for name, unit in (
            ("azimuth", "rad"),
            ("elevation", "rad"),
            ("delay", "s"),
            ("rssi", "dbm"),
        ):
            value = getattr(batch, name)
            if value is not None:
                columns[f"{name}_{j}_{unit}"] = value[i, :, j]
    return columns


def exported(
    path: Path, kind: str, scenario: Any, batch: Batch, truth: Array, i: int, estimator: str
) -> str:
    """Write the i-th replication of a tile as scenario=recorded reads it, and return the command
    that does.

    <path>-measurements.<kind> (csv or parquet) has a row per fix and anchor that measured, with the
    true position of truth (R, T, n), <path>-anchors.csv the anchors as the estimator knew them.
    """
    T, B = batch.azimuth.shape[1:]
    fix, anchor = (a.ravel() for a in np.indices((T, B)))
    angles = {
        f"{a}{s}": getattr(batch, f"{a}{s}")
        for s in ("", "_sigma")
        for a in ("azimuth", "elevation")
    }
    columns = {
        f"{name}_deg": np.rad2deg(a[i].ravel()) for name, a in angles.items() if a is not None
    }
    columns |= {} if batch.rssi is None else {"rssi_dbm": batch.rssi[i].ravel()}
    columns |= {f"{axis}_m": truth[i, fix, k] for k, axis in enumerate("xyz")}
    heard = np.isfinite(batch.azimuth[i]) | np.isfinite(batch.elevation[i])
    heard[:, 0] |= ~heard.any(axis=1)  # a fix that nobody measured is one all the same
    frame = pd.DataFrame({"fix": fix, "anchor": anchor + 1, **columns})[heard.ravel()]
    known = batch.anchors.of(i)
    turned = np.rad2deg([euler_of(R.T) for R in known.rotation[0]]) + 0.0  # no -0.0
    place = {f"{axis}_m": known.position[0, :, k] for k, axis in enumerate("xyz")}
    axes = {
        name: turned[:, k] for k, name in ((2, "facing_deg"), (1, "pitch_deg"), (0, "roll_deg"))
    }
    log, anchors = (
        path.with_name(f"{path.stem}-{what}") for what in (f"measurements.{kind}", "anchors.csv")
    )
    write = frame.to_csv if kind == "csv" else frame.to_parquet
    write_atomically(log, lambda temporary: write(temporary, index=False))
    table = pd.DataFrame({"id": np.arange(1, B + 1), **place, **axes})
    write_atomically(anchors, lambda temporary: table.to_csv(temporary, index=False))
    words = [shlex.join([f"scenario.path={log}", f"scenario.anchors={anchors}"])]
    height, bounds = getattr(scenario, "height_m", None), getattr(scenario, "bounds_m", None)
    if isinstance(height, int | float):
        words.append(f"scenario.height_m={height}")
    if bounds is not None:
        words.append(f"'scenario.bounds_m={np.asarray(bounds).tolist()}'".replace(" ", ""))
    if np.nanmax(np.abs(batch.elevation[i]), initial=0.0) > np.pi / 2:
        words.append("scenario.elevation_limit_deg=180")
    return (
        f"read it back: aoabench run scenario=recorded {' '.join(words)} 'estimator=[{estimator}]'"
    )
