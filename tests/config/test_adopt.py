"""What a user's object has to have to play its role, and what is said where it does not."""

import warnings
from dataclasses import dataclass, field

import numpy as np
import pytest

import aoabench
from aoabench import Estimates, Estimator, Noise, Scenario
from aoabench.config.adopt import as_estimator, as_noise, as_scenario
from aoabench.config.compose import compose_cells
from aoabench.engine.tiles import tile_of
from aoabench.errors import BadValue, Unfit, UserError
from aoabench.noise.angular import VonMisesFisher
from aoabench.noise.ofdm import OfdmCrlb
from aoabench.roles import PlainEstimator


def middle(batch, scenario, streams):
    R, T, _ = batch.azimuth.shape
    return Estimates(np.zeros((R, T, 3)), None, None, np.zeros((R, T), dtype=np.int8))


class Middle:
    def __call__(self, batch, scenario, streams):
        return middle(batch, scenario, streams)


@dataclass(frozen=True)
class Derived(Estimator):
    def __call__(self, batch, scenario, streams):
        return middle(batch, scenario, streams)


BARE = [Middle(), middle, lambda *given: middle(*given), Derived()]


@pytest.mark.parametrize("bare", BARE, ids=["class", "function", "lambda", "derived"])
def test_a_bare_callable_is_an_estimator(bare, tmp_path):
    frame = aoabench.run("noise=vmf", "reps=3", estimators={"mine": bare}, out=tmp_path)
    assert len(frame) == 3
    assert frame["n_ok"].tolist() == [64] * 3


def test_optional_members_of_a_bare_class_are_taken_over():
    class Choosy(Middle):
        tile = 4
        needs = frozenset({"delay"})

        def check(self, scenario, noise):
            raise UserError("never")

        def trace(self, batch, scenario, streams):
            return {"x": np.zeros((1, 1))}

    found = as_estimator(Choosy(), "estimators['mine']")
    assert isinstance(found, PlainEstimator)
    assert (found.tile, found.needs) == (4, {"delay"})
    assert list(found.trace(None, None, None)) == ["x"]
    with pytest.raises(UserError, match="never"):
        found.check(None, None)


def test_a_misspelt_member_is_warned_of():
    class Misspelt(Middle):
        tiel = 4

    with pytest.warns(UserWarning, match=r"Misspelt.tiel is not used.* did you mean 'tile'"):
        as_estimator(Misspelt(), "estimators['mine']")

    @dataclass(frozen=True)
    class Room(Scenario):
        name: str = "room"
        share_positions = True

    with pytest.warns(UserWarning, match="did you mean 'shares_positions'"):
        as_scenario(Room(), "scenario")


def test_parameters_and_helpers_are_no_misspelt_members():
    @dataclass(frozen=True)
    class Fine(Estimator):
        tiles: int = 3
        height_m: float = field(default=1.0)

        def __call__(self, batch, scenario, streams):
            return middle(batch, scenario, streams)

        def refine(self):
            return self

        _tile = 3

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        as_estimator(Fine(), "estimator.fine")


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("known_anchors", "true_anchors"),
        ("same_truth", "shares_positions"),
        ("reported", "hears"),
        ("days_of", "day_of"),
        ("segments", "wall_segments"),
    ],
)
@pytest.mark.parametrize("base", [object, Scenario])
def test_old_names_of_a_scenario_name_the_new_ones(old, new, base):
    own = type("Mine", (base,), {"name": "mine", old: None})
    with pytest.raises(UserError, match=f"Mine.{old} is called {new} now"):
        as_scenario(own(), "scenario")


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: as_estimator(3, "estimator.x"), "estimator.x: int cannot be called"),
        (lambda: as_estimator(Middle, "estimator.x"), "Middle cannot be called"),
        (lambda: as_scenario(Middle(), "scenario"), "must derive from aoabench.Scenario"),
        (lambda: as_noise(Middle(), "noise"), "must derive from aoabench.Noise"),
    ],
)
def test_what_plays_no_role_is_refused(make, says):
    with pytest.raises(UserError, match=says):
        make()


@pytest.mark.parametrize("tile", [0, -1, 2.5, True, "8"])
def test_a_tile_that_makes_no_sense_is_refused(tile):
    own = type("Mine", (Middle,), {"tile": tile})
    with pytest.raises(BadValue, match=r"estimator.x.tile"):
        as_estimator(own(), "estimator.x")


def test_an_unknown_need_is_refused():
    own = type("Mine", (Middle,), {"needs": frozenset({"delays"})})
    with pytest.raises(BadValue, match="did you mean 'delay'"):
        as_estimator(own(), "estimator.x")


def test_check_takes_scenario_and_noise():
    own = type("Mine", (Middle,), {"check": lambda self, scenario: None})
    with pytest.raises(UserError, match=r"check: must take two arguments, \(scenario, noise\)"):
        as_estimator(own(), "estimator.x")


def test_needs_are_compared_with_what_is_offered(track):
    class Times(Derived):
        needs = frozenset({"delay"})

    Times().check(track, OfdmCrlb())
    with pytest.raises(Unfit, match="times of arrival"):
        Times().check(track, VonMisesFisher())

    class Silent(Noise):
        """Does not say what it measures: nothing is refused in advance."""

    Times().check(track, Silent())


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["filter=[ekf_toa_aoa]", "noise=vmf"], "noise='vmf' .* filter.ekf_toa_aoa needs"),
        (["estimator=[rssi_anchor]", "scenario=ble_room"], "noise='vmf' .*signal strengths"),
        (["filter=[ekf_vmf]", "scenario=bs_grid"], "scenario='bs_grid' .* motion model"),
        (["estimator=[ls]", "scenario=standard_room_1"], "two or more anchors"),
    ],
)
def test_what_does_not_fit_is_refused_before_the_run(words, says):
    with pytest.raises(UserError, match=says):
        compose_cells(words)


def test_a_derived_tile_fits_the_size_of_a_replication(track):
    """At most 2^20 elements an array (R, T, B), a power of two, at most 128."""
    assert tile_of(Derived(), track) == 128
    room = compose_cells(["scenario=ble_room", "noise=ble_multipath", "estimator=[anchor_mean]"])
    assert tile_of(Derived(), room[0].scenario) == 64  # of 4200 packets at 3 anchors
    large = compose_cells(["scenario=indoor_map", "noise=ofdm_crlb", "filter=[ekf_aoa]"])
    assert tile_of(Derived(), large[0].scenario) == 2  # of 3065 steps and 107 access nodes


def test_timing_calls_an_estimator_no_more_often_than_the_run(tmp_path):
    calls = []

    class Counting(Middle):
        tile = 2

        def __call__(self, batch, scenario, streams):
            calls.append(streams.replications)
            return middle(batch, scenario, streams)

    aoabench.run("reps=2", "runner.n_jobs=1", estimators={"mine": Counting()}, out=tmp_path)
    assert calls == [(0, 1), (0, 1)], "once to compute, once to time"
