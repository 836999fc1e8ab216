"""Serial timings of estimators."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Mapping
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from aoabench.engine.tiles import Draws, checked, placed, tile_of
from aoabench.streams import Streams

_TIMED = 8  # replications that a tile is filled with to take its time


def time_estimators(
    scenario: Any, noise: Any, estimators: Mapping[str, Any], seed: int, repeats: int = 3
) -> dict[str, tuple[float, int, int]]:
    """Median seconds of one tile, its replications and its steps for each estimator; serial, BLAS
    at one thread.

    After a first pass, which warms up, up to `repeats` more, as long as they fit into about a
    second. Large tiles are filled by a few replications, since the simulation is not counted; nor
    is a tile that the estimator raises on, and without any other there is no timing.
    """
    result = {}
    with threadpool_limits(1):
        draws = Draws(scenario, noise, seed)
        for name, estimator in estimators.items():
            size, seconds = tile_of(estimator, scenario), list[float]()
            few = min(size, _TIMED)
            for number in (0, *range(repeats)):
                if sum(seconds) >= 1.0:
                    break
                first = number if size == 1 else 0
                truth, batch = draws.tile(first, few)
                full = batch if few == size else placed(batch, np.arange(size) % few)
                seen = (
                    (truth[np.arange(size) % few],)
                    if getattr(estimator, "sees_truth", False)
                    else ()
                )
                streams = Streams(seed, scenario.name, tuple(range(first, first + size)))
                begin = time.perf_counter()
                with contextlib.suppress(Exception):  # counted as a failure where it is computed
                    checked(estimator(full, scenario, streams, *seen), (size, truth.shape[1]), name)
                    seconds.append(time.perf_counter() - begin)
            seconds = seconds[1:] or seconds
            if seconds:
                result[name] = (float(np.median(seconds)), size, truth.shape[1])
    return result
