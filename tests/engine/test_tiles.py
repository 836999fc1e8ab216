"""Blocks of replications: which tiles an estimator sees, and what becomes of them."""

import sys

import numpy as np
import pytest

from aoabench.config.compose import compose_cells
from aoabench.config.presets import options
from aoabench.engine import threads, timing
from aoabench.engine.block import run_block
from aoabench.engine.draws import Draws
from aoabench.engine.tiles import tile_of
from aoabench.engine.timing import time_estimators
from aoabench.errors import UserError
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


PLACES = [
    ("filter", ["noise=vmf", "scenario.steps=2"]),
    ("filter", ["noise=ofdm_crlb", "scenario=indoor_map", "scenario.dt=40"]),
    ("estimator", ["noise=ae_flip", "scenario.steps=2", "noise.mounting_yaw_deg=3"]),
    ("estimator", ["noise=ble_multipath", "scenario=ble_room", "scenario.packets=2"]),
]


@pytest.mark.parametrize(("group", "words"), PLACES)
def test_replications_that_are_not_wanted_change_no_bit(group, words):
    """Every shipped estimator says that it depends on its own replication alone: with the data of
    one replication in the places of the others it gives the same bits as in the whole tile.
    """
    seen = set()
    for name in options(group):
        rest = ["filter=[]"] if group == "estimator" else []
        rest += [f"filter.{name}.particles=50"] if name.startswith("pf_") else []
        try:
            cell = compose_cells([*words, *rest, f"{group}=[{name}]"])[0]
        except UserError:
            continue
        estimator = cell.estimators[name]
        assert estimator.by_replication, name
        own = vars(estimator)
        kind = type(estimator), own.get("engine"), type(own.get("measurement"))
        size = tile_of(estimator, cell.scenario)
        if kind in seen or size == 1:
            continue
        seen.add(kind)
        given = cell.scenario, cell.noise, cell.estimators, cell.seed
        whole = run_block(*given, 0, size)[name]["rows"]
        for start, stop in ((0, 1), (size - 3, size)):
            some = run_block(*given, start, stop)[name]["rows"]
            for column, values in some.items():
                np.testing.assert_array_equal(values, whole[column][start:stop], f"{name} {column}")
    assert seen


def test_only_the_wanted_replications_are_simulated(monkeypatch):
    """A second one, if one is wanted; all of them for an estimator that says nothing of itself."""
    drawn, simulate = [], Draws.simulate
    monkeypatch.setattr(Draws, "simulate", lambda *a: (drawn.extend(a[-1]), simulate(*a))[1])
    cell = compose_cells(["noise=vmf", "filter=[ekf_vmf]", "scenario.steps=2"])[0]
    for (start, stop), numbers in (
        ((0, 2), [0, 1]),
        ((5, 6), [5, 6]),
        ((127, 128), [126, 127]),
        ((126, 131), [126, 127, 128, 129, 130]),
    ):
        run_block(cell.scenario, cell.noise, cell.estimators, cell.seed, start, stop)
        assert drawn == numbers
        drawn.clear()
    run_block(cell.scenario, cell.noise, {"mine": Noting(16)}, cell.seed, 0, 2)
    assert drawn == list(range(16))


def test_a_single_replication_is_timed():
    cell = compose_cells(["noise=vmf", "filter=[ekf_vmf]", "scenario.steps=2"])[0]
    found = time_estimators(cell.scenario, cell.noise, cell.estimators, 1, reps=1)
    assert found["ekf_vmf"].seconds > 0
    assert (found["ekf_vmf"].replications, found["ekf_vmf"].steps) == (128, 2)


def test_cells_of_few_replications_share_a_measurement(monkeypatch):
    """Cells that differ in their noise alone; those of many replications are measured each."""
    asked = []
    measured = timing.time_estimators
    monkeypatch.setattr(timing, "time_estimators", lambda *a: (asked.append(a), measured(*a))[1])
    words = ["filter=[ekf_vmf]", "scenario.steps=2", "noise=vmf", "noise.sigma_deg=5,6"]
    for reps, count in ((2, 1), (100, 2)):
        asked.clear()
        cells = compose_cells([*words, f"reps={reps}"])
        timings = timing.Timings({"c": 1})
        rows = [timings.measure(c, {"ekf_vmf": key}) for c, key in zip(cells, "ab")]
        assert len(asked) == count
        assert (rows[0]["a"] == rows[1]["b"]) == (count == 1)
        assert timings.known == rows[0] | rows[1] | {"c": 1}
        assert timings.measure(cells[0], {"ekf_vmf": "c"}) == {}


def test_one_thread_sees_libraries_that_are_loaded_later(monkeypatch):
    found = []
    monkeypatch.setattr(threads, "ThreadpoolController", lambda: found.append(1) or Limits())
    threads._controller.cache_clear()
    for _ in range(2):
        threads.one_thread()
    assert len(found) == 1
    monkeypatch.setitem(sys.modules, "a_module_of_this_test", sys)
    threads.one_thread()
    assert len(found) == 2
    threads._controller.cache_clear()


class Limits:
    def limit(self, limits):
        assert limits == 1
