"""One block of replications: every estimator, metrics, rows."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np

from aoabench.engine import metrics, recording
from aoabench.engine.draws import Draws
from aoabench.engine.inputs import Inputs
from aoabench.engine.threads import one_thread
from aoabench.engine.tiles import tile_of, try_tile
from aoabench.roles import Estimator, Noise, Scenario
from aoabench.types import Estimates

Rows = dict[str, np.ndarray]


@dataclass(frozen=True)
class Results:
    """An estimator's results for some replications: numbers (R,), true states (R, T, n), estimates
    and the facts about their input; those in `keep` become rows. `place` (T,): the places
    (metrics.places) of true positions that all replications share, or of all fixes of a recording,
    which says what `track` the results are of.
    """

    numbers: np.ndarray
    truth: np.ndarray
    estimates: Estimates
    inputs: Inputs
    keep: slice
    place: np.ndarray | None = None
    track: recording.Identity | None = None

    @cached_property
    def imprecise(self) -> np.ndarray:
        """Inputs.imprecise (R, T) of the estimates."""
        return self.inputs.imprecise(self.estimates)

    def near_those_kept(self) -> Results:
        """The results without the replications before and after those that become rows; two are
        left, if there are two, as NumPy may sum a single one in another order.
        """
        first = max(min(self.keep.start, len(self.numbers) - 2), 0)
        some = slice(first, max(self.keep.stop, first + 2))
        if some == slice(0, len(self.numbers)):
            return self
        inputs, estimates = (_cut(one, some) for one in (self.inputs, self.estimates))
        keep = slice(self.keep.start - first, self.keep.stop - first)
        cut = {"numbers": self.numbers[some], "truth": self.truth[some], "keep": keep}
        return replace(self, estimates=estimates, inputs=inputs, **cut)  # type: ignore[arg-type]


def _cut(arrays: Any, some: slice) -> Any:
    """A dataclass of arrays (R, ...) or None with some of the replications."""
    given = {f.name: getattr(arrays, f.name) for f in fields(arrays)}
    return type(arrays)(**{k: None if v is None else v[some] for k, v in given.items()})


RowMaker = Callable[[Results], Rows]


_SPAN = 2**16  # fixes whose estimates are held before they become rows


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

    Where all replications share their true positions, and in a recording, `fixes` has one row of
    arrays per replication, from which standard errors are clustered by position. `failures` is
    present only if an estimator raised or gave NaN (see `try_tile`), `reasons` only if a fix is not
    ok. Estimators of one tile size take turns tile by tile, so that each tile is drawn once for all
    of them.
    """
    tracks = scenario.tracks
    shared = scenario.shares_positions if tracks is None else recording.has_places(tracks)
    makers: dict[str, RowMaker] = {"rows": _rows, "reasons": _reasons}
    makers |= {"steps": _details} if steps else {}
    makers |= {"fixes": _fixes} if shared else {}
    blocks: dict[str, dict[str, Rows]] = {}
    wanted = range(start, stop)
    with one_thread():
        sizes = {name: tile_of(estimator, scenario) for name, estimator in estimators.items()}
        for size in sorted(set(sizes.values())):
            same = {name: e for name, e in estimators.items() if sizes[name] == size}
            alone = all(e.by_replication for e in same.values())
            draws = Draws(scenario, noise, seed, wanted if alone else None)
            blocks |= _same_tiles(draws, same, size, wanted, makers)
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
    start = wanted.start - wanted.start % size
    truth, tracks = draws.drawn(start, size).truth[0], draws.tracks
    shared = truth[:, :3] if tracks is None else tracks.truth
    place = metrics.places(shared) if "fixes" in makers else None
    span = size * max(_SPAN // (size * len(truth)), 1) if tracks is None else 1
    for first in range(start, wanted.stop, span):
        tiles = range(first, min(first + span, wanted.stop), size)
        inputs, found = zip(*(_tried(draws, estimators, tile, size) for tile in tiles))
        facts = Inputs.joined(inputs)
        track = None if tracks is None else recording.Identity.of(tracks, first)
        numbers = np.arange(first, tiles[-1] + size)
        keep = slice(max(wanted.start - first, 0), min(wanted.stop - first, len(numbers)))
        for name in estimators:
            truth = _joined([tile[name][0] for tile in found])
            estimates = _one_after_the_other([tile[name][1] for tile in found])
            for tile in found:
                errors[name] |= tile[name][2]
            mine = Results(numbers, truth, estimates, facts, keep, place, track)
            results = mine.near_those_kept()
            for kind, make in makers.items():
                rows[name][kind].append(make(results))
    blocks = {}
    for name, kinds in rows.items():
        joined = {kind: _join(parts) for kind, parts in kinds.items()}
        blocks[name] = {k: v for k, v in joined.items() if k != "reasons" or len(v["n"])}
        blocks[name] |= _failures(blocks[name]["rows"], errors[name])
    return blocks


Tried = tuple[np.ndarray, Estimates, dict[int, str]]


def _tried(
    draws: Draws, estimators: Mapping[str, Estimator], first: int, size: int
) -> tuple[Inputs, dict[str, Tried]]:
    """The facts about one tile's input, and what `try_tile` returns for each estimator."""
    heard_only = any(estimator.heard_only for estimator in estimators.values())
    _, batch = draws.tile(first, size, heard_only)
    inputs = Inputs.of(batch)
    return inputs, {name: try_tile(draws, e, first) for name, e in estimators.items()}


def _one_after_the_other(tiles: list[Estimates]) -> Estimates:
    """The estimates of all tiles; NaN in place of an optional array that some tiles lack, such as
    one whose replications all raised.
    """
    if len(tiles) == 1:
        return tiles[0]
    joined: dict[str, np.ndarray | None] = {}
    for name in (f.name for f in fields(Estimates)):
        arrays = [getattr(tile, name) for tile in tiles]
        given = next((a for a in arrays if a is not None), None)
        if given is None:
            joined[name] = None
            continue
        shapes = [(*tile.outcome.shape, *given.shape[2:]) for tile in tiles]
        joined[name] = np.concatenate(
            [np.full(shape, np.nan) if a is None else a for a, shape in zip(arrays, shapes)]
        )
    return Estimates(**joined)  # type: ignore[arg-type]


def _rows(of: Results) -> Rows:
    found = {"replication": of.numbers, **metrics.per_replication(of.estimates, of.truth[..., :3])}
    found["n_unmeasured"] = of.inputs.unmeasured.sum(axis=1)
    found["n_imprecise"] = of.imprecise.sum(axis=1)
    found["tag"] = np.full(len(of.numbers), of.track and of.track.tag, dtype=object)
    if of.track is not None:
        found["outcome"] = metrics.commonest_outcome(of.estimates)
    return {k: v[of.keep] for k, v in found.items()}


def _reasons(of: Results) -> Rows:
    found = metrics.reason_counts(of.estimates)
    index = found["replication"]
    keep = slice(*np.searchsorted(index, (of.keep.start, of.keep.stop)))
    return {k: v[keep] for k, v in (found | {"replication": of.numbers[index]}).items()}


def _details(of: Results) -> Rows:
    R, T = of.truth.shape[:2]
    found = {"replication": np.tile(of.numbers, (T, 1)).T, "step": np.tile(np.arange(T), (R, 1))}
    found |= metrics.per_step(of.estimates, of.truth[..., :3])
    found |= {"time_s": of.inputs.time, "imprecise": of.imprecise}
    found["n_unmeasured"] = of.inputs.unmeasured.astype(int)
    found["tag"] = np.full((R, T), of.track and of.track.tag, dtype=object)
    found["fix"] = np.full((R, T), None) if of.track is None else of.track.fix[None]
    return {k: v[of.keep].ravel() for k, v in found.items()}


def _fixes(of: Results) -> Rows:
    found = {"replication": of.numbers, **metrics.per_fix(of.estimates, of.truth[..., :3])}
    flags = {"n_unmeasured": of.inputs.unmeasured, "imprecise": of.imprecise}
    found |= {name: flag.astype(np.int8) for name, flag in flags.items()}
    if of.track is not None:
        fixes = {name: v for name, v in found.items() if name != "replication"}
        found |= {name: of.track.spread(v, _absent(name, v)) for name, v in fixes.items()}
    assert of.place is not None
    found["place"] = np.broadcast_to(of.place, found["outcome"].shape)
    return {k: v[of.keep] for k, v in found.items()}


def _absent(name: str, values: np.ndarray) -> float:
    """The value of a column of the fixes table for a fix of another track."""
    return np.nan if values.dtype.kind == "f" else -1 if name == "outcome" else 0


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
    return {k: _joined([b[k] for b in blocks]) for k in blocks[0]}


def _joined(arrays: list[np.ndarray]) -> np.ndarray:
    """The arrays one after the other; a single one is not copied."""
    return arrays[0] if len(arrays) == 1 else np.concatenate(arrays)
