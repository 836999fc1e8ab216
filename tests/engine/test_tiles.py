"""Blocks of replications: which tiles an estimator sees, and what becomes of them."""

import numpy as np
import pytest

from aoabench.config.compose import compose_cells
from aoabench.engine.block import run_block
from aoabench.engine.timing import time_estimators
from aoabench.noise.angular import VonMisesFisher
from aoabench.roles import Estimator
from aoabench.types import Estimates, Outcome


class Noting(Estimator):
    """Notes the replications of each tile; answers replication r with the position (r, 0, 0)."""

    def __init__(self, tile):
        self.tile, self.seen = tile, []

    def __call__(self, batch, scenario, streams):
        self.seen.append(streams.replications)
        assert len(batch.azimuth) == len(streams.replications)
        position = np.zeros((*batch.azimuth.shape[:2], 3))
        position[..., 0] = np.array(streams.replications)[:, None]
        return Estimates(position, None, None, np.full(position.shape[:2], Outcome.OK, np.int8))


@pytest.mark.parametrize(("start", "stop"), [(0, 8), (5, 21), (16, 17), (7, 8)])
def test_tiles_are_aligned_on_the_replications_number(start, stop, track):
    """Whole tiles from a multiple of their size on, however the block is cut; rows are the block's."""
    estimators = {f"tile {size}": Noting(size) for size in (1, 4, 8)}
    found = run_block(track, VonMisesFisher(10.0), estimators, 1, start, stop, steps=True)
    for name, estimator in estimators.items():
        size = estimator.tile
        first = range(start - start % size, stop, size)
        assert estimator.seen == [tuple(range(f, f + size)) for f in first]
        assert found[name]["rows"]["replication"].tolist() == list(range(start, stop))
        steps = found[name]["steps"]
        assert np.array_equal(steps["x_m"], steps["replication"])
        assert steps["replication"].tolist() == np.repeat(range(start, stop), 64).tolist()


class Unprepared(Estimator):
    """Raises unless it was prepared."""

    needs = frozenset()
    ready = False

    def prepare(self, say):
        self.ready = True

    def __call__(self, batch, scenario, streams):
        assert self.ready
        R, T, _ = batch.azimuth.shape
        return Estimates(np.zeros((R, T, 3)), None, None, np.zeros((R, T), dtype=np.int8))


def test_what_is_timed_was_prepared():
    """Compiling would be in the first pass, and no other follows one that takes a second."""
    cell = compose_cells(["filter=[ekf_vmf]"])[0]
    given = cell.scenario, cell.noise, {"new": Unprepared()}, cell.seed
    assert set(time_estimators(*given, 300)) == {"new"}
