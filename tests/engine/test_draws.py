"""Tiles of simulated replications: of all anchors, and of those heard at each step."""

import numpy as np
import pytest

from aoabench.config.compose import compose_cells
from aoabench.engine.block import run_block
from aoabench.engine.draws import Draws
from aoabench.engine.tiles import tile_of
from aoabench.roles import Estimator
from aoabench.types import Batch, Estimates

WORDS = ["noise=ofdm_crlb", "noise.an_sigma_m=0.5", "noise.mounting_yaw_deg=2", "filter=[ekf_aoa]"]
PLACES = {
    "route": ["scenario=indoor_map", "scenario.dt=12", "scenario.nearest=30"],
    "model": ["scenario=indoor_map_model", "scenario.steps=20", "scenario.dt=1"],
}


class Seen(Estimator):
    """Keeps its batches; answers (0, 0, 0)."""

    tile = 2

    def __init__(self, heard_only):
        self.heard_only, self.batches = heard_only, list[Batch]()

    def __call__(self, batch, scenario, streams):
        self.batches.append(batch)
        shape = batch.azimuth.shape[:2]
        return Estimates(np.zeros((*shape, 3)), None, None, np.zeros(shape, dtype=np.int8))


@pytest.mark.parametrize("place", PLACES)
def test_the_places_of_a_batch(place):
    """Every value of the batch of all anchors, and nothing else, is in the batch of those heard."""
    cell = compose_cells([*PLACES[place], *WORDS])[0]
    draws = Draws(cell.scenario, cell.noise, 1)
    truth, whole = draws.tile(4, 3)
    _, heard = draws.tile(4, 3, heard_only=True)
    count, (R, T, K) = cell.scenario.true_anchors.count, heard.azimuth.shape
    assert (count, K) == (107, 8 if place == "model" else 30)
    assert (heard.anchor_id < 0).any() == (place == "route")
    assert heard.anchor_id.shape == ((R if place == "model" else 1), T, K)
    assert whole.anchor_id is None
    names = ("azimuth", "elevation", "delay", "rssi", "azimuth_sigma", "elevation_sigma")
    for i, k in np.ndindex(R, T):
        own = heard.anchor_id[i if len(heard.anchor_id) > 1 else 0, k]
        mask = cell.scenario.hears(truth[i, k : k + 1, :3])[0]
        assert sorted(own[own >= 0]) == np.flatnonzero(mask).tolist()
        for name in (*names, "delay_sigma"):
            one, every = getattr(heard, name)[i, k], getattr(whole, name)[i, k]
            assert np.array_equal(one[own >= 0], every[own[own >= 0]])
            assert np.isnan(one[own < 0]).all()
            assert np.isnan(every[~mask]).all()
    for name, array in heard.anchors.arrays.items():
        of_all = whole.anchors.arrays[name]
        assert len(of_all) == (1 if name == "position_sigma" else R)
        assert len(array) == (1 if name == "position_sigma" and place == "route" else R)
        for i, k, j in np.ndindex(len(array), T, K):
            number = heard.numbers[min(i, len(heard.numbers) - 1), k, j]
            expected = of_all[min(i, len(of_all) - 1), 0, number]
            if number < 0:
                expected = np.eye(3) if name == "rotation" else np.zeros(3)
            assert np.array_equal(array[i, k, j], expected)
    for batch in (whole, heard):
        assert batch.layout.count == count
        for name, array in batch.layout.arrays.items():
            assert array is whole.anchors.arrays[name]
        one = batch.of(1)
        assert one.layout.position.shape == (1, 1, count, 3)
        assert np.array_equal(one.azimuth, batch.azimuth[1:2], equal_nan=True)
        for array in (*batch.arrays.values(), *batch.anchors.arrays.values(), truth):
            assert array is None or not array.flags.writeable


@pytest.mark.parametrize("heard_only", [False, True])
def test_an_estimator_gets_the_batch_that_it_takes(heard_only):
    """Also beside others, and in a tile of which not all replications are wanted."""
    cell = compose_cells([*PLACES["route"], *WORDS])[0]
    mine, other = Seen(heard_only), Seen(not heard_only)
    run_block(cell.scenario, cell.noise, {"mine": mine, "other": other}, 1, 0, 3)
    assert [batch.azimuth.shape[2] for batch in mine.batches] == [30 if heard_only else 107] * 2
    assert [batch.azimuth.shape[2] for batch in other.batches] == [107 if heard_only else 30] * 2
    mine.by_replication = True
    run_block(cell.scenario, cell.noise, {"mine": mine}, 1, 1, 2)
    again, before = mine.batches[-1], mine.batches[0]
    assert np.array_equal(again.azimuth, before.azimuth, equal_nan=True)
    assert np.array_equal(again.anchors.position, before.anchors.position)


def test_facts_about_the_input_are_those_of_all_anchors():
    """How imprecise a fix is, is measured by the extent of all known anchors."""
    cell = compose_cells([*PLACES["route"], *WORDS])[0]
    rows = [
        run_block(cell.scenario, cell.noise, {"mine": Sure(heard_only)}, 1, 0, 2)["mine"]["rows"]
        for heard_only in (False, True)
    ]
    assert rows[0]["n_imprecise"].tolist() == [0, 0]
    for column, values in rows[0].items():
        np.testing.assert_array_equal(values, rows[1][column], column)


class Sure(Seen):
    """Answers the middle with a deviation of 50 m, more than the extent of the anchors heard."""

    def __call__(self, batch, scenario, streams):
        found = super().__call__(batch, scenario, streams)
        P = np.broadcast_to(2500.0 * np.eye(3), (*found.outcome.shape, 3, 3))
        position = np.broadcast_to([80.0, 56.0, 0.0], found.position.shape)
        return Estimates(position, P, None, found.outcome)


def test_the_derived_tile_of_those_that_take_the_anchors_heard():
    cell = compose_cells(["scenario=indoor_map", *WORDS])[0]
    few, every = Seen(True), Seen(False)
    few.tile = every.tile = None
    assert tile_of(every, cell.scenario) == 2  # of 3065 steps and 107 access nodes
    assert tile_of(few, cell.scenario) == 32  # of 8 access nodes
    track = compose_cells(["scenario=square_track", "noise=vmf", "filter=[ekf_vmf]"])[0]
    assert tile_of(few, track.scenario) == tile_of(every, track.scenario) == 128
