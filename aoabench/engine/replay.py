"""Repeat one replication of a run by its number, with one estimator's input, results and trace."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from aoabench.config.adopt import as_estimator, as_noise, as_scenario
from aoabench.config.plugins import construct, import_plugins
from aoabench.engine import metrics
from aoabench.engine.draws import Draws
from aoabench.engine.recording import Identity
from aoabench.engine.tiles import tile_of, try_tile
from aoabench.errors import UserError, did_you_mean
from aoabench.roles import Estimator, Scenario
from aoabench.store import folder
from aoabench.types import Batch, Estimates, Outcome


@dataclass(frozen=True)
class Replay:
    """One repeated replication of one estimator.

    columns: one value per step: of a recording tag, fix and time_s; the truth true_x_m ...; the
    estimates x_m ..., their reported standard deviations sigma_x_m ... and covariances cov_xx_m2
    ..., error_3d_m, nees, outcome, reason, iterations, score, anchors_used; the measurements of
    anchor j (azimuth_<j>_rad, elevation_<j>_rad, delay_<j>_s, rssi_<j>_dbm); the columns of the
    estimator's own `trace`: innovation_<j>_<component>, ess.
    batch and truth (1, T, n) hold this replication alone. rmse_3d_m is computed now, stored_m is
    stored in the run. error: the reason of a failure, or "". track: that of a recording. causal:
    see `Estimator`.
    """

    run: Path
    record: Mapping[str, Any]
    estimator: str
    replication: int
    scenario: Scenario
    columns: Mapping[str, np.ndarray]
    batch: Batch
    truth: np.ndarray
    rmse_3d_m: float
    stored_m: float
    error: str = ""
    causal: bool = True
    track: Identity | None = None

    @property
    def as_stored(self) -> bool:
        """Whether the repeated replication has the stored error, bit for bit."""
        nothing = np.isnan(self.rmse_3d_m) and np.isnan(self.stored_m)
        return self.rmse_3d_m == self.stored_m or bool(nothing)


def replay(
    run: Path,
    replication: int,
    estimator: str,
    cell: str | None = None,
    plugins: Sequence[str] = (),
) -> Replay:
    """Repeat one replication of the run in folder `run`.

    `cell` may be None if the run has only one; `plugins` are the user's own packages that the run
    used. Raises UserError for a run, cell, estimator or replication that does not exist.
    """
    record = _record(run, cell)
    node = _preset(record, estimator, replication)
    import_plugins(plugins)
    config = record["config"]
    scenario = as_scenario(construct(config["scenario"], "scenario", plugins), "scenario")
    noise = as_noise(construct(config["noise"], "noise", plugins), "noise")
    method = as_estimator(construct(node, estimator, plugins), estimator)
    draws = Draws(scenario, noise, record["seed"])
    size = tile_of(method, scenario)
    first, i = replication - replication % size, replication % size
    truth, estimates, errors = try_tile(draws, method, first)
    _, batch = draws.tile(first, size)
    track = None if draws.tracks is None else Identity.of(draws.tracks, replication)
    columns = _named(track, batch) | _estimated(truth[i], estimates, i) | _measured(batch, i)
    if replication not in errors:
        columns |= _traced(draws, method, batch, first, i)
    rmse = metrics.per_replication(estimates, truth[..., :3])["rmse_3d_m"][i]
    return Replay(
        run=run,
        record=record,
        estimator=estimator,
        causal=method.causal,
        replication=replication,
        scenario=scenario,
        columns=columns,
        batch=batch.of(i),
        truth=truth[i : i + 1],
        rmse_3d_m=float(rmse),
        stored_m=_stored(run, record["estimators"][estimator]["key"], replication),
        error=errors.get(replication, ""),
        track=track,
    )


def _traced(
    draws: Draws, method: Estimator, batch: Batch, first: int, i: int
) -> dict[str, np.ndarray]:
    """The columns of the estimator's own trace in the tile's i-th replication; the tile begins at
    the replication `first`.
    """
    numbers = tuple(range(first, first + tile_of(method, draws.scenario)))
    traced = method.trace(batch, draws.scenario, draws.streams(numbers))
    return {name: np.asarray(value)[i] for name, value in traced.items()}


def _record(run: Path, cell: str | None) -> dict[str, Any]:
    """The record of one cell of the run; UserError if the run or the cell does not exist."""
    cells = list(folder.record_files(run))
    if not cells:
        raise folder.no_results(run)
    if cell is None and len(cells) > 1:
        raise UserError(f"--cell: this run has several cells; allowed: {', '.join(cells)}")
    chosen = cell or cells[0]
    if chosen not in cells:
        raise UserError(
            f"--cell={chosen}: not in this run{did_you_mean(chosen, cells)}; "
            f"allowed: {', '.join(cells)}"
        )
    return folder.read_record(run / "cells" / f"{chosen}.json")


def _preset(record: Mapping[str, Any], estimator: str, replication: int) -> Any:
    """The config of one estimator of a cell; UserError for an unknown estimator or replication."""
    config = record["config"]
    presets = {**(config["filter"] or {}), **(config["estimator"] or {})}
    if estimator not in presets:
        hint = did_you_mean(estimator, presets) or f"; allowed: {', '.join(presets)}"
        raise UserError(f"--estimator={estimator}: not in this run{hint}")
    reps = record["estimators"][estimator]["reps"]
    if not 0 <= replication < reps:
        raise UserError(f"--replication={replication} is not in this run; allowed: 0 to {reps - 1}")
    return presets[estimator]


def _stored(run: Path, key: str, replication: int) -> float:
    """The 3-D RMSE in m that the run stored."""
    return folder.value(run, key, "rmse_3d_m", replication)


def _named(track: Identity | None, batch: Batch) -> dict[str, np.ndarray]:
    """Columns of a recorded track's tag, fixes and times."""
    if track is None:
        return {}
    T = len(track.fix)
    time = np.full(T, np.nan) if batch.time is None else batch.time[0]
    return {"tag": np.full(T, track.tag, dtype=object), "fix": track.fix, "time_s": time}


