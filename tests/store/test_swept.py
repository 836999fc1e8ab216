"""The parameters that tell the cells of a run apart."""

import pandas as pd

from aoabench.store.swept import differing


def test_parameters_that_follow_from_the_preset_do_not_tell_cells_apart():
    frame = pd.DataFrame({
        "scenario": ["a", "a", "a", "a"],
        "noise": ["v", "v", "o", "o"],
        "noise.sigma_deg": [2.0, 5.0, None, None],
        "noise.power_dbm": [None, None, 27.0, 27.0],
        "scenario.steps": [4, 4, 4, 4],
        "filter.ekf_vmf.engine": ["auto", "auto", "numpy", "numpy"],
    })  # fmt: skip
    assert differing(frame, list(frame)) == ["noise", "noise.sigma_deg", "filter.ekf_vmf.engine"]
    alone = frame[frame["noise"] == "v"]
    assert differing(alone, list(frame)) == ["noise.sigma_deg"]
    assert differing(frame, ["noise.sigma_deg"]) == ["noise.sigma_deg"], "no preset beside it"
