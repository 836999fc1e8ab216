"""Rules of scenarios."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from aoabench.config.adopt import as_scenario
from aoabench.maths.geometry import Array
from aoabench.roles import NEEDS, Scenario
from aoabench.streams import ESTIMATOR, PRIOR, TRUTH, generator
from aoabench.testing.copies import sent
from aoabench.testing.estimators import files
from aoabench.testing.rules import NotTried, Result, Rule, confirmed, examined
from aoabench.types import Anchors


def check_scenario(scenario: Scenario, skip: Mapping[str, str] | None = None) -> list[Result]:
    """Return what came out of trying each rule of scenarios; raise ContractError, an
    AssertionError, if one is broken.

    `skip` maps rules that cannot hold to the reason. Raises UserError for an unknown rule.
    """
    place = Place(as_scenario(scenario, "scenario"))
    return confirmed(type(scenario).__name__, examined(RULES, place, skip or {}))


@dataclass(frozen=True)
class Place:
    """A scenario, and the true states of two replications."""

    scenario: Scenario

    def truth(self, replication: int) -> Array:
        """True states (T, n)."""
        rng = generator(1, self.scenario.name, replication, TRUTH)
        return np.asarray(self.scenario.truth(rng))

    @cached_property
    def first(self) -> Array:
        return self.truth(0)

    @cached_property
    def second(self) -> Array:
        return self.truth(1)

    def prior(self) -> tuple[Array, Array] | None:
        rng = generator(1, self.scenario.name, 0, ESTIMATOR, PRIOR)
        return self.scenario.prior(rng, self.first)


def members(p: Place) -> str:
    """What is wrong with the optional members of a scenario."""
    s = p.scenario
    if not isinstance(s.dt, int | float) or not s.dt > 0:
        return f"dt is {s.dt!r}, which is not a number of seconds > 0"
    if s.replications is not None and not (isinstance(s.replications, int) and s.replications >= 1):
        return f"replications is {s.replications!r}, which is not None or an integer >= 1"
    if not isinstance(s.shares_positions, bool):
        return f"shares_positions is {s.shares_positions!r}, which is not True or False"
    if not isinstance(s.notes, tuple) or not all(isinstance(one, str) for one in s.notes):
        return f"notes is {s.notes!r}, which is not a tuple of texts"
    if not s.offers() <= set(NEEDS):
        return f"offers() is {sorted(s.offers())}, which are not all among {', '.join(NEEDS)}"
    return files(s.files)


def anchors(p: Place) -> str:
    """What is wrong with the true anchors."""
    found = p.scenario.true_anchors
    if not isinstance(found, Anchors):
        return f"true_anchors is {type(found).__name__}, not Anchors"
    if len(found.position) != 1 or len(found.rotation) != 1:
        return f"true_anchors has {len(found.position)} replications, not one: (1, T|1, B, ...)"
    if not all(np.isfinite(array).all() for array in found.arrays.values()):
        return "an anchor's position or rotation is not finite"
    R = found.rotation
    if not np.allclose(R @ np.swapaxes(R, -1, -2), np.eye(3), rtol=0, atol=1e-9):
        return "an anchor's rotation is not orthonormal"
    return "" if np.all(np.linalg.det(R) > 0) else "an anchor's rotation is a mirror image"


def truths(p: Place) -> str:
    """What is wrong with the true states."""
    for found in (p.first, p.second):
        if found.ndim != 2 or found.shape[1] < 3 or not len(found):
            return f"truth has the shape {found.shape}, not (T, n) with n >= 3"
        if not np.isfinite(found).all():
            return "a true state is not finite"
    if p.first.shape != p.second.shape:
        return f"two replications have the shapes {p.first.shape} and {p.second.shape}"
    return ""


def repeatable(p: Place) -> str:
    """Whether two calls differ."""
    if not np.array_equal(p.first, p.truth(0)):
        return "a second call of truth with an equal generator gives other states"
    one, other = p.prior(), p.prior()
    same = (one is None) == (other is None) and (
        one is None or other is None or all(np.array_equal(a, b) for a, b in zip(one, other))
    )
    return "" if same else "a second call of prior with an equal generator gives another prior"


def times(p: Place) -> str:
    """What is wrong with the times."""
    found = np.asarray(p.scenario.times(len(p.first)))
    if found.shape != (len(p.first),):
        return f"times has the shape {found.shape}, not (T,) = {(len(p.first),)}"
    known = found[np.isfinite(found)]
    return "times decrease from step to step" if np.any(np.diff(known) < 0) else ""


def priors(p: Place) -> str:
    """What is wrong with the prior."""
    found, motion = p.prior(), p.scenario.motion
    if (found is None) != (motion is None):
        has, lacks = ("a prior", "motion") if motion is None else ("motion", "prior")
        return f"it has {has} and no {lacks}"
    if found is None or motion is None:
        raise NotTried("its fixes are independent")
    mean, cov = (np.asarray(a) for a in found)
    n = np.shape(motion.matrices(1.0)[0])[-1]
    if mean.shape != (n,) or cov.shape != (n, n):
        wanted = f"{(n,)} and {(n, n)} as its motion"
        return f"prior has the shapes {mean.shape} and {cov.shape}, not {wanted}"
    if not (np.isfinite(mean).all() and np.isfinite(cov).all()):
        return "the prior is not finite"
    return "" if _is_covariance(cov) else "the prior's covariance is not positive semidefinite"


def _is_covariance(P: Array) -> bool:
    """Whether a matrix (n, n) is symmetric and has no negative eigenvalue, up to rounding."""
    symmetric = np.allclose(P, P.T, rtol=1e-9, atol=0)
    return bool(symmetric and np.linalg.eigvalsh(P)[0] >= -1e-9 * np.abs(P).max())


def motions(p: Place) -> str:
    """What is wrong with the motion model."""
    motion = p.scenario.motion
    if motion is None:
        raise NotTried("its fixes are independent")
    one = [np.asarray(A) for A in motion.matrices(0.5)]
    dt = np.array([[0.5, 1.0, 0.0]])
    many = [np.asarray(A) for A in motion.matrices(dt)]
    for name, A, B in zip(("F", "Q"), one, many):
        if A.ndim != 2 or B.shape[-2:] != A.shape:
            shapes = f"{A.shape} for one interval and {B.shape} for intervals (1, 3)"
            return f"{name} has the shapes {shapes}"
        if not np.allclose(np.broadcast_to(B, (1, 3, *A.shape))[0, 0], A, rtol=1e-9, atol=1e-15):
            return f"{name} of an interval is another one in an array of intervals"
    return "" if _is_covariance(one[1]) else "Q is not positive semidefinite"


def hearing(p: Place) -> str:
    """What is wrong with the mask of the anchors heard."""
    found = p.scenario.hears(p.first[:, :3])
    if found is None:
        raise NotTried("all anchors are heard")
    wanted = (len(p.first), p.scenario.true_anchors.count)
    if np.shape(found) != wanted or np.asarray(found).dtype != bool:
        return (
            f"hears returns {np.asarray(found).dtype} {np.shape(found)}, not bool (T, B) = {wanted}"
        )
    return "" if np.any(found) else "no anchor hears the target at any step"


def days(p: Place) -> str:
    """What is wrong with the days."""
    found = np.asarray(p.scenario.day_of(len(p.first)))
    if found.shape != (len(p.first),) or found.dtype.kind not in "iu" or found.min() < 0:
        return f"day_of returns {found.dtype} {found.shape}, not integers (T,) >= 0"
    return ""


def bounds(p: Place) -> str:
    """Whether the target stays in its area."""
    found = p.scenario.bounds_m
    if found is None:
        raise NotTried("it has no bounds")
    low_high = np.asarray(found, dtype=float)
    if low_high.shape != (2, 2) or np.any(low_high[0] >= low_high[1]):
        return f"bounds_m is {found!r}, not the lower and the upper corner [x, y]"
    outside = np.any((p.first[:, :2] < low_high[0]) | (p.first[:, :2] > low_high[1]), axis=1)
    return f"{int(outside.sum())} of {len(outside)} true positions are out of bounds" * bool(
        outside.any()
    )


def heights(p: Place) -> str:
    """Whether the known height is the true one."""
    known = p.scenario.known_height_m
    if known is None:
        raise NotTried("its height is not known")
    off = float(np.abs(p.first[:, 2] - known).max())
    return f"known_height_m is {known:g}, but the target is up to {off:.3g} m away from it" * (
        off > 1e-6
    )


def sendable(p: Place) -> str:
    """Whether a worker process gets the same scenario."""
    again = Place(sent(p.scenario))
    same = np.array_equal(p.first, again.first)
    return "" if same else "after the way to a worker process it gives other true states"


RULES = (
    Rule("members", "each optional member has the type that aoabench.Scenario states", members),
    Rule("anchors", "true_anchors are finite Anchors with rotations", anchors),
    Rule("truths", "truth(rng) returns finite states (T, n), position first, of one shape", truths),
    Rule("repeatable", "random numbers come from the generator `rng` alone", repeatable),
    Rule("times", "times(steps) returns times (T,) s that do not decrease", times),
    Rule("priors", "a scenario has motion and a prior that fits it, or neither", priors),
    Rule("motions", "matrices(dt) gives F and Q (..., n, n) for intervals (...) s", motions),
    Rule("hearing", "hears(points) returns None or a mask (T, B)", hearing),
    Rule("days", "day_of(steps) returns the number of each step's day", days),
    Rule("bounds", "the target stays within bounds_m", bounds),
    Rule("heights", "known_height_m is the target's height", heights),
    Rule("sendable", "a scenario can be pickled, for worker processes", sendable),
)