def _estimated(truth: np.ndarray, estimates: Estimates, i: int) -> dict[str, np.ndarray]:
    """Columns of the truth (T, n) and of the estimates in the tile's i-th replication."""
    columns: dict[str, np.ndarray] = {"step": np.arange(len(truth))}
    position, P = estimates.position[i], estimates.covariance
    for axis, name in enumerate("xyz"):
        columns[f"true_{name}_m"] = truth[:, axis]
        columns[f"{name}_m"] = position[:, axis]
        if P is not None:
            columns[f"sigma_{name}_m"] = np.sqrt(np.maximum(P[i, :, axis, axis], 0.0))
    error = position - truth[:, :3]
    columns["error_3d_m"] = metrics.distance(error)
    names = [Outcome(int(o)).name.lower() for o in estimates.outcome[i]]
    columns["outcome"] = np.array(names, dtype=object)
    columns["reason"] = metrics.REASONS[metrics.reasons(estimates)[i]]
    if P is not None:
        for a, b in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)):
            columns[f"cov_{'xyz'[a]}{'xyz'[b]}_m2"] = P[i, :, a, b]
        columns["nees"] = metrics.nees(error[None], P[i : i + 1])[0]
    for name in ("iterations", "score", "anchors_used"):
        if (value := getattr(estimates, name)) is not None:
            columns[name] = np.asarray(value)[i]
    return columns


def _measured(batch: Batch, i: int) -> dict[str, np.ndarray]:
    """Columns of the measurements in the tile's i-th replication, by the places of the batch."""
    named = {
        "azimuth_{}_rad": batch.azimuth,
        "elevation_{}_rad": batch.elevation,
        "delay_{}_s": batch.delay,
        "rssi_{}_dbm": batch.rssi,
    }
    given = {name: value for name, value in named.items() if value is not None}
    return {
        name.format(j): value[i, :, j]
        for j in range(batch.azimuth.shape[2])
        for name, value in given.items()
    }
