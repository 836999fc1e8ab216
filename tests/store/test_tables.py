"""Tables of runs that mix what does not look alike."""

import numpy as np
import pandas as pd

import aoabench
from aoabench.maths import statistics
from aoabench.store import fixes as fixes_module
from aoabench.store import tables
from aoabench.store.fixes import clusters
from aoabench.types import Estimates, Outcome
from tests.store import made


def test_a_parameter_may_be_a_number_in_one_scenario_and_a_list_in_another(tmp_path):
    for scenario, noise, estimator in (
        ("ble_room", "ble_multipath", "estimator=[rssi_anchor]"),
        ("indoor_map", "ofdm_crlb", "filter=[ekf_aoa]"),
    ):
        short = {"ble_room": "packets=2", "indoor_map": "route=[[17.5,24.5],[25,24.5]]"}[scenario]
        given = (f"scenario={scenario}", f"scenario.{short}", f"noise={noise}", estimator)
        aoabench.run(*given, "reps=2", out=tmp_path)
    cells = pd.read_parquet(tmp_path / "cells.parquet").set_index("scenario")
    assert cells.loc["ble_room", "scenario.height_m"] == "1.0"
    assert cells.loc["indoor_map", "scenario.height_m"] == "[1.0, 2.0]"
    assert len(aoabench.load(tmp_path)) == 4


class Choosy:
    """Answers the middle of the room, and rejects every third packet without hiding its position."""

    def __call__(self, batch, scenario, streams):
        position = np.full((*batch.azimuth.shape[:2], 3), [3.6, 4.25, 1.0])
        outcome = np.zeros(position.shape[:2], dtype=np.int8)
        outcome[:, ::3] = Outcome.REJECTED
        return Estimates(position, None, None, outcome)


def test_packets_of_one_position_are_one_cluster_in_the_summary(tmp_path):
    """Three packets at each of the room's 42 points: 42 clusters, and errors to match."""
    words = ["scenario=ble_room", "noise=ble_multipath", "scenario.packets=3"]
    frame = aoabench.run(
        *words, "estimator=[anchor_mean]", "reps=4", out=tmp_path, estimators={"choosy": Choosy()}
    )
    cell = frame["cell"].iloc[0]
    fixes = fixes_module.fixes(tmp_path, cell, "anchor_mean")
    assert fixes.place.shape == (4, 126)
    found = clusters(tmp_path, cell, "anchor_mean")
    assert len(found.fixes) == fixes.place.max() + 1 == 42
    square = np.bincount(fixes.place.ravel(), (fixes.error_xy_m.astype(float) ** 2).ravel())
    assert np.allclose(found.square_xy, square)
    summary = (
        pd.read_parquet(tmp_path / "summary.parquet").set_index("estimator").loc["anchor_mean"]
    )
    rmse = np.sqrt(square / found.fixes)
    assert summary["se_by"] == "position"
    assert np.isclose(
        summary["rmse_pooled_xy_m_se"], statistics.pooled_rmse(rmse, found.fixes).se, atol=0
    )
    some = clusters(tmp_path, cell, "anchor_mean", [0, 2])
    assert some.replications == 2
    assert np.array_equal(some.fixes, np.full(42, 6.0))
    assert clusters(tmp_path, cell, "choosy").fixes.sum() == 4 * 126 * 2 / 3


def test_a_summary_with_many_swept_parameters_warns_of_nothing(tmp_path, recwarn):
    """pandas warns of a frame whose columns come one by one from the hundredth on."""
    for cell, value in (("a", 1.0), ("b", 2.0)):
        made.cell(tmp_path, cell, ["ls"], **{f"parameter_{i}": value for i in range(120)})
    tables.collect(tmp_path)
    summary = pd.read_parquet(tmp_path / "summary.parquet").set_index("cell")
    assert list(summary["noise.parameter_119"]) == [1.0, 2.0]
    assert not [str(w.message) for w in recwarn.list]
