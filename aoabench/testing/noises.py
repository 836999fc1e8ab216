"""Rules of noises."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from aoabench.config.adopt import as_noise
from aoabench.engine.draws import Draws
from aoabench.maths.geometry import Array, euler
from aoabench.roles import NEEDS, Noise, Scenario
from aoabench.streams import ANCHORS, MEASUREMENT, TRUTH, generator
from aoabench.testing.copies import sent, with_members
from aoabench.testing.estimators import files
from aoabench.testing.fisher import information_of
from aoabench.testing.rules import NotTried, Result, Rule, confirmed, examined
from aoabench.testing.settings import shipped
from aoabench.types import Anchors, Calibration, Measurements

INFORMATION = 0.25  # of the norm
OFF_AXES = np.array([0.13, -0.21, 0.37])  # m, from places where rounding decides on a direction


def check_noise(
    noise: Noise, scenario: Scenario | None = None, skip: Mapping[str, str] | None = None
) -> list[Result]:
    """Return what came out of trying each rule of noises; raise ContractError, an AssertionError,
    if one is broken.

    The noise is tried in the scenario, by default the shipped square_track_upright. `skip` maps
    rules that cannot hold to the reason. Raises UserError for an unknown rule.
    """
    adopted = as_noise(noise, "noise")
    sampling = Sampling(adopted, scenario or usual_scenario())
    return confirmed(type(noise).__name__, examined(RULES, sampling, skip or {}))


def usual_scenario() -> Scenario:
    """The scenario in which a noise is tried unless another is given."""
    return shipped("square_track_upright", "vmf")[0]


@dataclass(frozen=True)
class Sampling:
    """A noise, and the scenario whose measurements it draws."""

    noise: Noise
    scenario: Scenario

    @cached_property
    def truth(self) -> Array:
        """True states (T, n)."""
        found = self.scenario.truth(generator(1, self.scenario.name, 0, TRUTH))
        found.setflags(write=False)
        return found

    def sample(self, replication: int = 0, scenario: Scenario | None = None) -> Measurements:
        """The measurements (T, B) of one replication."""
        rng = generator(1, self.scenario.name, replication, MEASUREMENT)
        return self.noise.sample(rng, scenario or self.scenario, self.truth)

    @cached_property
    def found(self) -> Measurements:
        return self.sample()


def members(s: Sampling) -> str:
    """What is wrong with the optional members of a noise."""
    offers = s.noise.offers()
    if offers is not None:
        known = [need for need, (group, _) in NEEDS.items() if group == "noise"]
        if not isinstance(offers, frozenset) or not offers <= set(known):
            return f"offers() is {offers!r}, which is not None or a frozenset of {', '.join(known)}"
    if not isinstance(s.noise.calibration, Calibration | None):
        return f"calibration is {s.noise.calibration!r}, which is not None or a Calibration"
    return files(s.noise.files)


def shapes(s: Sampling) -> str:
    """What is wrong with the shapes of measurements."""
    if not isinstance(s.found, Measurements):
        return f"sample returns {type(s.found).__name__}, not Measurements"
    count = s.scenario.true_anchors.count
    if s.found.anchor_id is not None:
        count = np.shape(s.found.anchor_id)[-1]
    wanted = (len(s.truth), count)
    for name, array in s.found.arrays.items():
        if not isinstance(array, np.ndarray) or array.shape != wanted:
            return f"{name} has the shape {np.shape(array)}, not (T, B) = {wanted}"
        if array.dtype != float:
            return f"{name} has the type {array.dtype}, not float"
    return ""


def ranges(s: Sampling) -> str:
    """What is wrong with the range of angles."""
    azimuth, elevation = s.found.azimuth, s.found.elevation
    wrong = azimuth[(azimuth <= -np.pi) | (azimuth > np.pi)]
    if wrong.size:
        count = f"{wrong.size} of {azimuth.size} azimuths"
        return f"{count} are not in (-pi, pi], such as {wrong[0]:.4g} rad"
    wrong = elevation[np.abs(elevation) > np.pi / 2]
    if wrong.size:
        count = f"{wrong.size} of {elevation.size} elevations"
        return f"{count} are beyond +-pi/2, such as {wrong[0]:.4g} rad"
    return "" if np.isfinite(azimuth).any() else "no azimuth is finite"


def repeatable(s: Sampling) -> str:
    """Whether two calls differ."""
    again = s.sample()
    for name, array in s.found.arrays.items():
        if not np.array_equal(array, again.arrays[name], equal_nan=True):
            return f"a second call with an equal generator gives another {name}"
    return ""


def different(s: Sampling) -> str:
    """Whether replications are equal."""
    same = np.array_equal(s.found.azimuth, s.sample(1).azimuth, equal_nan=True)
    return "two replications have the same azimuths" if same else ""


def tiles(s: Sampling) -> str:
    """Whether a tile differs from its replications."""
    R, place = 3, s.scenario
    tile = Draws(place, s.noise, 1).simulate(range(R)).measured
    if tile.anchor_id is not None:
        raise NotTried("the noise measures the anchors heard alone in a tile")
    rng = generator(1, place.name, 2, MEASUREMENT)
    truth = place.truth(generator(1, place.name, 2, TRUTH))
    alone = s.noise.sample(rng, place, truth)
    for name, array in alone.arrays.items():
        if not np.array_equal(tile.arrays[name][2], array, equal_nan=True):
            return f"sample_tile gives another {name} than sample"
    return ""


def rotated(s: Sampling) -> str:
    """Whether angles are in the anchors' frames."""
    turn, at = euler([0.7, -0.4, 2.2]), s.scenario.true_anchors
    moved = Anchors(at.position @ turn.T, at.rotation @ turn.T, at.position_sigma)
    place = with_members(s.scenario, true_anchors=property(lambda _: moved))
    if place.hears(s.truth[:, :3]) is not None or place.wall_segments is not None:
        raise NotTried("the scenario has walls or anchors out of hearing")
    truth = s.truth.copy()
    truth[:, :3] += OFF_AXES
    one = s.noise.sample(generator(1, s.scenario.name, 0, MEASUREMENT), s.scenario, truth)
    for first in range(0, truth.shape[1] - 2, 3):
        truth[:, first : first + 3] = truth[:, first : first + 3] @ turn.T
    found = s.noise.sample(generator(1, s.scenario.name, 0, MEASUREMENT), place, truth)
    for name, array in one.arrays.items():
        off = np.abs(np.exp(1j * array) - np.exp(1j * found.arrays[name]))
        off = off if name in ("azimuth", "elevation") else np.abs(array - found.arrays[name])
        if np.nanmax(off, initial=0.0) > 1e-6 * max(1.0, np.nanmax(np.abs(array), initial=0.0)):
            return (
                f"rotating anchors and target together changes {name} by up to {np.nanmax(off):.3g}"
            )
    return ""


