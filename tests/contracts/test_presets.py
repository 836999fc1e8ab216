"""Every shipped preset by itself: it composes, runs a few replications, and keeps the estimators'
contract.
"""

from dataclasses import replace

import numpy as np
import pytest

from aoabench.config.compose import compose_cells
from aoabench.config.presets import options
from aoabench.engine.block import run_block
from aoabench.engine.draws import Draws
from aoabench.engine.tiles import estimate_tile, tile_of
from aoabench.testing.estimators import wrong_covariances, wrong_values
from aoabench.types import Outcome
from tests.golden.cells import with_every_noise

TIMES = {
    "ekf_toa_aoa",
    "ekf_toa_aoa_smoother",
    "wcg",
    "wcg_as_printed",
}  # estimators that need times of arrival
ROOM = (
    "anchor",
    "discrepancy",
)  # parts of the names of those that need a known height, and some signal strengths
ESTIMATORS = [("filter", n) for n in options("filter")] + [
    ("estimator", n) for n in options("estimator")
]


def setting(name, noise, track="square_track"):
    """The scenario and noise to try an estimator in."""
    if any(part in name for part in ROOM):
        return ["scenario=ble_room", "noise=ble_multipath", "scenario.packets=6"]
    return [f"scenario={track}", f"noise={'ofdm_crlb' if name in TIMES else noise}"]


@pytest.mark.parametrize("scenario", [s for s in options("scenario") if s != "recorded"])
@pytest.mark.parametrize("noise", [n for n in options("noise") if n != "recorded"])
def test_every_scenario_with_every_noise(scenario, noise):
    cell = with_every_noise(scenario)[noise]
    place = cell.scenario
    if scenario.startswith("indoor_map"):
        place = replace(place, dt=2)  # a thousand fields take their time
    if scenario == "indoor_map_model":
        place = replace(place, steps=60)
    block = run_block(place, cell.noise, cell.estimators, 1, 0, 3)
    assert all(np.all(np.isfinite(kinds["rows"]["rmse_3d_m"])) for kinds in block.values())
    truth, batch = Draws(place, cell.noise, 1).tile(0, 2)
    azimuth, elevation = (a[np.isfinite(a)] for a in (batch.azimuth, batch.elevation))
    assert np.all((azimuth > -np.pi) & (azimuth <= np.pi))
    if noise in ("ae_flip", "vmf", "ble_multipath"):
        assert np.all(np.abs(elevation) <= np.pi / 2)
    assert truth.shape[0] == 2


@pytest.mark.parametrize(("group", "name"), ESTIMATORS)
def test_a_whole_tile_of_every_estimator(group, name):
    """On the track past the anchors' poles, with flipped angles; test_plugins tries every rule in
    three replications, most of them with directions of Model II.
    """
    cell = compose_cells([*setting(name, "ae_flip"), f"{group}=[{name}]"])[0]
    estimator = cell.estimators[name]
    truth, e = estimate_tile(Draws(cell.scenario, cell.noise, 1), estimator, 0)
    R, T = truth.shape[:2]
    assert tile_of(estimator, cell.scenario) == R
    assert not wrong_values(e)
    if e.covariance is not None:
        assert not wrong_covariances(e)
        known = np.isfinite(
            e.covariance[..., 0, 0]
        )  # NaN: no deviation is stated or can be estimated
        assert known[e.outcome == Outcome.OK].mean() > 0.95


@pytest.mark.parametrize(("group", "name"), ESTIMATORS)
def test_every_estimator_is_better_than_no_measurement_at_all(group, name):
    """The track is 5 m wide, the room 7; whoever ignores the measurements is off by more than 3 m."""
    cell = compose_cells([*setting(name, "vmf", "square_track_upright"), f"{group}=[{name}]"])[0]
    reps = 64 if tile_of(cell.estimators[name], cell.scenario) > 8 else 8
    rows = run_block(cell.scenario, cell.noise, cell.estimators, 1, 0, reps)[name]["rows"]
    assert np.median(rows["rmse_3d_m"]) < (1.5 if group == "filter" else 3.0)


def test_the_names_that_users_type_exist():
    assert {
        f"{a}_{b}"
        for a in ("ekf", "ukf", "pf")
        for b in ("ae_nominal", "ae_fitted", "ae_adaptive", "vmf")
    } <= set(options("filter"))
    assert {"ae_normal", "ae_flip", "vmf"} <= set(options("noise"))
    assert "square_track" in options("scenario")
