"""Every shipped preset obeys the rules of its role (aoabench.testing), but for those that it cannot
obey, with the reason.

A particle filter has few particles here, and an iteration ends at a shorter step than usual, so
that positions are compared and not the ends of iterations.
"""

from dataclasses import fields, replace

import pytest

from aoabench.config.compose import compose_cells
from aoabench.config.presets import options
from aoabench.testing import check_estimator, check_noise, check_scenario, worlds
from aoabench.testing.noises import usual_scenario
from aoabench.testing.trial import Trial
from tests.golden.cells import with_every_noise

ESTIMATORS = [(group, name) for group in ("filter", "estimator") for name in options(group)]
AXES = "sigma points lie along the axes of a Cholesky factor, which does not turn with the world"
BOXES = "the boxes around the ellipses lie along the world's axes"
ORDER = "its number names one anchor"
PRINTED = "as printed: wrong where an azimuth jumps"
WORLD = "as printed: from the world's x axis"
ROOM = "the walls of the room do not turn"
FOLDED = "as printed: elevations are not folded at the poles"
CANNOT = {
    "discrepancy": {"turned": BOXES},
    "ml_arctan": {"azimuths": PRINTED},
    "ml_atan2": {"azimuths": PRINTED},
    "wcg_as_printed": {"turned": WORLD, "rotated": WORLD, "azimuths": PRINTED},
    **{f"single_anchor_{i}": {"permuted": ORDER} for i in (1, 2, 3)},
    **{name: {"turned": AXES} for name in options("filter") if name.startswith("ukf_")},
}
NOISES = {"ble_multipath": {"rotated": ROOM}, "ae_normal": {"ranges": FOLDED}, "ofdm_crlb": {"ranges": FOLDED}}  # fmt: skip


def setting(name):
    """The scenario and noise to try an estimator in."""
    if any(part in name for part in ("anchor", "discrepancy")):
        return ["scenario=ble_room", "noise=ble_multipath", "scenario.packets=2"]
    if any(part in name for part in ("toa", "wcg")):
        return ["scenario=square_track_upright", "noise=ofdm_crlb"]
    return ["scenario=square_track_upright", f"noise={'ae_flip' if '_ae_' in name else 'vmf'}"]


def tried(group, name):
    """The estimator of a preset with its scenario and noise."""
    cell = compose_cells([*setting(name), f"{group}=[{name}]"])[0]
    finer = {"particles": 200, "tolerance_m": 1e-9}
    known = {f.name for f in fields(cell.estimators[name])}
    changed = {key: value for key, value in finer.items() if key in known}
    return replace(cell.estimators[name], **changed), cell.scenario, cell.noise


@pytest.mark.parametrize(("group", "name"), ESTIMATORS)
def test_estimators(group, name):
    check_estimator(*tried(group, name), skip=CANNOT.get(name))


@pytest.mark.parametrize(("group", "name"), ESTIMATORS)
def test_estimators_state_what_they_use(group, name):
    """All that they need, and nothing that changes no estimate."""
    trial = Trial(*tried(group, name))
    uses = trial.estimator.uses
    assert uses is not None
    assert trial.estimator.needs & worlds.QUANTITIES <= uses
    if "delay" not in trial.noise.offers():
        uses -= {"delay"}
    for quantity in uses:
        assert trial.apart(trial.found, trial.run(worlds.other(trial.batch, quantity))), quantity


@pytest.mark.parametrize("name", [n for n in options("noise") if n != "recorded"])
@pytest.mark.parametrize("room", ["track", "room"])
def test_noises(name, room):
    cell = with_every_noise("ble_room")[name]
    place = usual_scenario() if room == "track" else replace(cell.scenario, packets=4)
    check_noise(cell.noise, place, skip=NOISES.get(name))


@pytest.mark.parametrize("name", [n for n in options("scenario") if n != "recorded"])
def test_scenarios(name):
    check_scenario(with_every_noise(name)["vmf"].scenario)


def test_what_cannot_hold_does_not():
    """The reasons above are real: these rules are broken."""
    for name in ("wcg_as_printed", "single_anchor_1", "ukf_vmf", "ml_atan2", "discrepancy"):
        group = "filter" if name in options("filter") else "estimator"
        with pytest.raises(AssertionError) as error:
            check_estimator(*tried(group, name))
        broken = {one.rule for one in error.value.results if one.problem}
        assert broken == set(CANNOT[name]), name
