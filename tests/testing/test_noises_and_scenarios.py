"""The kits of rules for noises and scenarios: good ones pass, and each rule finds what breaks it."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from aoabench import Anchors, Measurements, Noise
from aoabench.maths.geometry import in_frames, to_azel, wrap
from aoabench.models.motion import ConstantVelocity, RandomWalk
from aoabench.noise.angular import NormalAngles, VonMisesFisher
from aoabench.scenarios.square_track import SquareTrack
from aoabench.testing import ContractError, check_noise, check_scenario
from aoabench.testing.fisher import location_information
from aoabench.testing.noises import RULES as NOISE_RULES
from aoabench.testing.scenarios import RULES as SCENARIO_RULES
from aoabench.testing.settings import shipped


@dataclass(frozen=True)
class Uniform(Noise):
    """Uniform errors of azimuth and elevation within +-5 deg."""

    def sample(self, rng, scenario, truth):
        at = scenario.true_anchors
        azimuth, elevation = to_azel(*(a[0] for a in in_frames(truth[None, :, :3], *at.frames)))
        e = np.radians(rng.uniform(-5, 5, (2, *azimuth.shape)))
        return Measurements(wrap(azimuth + e[0]), np.clip(elevation + e[1], -np.pi / 2, np.pi / 2))

    def offers(self):
        return frozenset({"elevation"})


def changed(base, **members):
    return type("Changed", (base,), {"__module__": __name__, **members})


def then(function):
    """A `sample` that changes the measurements of `Uniform`."""

    def sample(self, rng, scenario, truth):
        return function(Uniform.sample(self, rng, scenario, truth), rng, scenario)

    return sample


def globally(self, rng, scenario, truth):
    """Angles in global axes, whatever the anchors' frames."""
    at = scenario.true_anchors
    upright = replace(at, rotation=np.zeros_like(at.rotation) + np.eye(3))
    local = in_frames(truth[None, :, :3], *upright.frames)
    return Measurements(*to_azel(*(a[0] for a in local)))


own = np.random.default_rng(1)
mirror = Anchors(np.zeros((4, 3)), 2 * np.broadcast_to(np.eye(3), (4, 3, 3)))
NOISES = [
    ("members", {"offers": lambda s: {"elevation"}}, "offers.. is {'elevation'}, which is not None or a frozenset"),
    ("shapes", {"sample": then(lambda m, *_: replace(m, rssi=m.azimuth[:, :2]))}, r"rssi has the shape \(64, 2\), not \(T, B\) = \(64, 4\)"),
    ("ranges", {"sample": then(lambda m, *_: replace(m, azimuth=m.azimuth % (2 * np.pi)))}, "azimuths are not in"),
    ("ranges", {"sample": then(lambda m, *_: replace(m, elevation=m.elevation + 2))}, "elevations are beyond"),
    ("repeatable", {"sample": then(lambda m, *_: replace(m, azimuth=wrap(m.azimuth + own.normal())))}, "gives another azimuth"),
    ("different", {"sample": then(lambda m, *_: replace(m, azimuth=0 * m.azimuth))}, "two replications have the same"),
    ("tiles", {"sample_tile": lambda self, rngs, place, truth: Measurements.stacked([Uniform().sample(rngs[0], place, one) for one in truth])}, "sample_tile gives another azimuth"),
    ("rotated", {"sample": globally}, "rotating anchors and target together changes azimuth"),
    ("known", {"known_anchors": lambda self, rng, place: mirror}, "a known rotation is not orthonormal"),
    ("known", {"known_anchors": lambda self, rng, place: replace(place.true_anchors, position=place.true_anchors.position + own.normal())}, "gives another position"),
    ("offered", {"offers": lambda s: frozenset({"delay"})}, r"offers\(\) is \['delay'\], but it measures \['elevation'\]"),
    ("information", {"information": lambda s, point, at: 1e4 * np.eye(3)}, "times the stated information"),
    ("sendable", {"__reduce__": lambda s: (VonMisesFisher, ())}, "worker process it gives other azimuths"),
]  # fmt: skip


def problems(check, plugin):
    with pytest.raises(ContractError) as error:
        check(plugin)
    return {one.rule: one.problem for one in error.value.results if one.problem}


def test_a_good_noise_obeys_every_rule():
    found = check_noise(Uniform())
    assert {one.rule for one in found if one.skipped} == {"information"}
    assert {rule for rule, *_ in NOISES} == {rule.name for rule in NOISE_RULES}


@pytest.mark.parametrize(("rule", "members", "words"), NOISES)
def test_each_rule_finds_the_noise_that_breaks_it(rule, members, words):
    found = problems(check_noise, changed(Uniform, **members)())
    assert rule in found
    with pytest.raises(AssertionError, match=words):
        raise AssertionError(found[rule])


@pytest.mark.parametrize("factor", [0.6, 1.5])
def test_a_wrong_information_is_found_and_the_right_one_is_not(factor):
    right = VonMisesFisher(sigma_deg=4.0)
    assert not [one for one in check_noise(right) if one.rule == "information" and one.skipped]
    stated = VonMisesFisher.information
    kind = changed(VonMisesFisher, information=lambda s, *at: factor * stated(s, *at))
    assert "information" in problems(check_noise, kind(sigma_deg=4.0))


