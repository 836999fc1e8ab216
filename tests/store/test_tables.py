"""Tables of runs that mix what does not look alike."""

import pandas as pd

import aoabench


def test_a_parameter_may_be_a_number_in_one_scenario_and_a_list_in_another(tmp_path):
    for scenario, noise, estimator in (
        ("ble_room", "ble_multipath", "estimator=[rssi_anchor]"),
        ("indoor_map", "ofdm_crlb", "filter=[ekf_aoa]"),
    ):
        more = ["scenario.packets=2"] if scenario == "ble_room" else []
        aoabench.run(
            f"scenario={scenario}", f"noise={noise}", estimator, *more, "reps=2", out=tmp_path
        )
    cells = pd.read_parquet(tmp_path / "cells.parquet").set_index("scenario")
    assert cells.loc["ble_room", "scenario.height_m"] == "1.0"
    assert cells.loc["indoor_map", "scenario.height_m"] == "[1.0, 2.0]"
    assert len(aoabench.load(tmp_path)) == 4
