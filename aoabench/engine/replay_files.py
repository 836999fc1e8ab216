"""A replayed replication as files: its trace, a picture, and its measurements as a log."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from aoabench.devices import longtable
from aoabench.engine.replay import Replay
from aoabench.report import plots, trace
from aoabench.report.text import shown_name
from aoabench.store.files import provenance, schema, write_atomically, write_table


def write(replay: Replay, export: str | None = None) -> str:
    """Write <run>/replay/<cell>-<estimator>-<replication>.parquet and its picture (.png); return
    lines that name the files.

    `export`, csv or parquet, also writes the measurements in the format that scenario=recorded
    reads.
    """
    name = re.sub(r"[^\w.-]|^\.", "_", replay.estimator)  # the name must not leave the folder
    stem = f"{replay.record['cell']}-{name}-{replay.replication}"
    path = replay.run / "replay" / f"{stem}.parquet"
    special = {"step": "int64"} | dict.fromkeys(("outcome", "reason", "tag", "fix"), "string")
    kinds = {column: special.get(column, "double") for column in replay.columns}
    write_table(path, replay.columns, schema(kinds, provenance(replay.record["config"])))
    lines = [_summary(replay), *([replay.error] if replay.error else []), f"trace: {path}"]
    lines.append(f"picture: {_picture(replay, path)}")
    return "\n".join([*lines, *([_exported(replay, path, export)] if export else [])])


def _summary(replay: Replay) -> str:
    same = (
        "as stored"
        if replay.as_stored
        else f"stored: {replay.stored_m:.17g}; code or libraries have changed since the run"
    )
    tag = "" if replay.track is None or replay.track.tag is None else f" (tag {replay.track.tag})"
    which = (
        f"cell {replay.record['cell']}, {replay.estimator}, replication {replay.replication}{tag}"
    )
    if _has_truth(replay):
        return f"{which}: rmse_3d_m = {replay.rmse_3d_m:.17g} ({same})"
    return f"{which}: {_counted(replay)}, no ground truth"


def _has_truth(replay: Replay) -> bool:
    return bool(np.isfinite(replay.truth[0, :, :2]).all(axis=1).any())


def _counted(replay: Replay) -> str:
    """The number of fixes with a position."""
    outcome = replay.columns["outcome"]
    given = int((~np.isin(outcome, ["failed", "rejected"])).sum())
    return f"{given} of {len(outcome)} fixes have a position"


def _picture(replay: Replay, path: Path) -> Path:
    record, scenario, known = replay.record, replay.scenario, _has_truth(replay)
    result = f"RMSE {replay.rmse_3d_m:.3g} m" if known else _counted(replay)
    tag = "" if replay.track is None or replay.track.tag is None else f", tag {replay.track.tag}"
    name = shown_name(replay.estimator, replay.causal)
    title = (
        f"{record['scenario']}, {record['noise']}: {name}, "
        f"replication {replay.replication}{tag}, {result}"
    )
    anchors = scenario.true_anchors.position[0, 0]
    frame = pd.read_parquet(path)

    def draw() -> Any:
        moving = scenario.motion is not None or not known
        return trace.figure(frame, title, anchors, scenario.wall_segments, moving)

    return plots.save(draw, path.with_suffix(".png"))


def _exported(replay: Replay, path: Path, kind: str) -> str:
    """Write <path>-measurements.<kind>, <path>-anchors.csv; return the command that reads them."""
    track = replay.track
    names = (None, None) if track is None else (track.tag, track.fix)
    measurements, known = longtable.as_tables(replay.batch, replay.truth[0], *names)
    log, anchors = (
        path.with_name(f"{path.stem}-{end}") for end in (f"measurements.{kind}", "anchors.csv")
    )
    save = measurements.to_csv if kind == "csv" else measurements.to_parquet
    write_atomically(log, lambda temporary: save(temporary, index=False))
    write_atomically(anchors, lambda temporary: known.to_csv(temporary, index=False))
    words = [shlex.join([f"scenario.path={log}", f"scenario.anchors={anchors}"])]
    height, bounds = replay.scenario.known_height_m, replay.scenario.bounds_m
    if height is not None:
        words.append(f"scenario.height_m={height}")
    if bounds is not None:
        words.append(f"'scenario.bounds_m={np.asarray(bounds).tolist()}'".replace(" ", ""))
    if np.nanmax(np.abs(replay.batch.elevation), initial=0.0) > np.pi / 2:
        words.append("scenario.elevation_limit_deg=180")
    if measurements.duplicated(["fix", "anchor"]).any():
        words.append("scenario.combine=each")
    last = f"'estimator=[{replay.estimator}]'"
    return f"read the log: aoabench run scenario=recorded {' '.join(words)} {last}"
