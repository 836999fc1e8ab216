"""One block of replications: truth and measurements, every estimator, metrics, rows.

Estimators see tiles of a fixed number of replications, aligned on the replication number, whatever block they are in:
the same replication gives the same bits however the work is cut.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from aoabench import metrics
from aoabench.streams import ANCHORS, ESTIMATOR, MEASUREMENT, PRIOR, TRUTH, Streams, generator
from aoabench.types import Anchors, Batch, Estimates, Measurements, Outcome, UserError

Rows = dict[str, np.ndarray]

_SPAN = 64  # replications whose estimates are held before they become rows


def tile_of(estimator: Any, scenario: Any = None) -> int:
    """How many replications this estimator takes at once; no more than the scenario has, if it says how many."""
    tile = int(getattr(estimator, "tile", 128))
    return min(tile, getattr(scenario, "replications", tile))


def simulate(scenario: Any, noise: Any, seed: int, replication: int) -> tuple[np.ndarray, Measurements, Any]:
    """Truth (T, n), measurements and prior (mean, covariance) of one replication.

    A scenario with `same_truth` has one truth for all replications.
    """
    once = getattr(scenario, "same_truth", False)
    truth = scenario.truth(generator(seed, scenario.name, 0 if once else replication, TRUTH))
    measured = getattr(scenario, "recorded", None)
    if measured is None:
        measured = noise.sample(generator(seed, scenario.name, replication, MEASUREMENT), scenario, truth)
    prior = scenario.prior(generator(seed, scenario.name, replication, ESTIMATOR, PRIOR), truth)
    return truth, measured, prior


class Draws:
    """Simulated replications of one cell; the last tile is kept, for the next estimator that asks for it."""

    def __init__(self, scenario: Any, noise: Any, seed: int) -> None:
        self.scenario, self.noise, self.seed = scenario, noise, seed
        self._last: tuple[tuple[int, int], tuple[np.ndarray, Batch]] | None = None

    def tile(self, start: int, size: int) -> tuple[np.ndarray, Batch]:
        """Truth (size, T, n) and batch of the replications from `start` on."""
        if self._last is None or self._last[0] != (start, size):
            self._last = (start, size), self._simulated(start, size)
        return self._last[1]

    def _simulated(self, start: int, size: int) -> tuple[np.ndarray, Batch]:
        drawn = [simulate(self.scenario, self.noise, self.seed, r) for r in range(start, start + size)]
        measured = {
            f.name: None if getattr(drawn[0][1], f.name) is None else np.stack([getattr(d[1], f.name) for d in drawn])
            for f in fields(Measurements)
        }
        prior = drawn[0][2]
        known = self._known_anchors(range(start, start + size))
        batch = Batch(
            anchors=known,
            prior_mean=None if prior is None else np.stack([d[2][0] for d in drawn]),
            prior_cov=None if prior is None else prior[1],
            **measured,  # type: ignore[arg-type]
        )
        truth = np.stack([d[0] for d in drawn])
        anchors = (known.position, known.rotation, known.position_sigma)
        for shared in (truth, *anchors, *(getattr(batch, f.name) for f in fields(batch))):
            if isinstance(shared, np.ndarray):
                shared.setflags(write=False)  # all estimators see the same
        return truth, batch

    def _known_anchors(self, replications: range) -> Anchors:
        true: Anchors = self.scenario.known_anchors
        if not hasattr(self.noise, "known_anchors"):
            return true
        name = self.scenario.name
        each = [self.noise.known_anchors(generator(self.seed, name, r, ANCHORS), self.scenario) for r in replications]
        sigma = [a.position_sigma for a in each]
        return Anchors(
            np.concatenate([a.position for a in each]), true.rotation, None if sigma[0] is None else sigma[0]
        )


def run_block(
    scenario: Any, noise: Any, estimators: Mapping[str, Any], seed: int, start: int, stop: int, steps: bool = False
) -> dict[str, dict[str, Rows]]:
    """Replications start..stop-1 for each estimator: `rows`, one per replication, and `steps` if asked for.

    Where all replications share their true positions there are `fixes` too, one row of arrays per replication, because
    standard errors then cluster by position. Estimators take turns tile by tile: what depends on the replication alone
    is drawn once for all of them.
    """
    score = {"rows": _rows}
    score |= {"steps": _details} if steps else {}
    score |= {"fixes": _fixes} if getattr(scenario, "same_truth", False) else {}
    scores: dict[str, dict[str, list[Rows]]] = {name: {kind: [] for kind in score} for name in estimators}
    with threadpool_limits(1):
        draws = Draws(scenario, noise, seed)
        for size in sorted({tile_of(estimator, scenario) for estimator in estimators.values()}):
            names = [name for name, estimator in estimators.items() if tile_of(estimator, scenario) == size]
            span = size * max(_SPAN // size, 1)
            for first in range(start - start % size, stop, span):
                tiles = range(first, min(first + span, stop), size)
                found = [{name: estimate_tile(draws, estimators[name], tile) for name in names} for tile in tiles]
                numbers = np.arange(first, tiles[-1] + size)
                keep = (numbers >= start) & (numbers < stop)
                for name in names:
                    truth = np.concatenate([tile[name][0] for tile in found])
                    estimates = _one_after_the_other([tile[name][1] for tile in found])
                    for kind, make in score.items():
                        scores[name][kind].append(make(numbers, truth, estimates, keep))
    return {name: {kind: _join(found) for kind, found in kinds.items()} for name, kinds in scores.items()}


def _one_after_the_other(tiles: list[Estimates]) -> Estimates:
    values = {f.name: [getattr(tile, f.name) for tile in tiles] for f in fields(Estimates)}
    return Estimates(**{name: None if v[0] is None else np.concatenate(v) for name, v in values.items()})  # type: ignore[arg-type]


def _rows(numbers: np.ndarray, truth: np.ndarray, estimates: Estimates, keep: np.ndarray) -> Rows:
    found = {"replication": numbers, **metrics.per_replication(estimates, truth[..., :3])}
    return {k: v[keep] for k, v in found.items()}


def _details(numbers: np.ndarray, truth: np.ndarray, estimates: Estimates, keep: np.ndarray) -> Rows:
    R, T = truth.shape[:2]
    found = {"replication": np.tile(numbers, (T, 1)).T, "step": np.tile(np.arange(T), (R, 1))}
    found |= metrics.per_step(estimates, truth[..., :3])
    return {k: v[keep].ravel() for k, v in found.items()}


def _fixes(numbers: np.ndarray, truth: np.ndarray, estimates: Estimates, keep: np.ndarray) -> Rows:
    found = {"replication": numbers, **metrics.per_fix(estimates, truth[..., :3])}
    return {k: v[keep] for k, v in found.items()}


def estimate_tile(draws: Draws, estimator: Any, first: int) -> tuple[np.ndarray, Estimates]:
    """Truth (R, T, n) and estimates of the tile that starts at replication `first`."""
    size = tile_of(estimator, draws.scenario)
    truth, batch = draws.tile(first, size)
    streams = Streams(draws.seed, draws.scenario.name, tuple(range(first, first + size)))
    seen = (truth,) if getattr(estimator, "sees_truth", False) else ()
    estimates = estimator(batch, draws.scenario, streams, *seen)
    return truth, checked(estimates, truth.shape[:2], type(estimator).__name__)


def checked(estimates: Estimates, shape: tuple[int, ...], name: str) -> Estimates:
    """The estimates, if their arrays have the shapes (R, T, ...) that the protocol asks for; UserError otherwise.

    A fix that claims a position and gives none (x or y not finite) is `failed`: nothing drops out of the counts.
    """
    wanted = {"position": (*shape, 3), "covariance": (*shape, 3, 3), "outcome": shape}
    wanted |= dict.fromkeys(("iterations", "score", "anchors_used"), shape)
    for field, expected in wanted.items():
        value = getattr(estimates, field)
        if value is None and field not in ("position", "outcome"):
            continue
        if np.shape(value) != expected:
            raise UserError(f"{name}: Estimates.{field} must have the shape {expected}, not {np.shape(value)}")
    given = (estimates.outcome != Outcome.FAILED) & (estimates.outcome != Outcome.REJECTED)
    lost = given & ~np.isfinite(estimates.position[..., :2]).all(-1)
    return replace(estimates, outcome=np.where(lost, Outcome.FAILED, estimates.outcome).astype(np.int8))


def time_estimators(
    scenario: Any, noise: Any, estimators: Mapping[str, Any], seed: int, repeats: int = 3
) -> dict[str, tuple[float, int, int]]:
    """Median seconds of one tile, its replications and its steps for each estimator; serial, BLAS at one thread.

    After a first pass, which warms up, up to `repeats` more on the next tiles, as long as they fit into about a second.
    The simulation is not counted.
    """
    result = {}
    with threadpool_limits(1):
        draws = Draws(scenario, noise, seed)
        for name, estimator in estimators.items():
            seconds: list[float] = []
            while len(seconds) <= repeats and sum(seconds) < 1.0:
                first = len(seconds) * (size := tile_of(estimator, scenario))
                draws.tile(first, size)
                begin = time.perf_counter()
                truth, _ = estimate_tile(draws, estimator, first)
                seconds.append(time.perf_counter() - begin)
            seconds = seconds[1:] or seconds
            result[name] = (float(np.median(seconds)), truth.shape[0], truth.shape[1])
    return result


def _join(blocks: list[Rows]) -> Rows:
    return {k: np.concatenate([b[k] for b in blocks]) for k in blocks[0]}
