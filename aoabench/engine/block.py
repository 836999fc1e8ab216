"""One block of replications: every estimator, metrics, rows."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields

import numpy as np
from threadpoolctl import threadpool_limits

from aoabench.engine import metrics
from aoabench.engine.tiles import Draws, tile_of, try_tile
from aoabench.roles import Estimator, Noise, Scenario
from aoabench.types import Estimates

Rows = dict[str, np.ndarray]
RowMaker = Callable[[np.ndarray, np.ndarray, Estimates, np.ndarray], Rows]


_SPAN = 64  # replications whose estimates are held before they become rows


def run_block(
    scenario: Scenario,
    noise: Noise,
    estimators: Mapping[str, Estimator],
    seed: int,
    start: int,
    stop: int,
    steps: bool = False,
) -> dict[str, dict[str, Rows]]:
    """Run replications start..stop-1 and return each estimator's tables: `rows`, one row per
    replication, and with `steps` also `steps`, one row per step.

    Where all replications share their true positions, `fixes` has one row of arrays per
    replication, from which standard errors are clustered by position. `failures` is present only if
    an estimator raised or gave NaN (see `try_tile`). Estimators of one tile size take turns tile by
    tile, so that each tile is drawn once for all of them.
    """
    makers: dict[str, RowMaker] = {"rows": _rows}
    makers |= {"steps": _details} if steps else {}
    makers |= {"fixes": _fixes} if scenario.shares_positions else {}
    blocks: dict[str, dict[str, Rows]] = {}
    with threadpool_limits(1):
        draws = Draws(scenario, noise, seed)
        sizes = {name: tile_of(estimator, scenario) for name, estimator in estimators.items()}
        for size in sorted(set(sizes.values())):
            same = {name: e for name, e in estimators.items() if sizes[name] == size}
            blocks |= _same_tiles(draws, same, size, range(start, stop), makers)
    return {name: blocks[name] for name in estimators}


def _same_tiles(
    draws: Draws,
    estimators: Mapping[str, Estimator],
    size: int,
    wanted: range,
    makers: Mapping[str, RowMaker],
) -> dict[str, dict[str, Rows]]:
    """The tables of each estimator; all of them take tiles of `size` replications."""
    rows = {name: {kind: list[Rows]() for kind in makers} for name in estimators}
    errors = {name: dict[int, str]() for name in estimators}
    span = size * max(_SPAN // size, 1)
    for first in range(wanted.start - wanted.start % size, wanted.stop, span):
        tiles = range(first, min(first + span, wanted.stop), size)
        found = [{n: try_tile(draws, e, tile) for n, e in estimators.items()} for tile in tiles]
        numbers = np.arange(first, tiles[-1] + size)
        keep = (numbers >= wanted.start) & (numbers < wanted.stop)
        for name in estimators:
            truth = np.concatenate([tile[name][0] for tile in found])
            estimates = _one_after_the_other([tile[name][1] for tile in found])
            for tile in found:
                errors[name] |= tile[name][2]
            for kind, make in makers.items():
                rows[name][kind].append(make(numbers, truth, estimates, keep))
    blocks = {}
    for name, kinds in rows.items():
        blocks[name] = {kind: _join(parts) for kind, parts in kinds.items()}
        blocks[name] |= _failures(blocks[name]["rows"], errors[name])
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
    """The table of replications with errors, {} if none; `lost` marks those without a position."""
    mine = np.array([int(r) in errors for r in rows["replication"]], dtype=bool)
    if not mine.any():
        return {}
    number = rows["replication"][mine]
    lost = rows["n_failed"][mine] == rows["n_fixes"][mine]
    text = np.array([errors[int(r)] for r in number], dtype=object)
    return {"failures": {"replication": number, "error": text, "lost": lost}}


def _join(blocks: list[Rows]) -> Rows:
    return {k: np.concatenate([b[k] for b in blocks]) for k in blocks[0]}