def known(s: Sampling) -> str:
    """What is wrong with the anchors as known."""
    name, true = s.scenario.name, s.scenario.true_anchors
    found, again = (
        s.noise.known_anchors(generator(1, name, 0, ANCHORS), s.scenario) for _ in range(2)
    )
    if not isinstance(found, Anchors) or found.count != true.count or len(found.position) != 1:
        return (
            "known_anchors does not return Anchors (1, T|1, B, ...) of all anchors of the scenario"
        )
    for key, array in found.arrays.items():
        if not np.isfinite(array).all():
            return f"{key} of a known anchor is not finite"
        if not np.array_equal(array, again.arrays[key]):
            return f"a second call with an equal generator gives another {key}"
    R = found.rotation
    if not np.allclose(R @ np.swapaxes(R, -1, -2), np.eye(3), rtol=0, atol=1e-9):
        return "a known rotation is not orthonormal"
    return ""


def offered(s: Sampling) -> str:
    """Whether the noise measures what it says."""
    offers = s.noise.offers()
    if offers is None:
        raise NotTried("it does not state what it measures")
    found = s.found.offers()
    return (
        "" if found == offers else f"offers() is {sorted(offers)}, but it measures {sorted(found)}"
    )


def information(s: Sampling) -> str:
    """Whether the Fisher information is that of the samples."""
    point = s.truth[len(s.truth) // 3, :3]
    stated = s.noise.information(point, s.scenario.true_anchors)
    if stated is None:
        raise NotTried("it states no Fisher information")
    if np.shape(stated) != (3, 3):
        return f"information returns the shape {np.shape(stated)} at one point, not (3, 3)"
    if not np.isfinite(stated).all():
        raise NotTried("the information is infinite at the point")
    sampled = information_of(s.noise, s.scenario, point)
    off = np.linalg.norm(sampled - stated) / np.linalg.norm(stated)
    if off > INFORMATION:
        ratio = np.trace(sampled) / np.trace(stated)
        return f"the samples have {ratio:.2f} times the stated information ({off:.0%} off)"
    return ""


def sendable(s: Sampling) -> str:
    """Whether a worker process gets the same noise."""
    again = Sampling(sent(s.noise), s.scenario).found
    same = np.array_equal(s.found.azimuth, again.azimuth, equal_nan=True)
    return "" if same else "after the way to a worker process it gives other azimuths"


RULES = (
    Rule("members", "each optional member has the type that aoabench.Noise states", members),
    Rule("shapes", "measurements are float arrays (T, B), or (T, K) with anchor_id", shapes),
    Rule("ranges", "azimuths lie in (-pi, pi] rad, elevations in [-pi/2, pi/2] rad", ranges),
    Rule("repeatable", "random numbers come from the generator `rng` alone", repeatable),
    Rule("different", "each replication has its own draws", different),
    Rule("tiles", "sample_tile gives the bits of sample", tiles),
    Rule("rotated", "angles are those in the anchors' frames", rotated),
    Rule("known", "known anchors are finite, orthonormal, and drawn from `rng` alone", known),
    Rule("offered", "offers() names what is measured", offered),
    Rule(
        "information",
        f"the Fisher information is that of the samples, by histograms, within {INFORMATION:.0%}",
        information,
    ),
    Rule("sendable", "a noise can be pickled, for worker processes", sendable),
)