@pytest.mark.parametrize(
    ("draw", "right"),
    [
        (lambda rng: rng.normal(0, 0.3, 20_000), 1 / 0.09),
        (lambda rng: rng.laplace(0, 0.3, 20_000), 1 / 0.09),
        (lambda rng: rng.logistic(1, 0.3, 20_000), 1 / (3 * 0.09)),
        (lambda rng: 2 + 0.3 * rng.standard_t(3, 20_000), (4 / 6) / 0.09),
    ],
    ids=["normal", "laplace", "logistic", "student"],
)
def test_information_about_the_location_of_known_distributions(draw, right):
    """Closed forms; 15 % covers sampling error (5 %) and the width of the cells, most at the peak of
    the Laplace distribution.
    """
    found = location_information(draw(np.random.default_rng(3)))
    assert found == pytest.approx(right, rel=0.15, abs=0)


def test_half_the_measurements_have_half_the_information():
    error = np.random.default_rng(3).normal(size=40_000)
    error[::2] = np.nan
    assert location_information(error) == pytest.approx(0.5, rel=0.15, abs=0)
    assert location_information(np.full(9, np.nan)) == 0


track = shipped("square_track_upright", "vmf")[0]
walk = SquareTrack.truth
SCENARIOS = [
    ("members", {"dt": property(lambda s: -1.0)}, "dt is -1.0, which is not a number of seconds > 0"),
    ("members", {"notes": "a note"}, "notes is 'a note', which is not a tuple of texts"),
    ("anchors", {"true_anchors": mirror}, "rotation is not orthonormal"),
    ("anchors", {"true_anchors": replace(mirror, rotation=-0.5 * mirror.rotation)}, "mirror image"),
    ("truths", {"truth": lambda s, rng: walk(s, rng)[:, :2]}, r"truth has the shape \(64, 2\)"),
    ("truths", {"truth": lambda s, rng: walk(s, rng) * np.nan}, "not finite"),
    ("truths", {"truth": lambda s, rng: walk(s, rng)[: rng.integers(2, 60)]}, "two replications have the shapes"),
    ("repeatable", {"truth": lambda s, rng: walk(s, own)}, "another states|other states"),
    ("repeatable", {"prior": lambda s, rng, truth: (own.normal(size=3), np.eye(3))}, "another prior"),
    ("times", {"times": lambda s, steps: -np.arange(steps)}, "times decrease"),
    ("priors", {"prior": lambda s, rng, truth: None}, "it has motion and no prior"),
    ("priors", {"motion": property(lambda s: ConstantVelocity())}, r"shapes \(3,\) and \(3, 3\), not \(6,\) and \(6, 6\)"),
    ("priors", {"prior": lambda s, rng, truth: (np.zeros(3), -np.eye(3))}, "positive semidefinite"),
    ("motions", {"motion": property(lambda s: changed(RandomWalk, matrices=lambda m, dt: (np.eye(3), np.eye(3) * np.max(dt)))())}, "shapes|another one"),
    ("hearing", {"hears": lambda s, points: np.ones(len(points))}, "hears returns float64"),
    ("days", {"day_of": lambda s, steps: np.zeros(3)}, "day_of returns"),
    ("bounds", {"bounds_m": [[0, 0], [1, 1]]}, "of 64 true positions are out of bounds"),
    ("heights", {"known_height_m": 1.5}, "known_height_m is 1.5, but the target is up to 1.5 m away"),
    ("sendable", {"__reduce__": lambda s: (SquareTrack, ("other", track.anchors, track.motion))}, "other true states"),
]  # fmt: skip


def test_a_good_scenario_obeys_every_rule():
    found = check_scenario(track)
    assert {one.rule for one in found if one.skipped} == {"hearing", "bounds", "heights"}
    assert {rule for rule, *_ in SCENARIOS} == {rule.name for rule in SCENARIO_RULES}


@pytest.mark.parametrize(("rule", "members", "words"), SCENARIOS)
def test_each_rule_finds_the_scenario_that_breaks_it(rule, members, words):
    kind = changed(SquareTrack, **members)
    fields = {"name": "own", "anchors": track.anchors, "motion": track.motion}
    place = kind.__new__(kind)
    for name, value in {**vars(track), **fields}.items():
        if name not in members:
            object.__setattr__(place, name, value)
    found = problems(check_scenario, place)
    assert rule in found
    with pytest.raises(AssertionError, match=words):
        raise AssertionError(found[rule])


def test_ranges_of_a_noise_that_does_not_fold_at_the_poles():
    tall = shipped("square_track", "vmf")[0]
    with pytest.raises(ContractError, match="elevations are beyond"):
        check_noise(NormalAngles(), tall)
    check_noise(NormalAngles(), tall, skip={"ranges": "not folded", "rotated": "at the poles"})
