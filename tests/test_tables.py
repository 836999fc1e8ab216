"""Tables of runs that mix what does not look alike."""

import pandas as pd

import aoabench


def test_a_parameter_may_be_a_number_in_one_scenario_and_a_list_in_another(tmp_path):
    for scenario, noise, estimator in (
        ("ble_room", "ble_multipath", "estimator=[rssi_anchor]"),
        ("indoor_map", "ofdm_crlb", "filter=[ekf_aoa]"),
    ):
        short = {"ble_room": "packets=2", "indoor_map": "route=[[17.5,24.5],[25,24.5]]"}[scenario]
        aoabench.run(
            f"scenario={scenario}",
            f"scenario.{short}",
            f"noise={noise}",
            estimator,
            "reps=2",
            out=tmp_path,
        )
    cells = pd.read_parquet(tmp_path / "cells.parquet").set_index("scenario")
    assert cells.loc["ble_room", "scenario.height_m"] == "1.0"
    assert cells.loc["indoor_map", "scenario.height_m"] == "[1.0, 2.0]"
    assert len(aoabench.load(tmp_path)) == 4
