"""One block of replications: every estimator, metrics, rows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from aoabench.engine import metrics
from aoabench.engine.tiles import Draws, tile_of, try_tile
from aoabench.types import Estimates

Rows = dict[str, np.ndarray]


_SPAN = 64  # replications whose estimates are held before they become rows


def run_block(
    scenario: Any,
    noise: Any,
    estimators: Mapping[str, Any],
    seed: int,
    start: int,
    stop: int,
    steps: bool = False,
) -> dict[str, dict[str, Rows]]:
    """Replications start..stop-1 for each estimator: `rows`, one per replication, and `steps` if
    asked for.

    Where all replications share their true positions there are `fixes` too, one row of arrays per
    replication, because standard errors then cluster by position. `failures` are there where an
    estimator raised or gave NaN (see `try_tile`). Estimators take turns tile by tile: what depends
    on the replication alone is drawn once for all.
    """
    score = {"rows": _rows}
    score |= {"steps": _details} if steps else {}
    score |= {"fixes": _fixes} if getattr(scenario, "same_truth", False) else {}
    scores: dict[str, dict[str, list[Rows]]] = {
        name: {kind: [] for kind in score} for name in estimators
    }
    errors: dict[str, dict[int, str]] = {name: {} for name in estimators}
    with threadpool_limits(1):
        draws = Draws(scenario, noise, seed)
        for size in sorted({tile_of(estimator, scenario) for estimator in estimators.values()}):
            names = [
                name
                for name, estimator in estimators.items()
                if tile_of(estimator, scenario) == size
            ]
            span = size * max(_SPAN // size, 1)
            for first in range(start - start % size, stop, span):
                tiles = range(first, min(first + span, stop), size)
                found = [
                    {name: try_tile(draws, estimators[name], tile) for name in names}
                    for tile in tiles
                ]
                numbers = np.arange(first, tiles[-1] + size)
                keep = (numbers >= start) & (numbers < stop)
                for name in names:
                    truth = np.concatenate([tile[name][0] for tile in found])
                    estimates = _one_after_the_other([tile[name][1] for tile in found])
                    for tile in found:
                        errors[name] |= tile[name][2]
                    for kind, make in score.items():
                        scores[name][kind].append(make(numbers, truth, estimates, keep))
    blocks = {
        name: {kind: _join(found) for kind, found in kinds.items()}
        for name, kinds in scores.items()
    }
    for name, block in blocks.items():
        block |= _failures(block["rows"], errors[name])
    return blocks


def _one_after_the_other(tiles: list[Estimates]) -> Estimates:
    values = {f.name: [getattr(tile, f.name) for tile in tiles] for f in fields(Estimates)}
    joined = {name: None if v[0] is None else np.concatenate(v) for name, v in values.items()}
    return Estimates(**joined)  # type: ignore[arg-type]


def _rows(numbers: np.ndarray, truth: np.ndarray, estimates: Estimates, keep: np.ndarray) -> Rows:
    found = {"replication": numbers, **metrics.per_replication(estimates, truth[..., :3])}
    return {k: v[keep] for k, v in found.items()}


def _details(
    numbers: np.ndarray, truth: np.ndarray, estimates: Estimates, keep: np.ndarray
) -> Rows:
    R, T = truth.shape[:2]
    found = {"replication": np.tile(numbers, (T, 1)).T, "step": np.tile(np.arange(T), (R, 1))}
    found |= metrics.per_step(estimates, truth[..., :3])
    return {k: v[keep].ravel() for k, v in found.items()}


def _fixes(numbers: np.ndarray, truth: np.ndarray, estimates: Estimates, keep: np.ndarray) -> Rows:
    found = {"replication": numbers, **metrics.per_fix(estimates, truth[..., :3])}
    return {k: v[keep] for k, v in found.items()}


def _failures(rows: Rows, errors: Mapping[int, str]) -> dict[str, Rows]:
    """What went wrong in some of the rows' replications; `lost`: there is no position at all."""
    mine = np.array([int(r) in errors for r in rows["replication"]], dtype=bool)
    if not mine.any():
        return {}
    number = rows["replication"][mine]
    lost = rows["n_failed"][mine] == rows["n_fixes"][mine]
    text = np.array([errors[int(r)] for r in number], dtype=object)
    return {"failures": {"replication": number, "error": text, "lost": lost}}


def _join(blocks: list[Rows]) -> Rows:
    return {k: np.concatenate([b[k] for b in blocks]) for k in blocks[0]}
