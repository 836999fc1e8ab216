"""Rules of estimators and filters."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from aoabench.config.adopt import as_estimator
from aoabench.loaded import DataFile
from aoabench.roles import Estimator, Noise, Scenario
from aoabench.testing import dependence, laws, worlds
from aoabench.testing.rules import NotTried, Result, Rule, confirmed, examined
from aoabench.testing.settings import setting
from aoabench.testing.trial import Trial
from aoabench.types import Batch, Estimates, Outcome, Reason


def check_estimator(
    estimator: Estimator | Callable[..., Estimates],
    scenario: Scenario | None = None,
    noise: Noise | None = None,
    skip: Mapping[str, str] | None = None,
) -> list[Result]:
    """Return what came out of trying each rule of estimators; raise ContractError, an
    AssertionError, if one is broken.

    The estimator is tried in three replications of 16 steps of the scenario with the noise; by
    default of a shipped pair in which it fits. Positions are compared to a hundred-thousandth of
    the distance from the anchors: let an iteration end at a shorter step than that. `skip` maps
    rules that cannot hold to the reason: {"permuted": "its number names one anchor"}. Raises
    UserError for an estimator that fits nowhere and for an unknown rule.
    """
    adopted = as_estimator(estimator, "estimator")
    trial = Trial(adopted, *setting(adopted, scenario, noise))
    return confirmed(adopted.label, examined(RULES, trial, skip or {}))


def members(trial: Trial) -> str:
    """What is wrong with the optional members of an estimator."""
    e = trial.estimator
    for name, value in (
        ("by_replication", e.by_replication), ("heard_only", e.heard_only), ("causal", e.causal),
    ):  # fmt: skip
        if not isinstance(value, bool):
            return f"{name} is {value!r}, which is not True or False"
    if not isinstance(e.needs, frozenset):
        return f"needs is {e.needs!r}, which is not a frozenset of names"
    if e.uses is not None and not (isinstance(e.uses, frozenset) and e.uses <= worlds.QUANTITIES):
        names = ", ".join(sorted(worlds.QUANTITIES))
        return f"uses is {e.uses!r}, which is not None or a frozenset of names among {names}"
    if not isinstance(e.label, str):
        return f"label is {e.label!r}, which is not a text"
    return files(e.files)


def files(found: object) -> str:
    """What is wrong with the member `files` of a plug-in."""
    if isinstance(found, str) or not isinstance(found, tuple | list):
        return f"files is {found!r}, which is not a tuple of paths"
    for one in found:
        path = one.path if isinstance(one, DataFile) else one
        if not isinstance(path, Path) or not path.is_file():
            return f"files has {path!r}, which is not the pathlib.Path of an existing file"
    return ""


def values(trial: Trial) -> str:
    """What is wrong with shapes, outcomes, reasons and positions."""
    _ = trial.found
    return wrong_values(trial.raw(trial.batch))


def wrong_values(found: Estimates) -> str:
    """What is wrong with outcomes, reasons and positions of estimates, as returned."""
    lost = np.isin(found.outcome, (Outcome.FAILED, Outcome.REJECTED))
    if np.isfinite(found.position[lost]).any():
        return "a fix that is FAILED or REJECTED has a position"
    nowhere = ~lost & ~np.isfinite(found.position[..., :2]).all(axis=-1)
    if nowhere.any():
        return f"{int(nowhere.sum())} fixes claim a position and give NaN"
    if found.reason is not None and np.any((found.reason == Reason.NONE) != (found.outcome == 0)):
        return "the reason is NONE where a fix is not OK, or another one where it is"
    return ""


def covariances(trial: Trial) -> str:
    """What is wrong with the covariances."""
    if trial.found.covariance is None:
        raise NotTried("it states no covariances")
    return wrong_covariances(trial.found)


def wrong_covariances(found: Estimates) -> str:
    """What is wrong with the covariances of estimates."""
    assert found.covariance is not None
    ok = found.outcome == Outcome.OK
    flat = bool(np.isnan(found.position[ok][:, 2]).all())
    P = found.covariance[ok][:, : 2 if flat else 3, : 2 if flat else 3]
    some = np.isfinite(P)
    known = some.all(axis=(-1, -2))
    if not np.array_equal(some.any(axis=(-1, -2)), known):
        return "a covariance is partly NaN"
    P = P[known]
    if not np.allclose(P, np.swapaxes(P, -1, -2), rtol=1e-5, atol=1e-12):
        return "a covariance is not symmetric"
    spread = np.linalg.eigvalsh(P)
    negative = spread[..., 0] < -1e-9 * np.abs(spread[..., -1])
    if negative.any():
        return f"a covariance has the negative eigenvalue {spread[negative][0, 0]:.3g} m^2"
    return ""


def missing(trial: Trial) -> str:
    """What goes wrong where measurements are missing."""
    batch, rng = trial.batch, np.random.default_rng(5)
    first = np.arange(batch.azimuth.shape[2]) == 0
    cases = {
        "an anchor that measures nothing": worlds.without(batch, first),
        "measurements missing here and there": worlds.without(
            batch, rng.random(batch.azimuth.shape) < 0.3
        ),
        "steps without any measurement": worlds.without(
            batch, (np.arange(batch.azimuth.shape[1]) % 3 == 1)[:, None]
        ),
    }
    if "elevation" not in trial.estimator.needs:
        cases["azimuths alone"] = worlds.without(batch, True, "elevation", "elevation_sigma")
    return "; ".join(filter(None, (_survives(trial, *case) for case in cases.items())))


def _survives(trial: Trial, words: str, batch: Batch) -> str:
    """What goes wrong with a batch that `words` describe."""
    try:
        trial.run(batch)
        problem = wrong_values(trial.raw(batch))
    except Exception as error:  # the user's code can raise anything
        problem = f"it raises {type(error).__name__}: {error}"
    return f"with {words}, {problem}" if problem else ""


def nothing(trial: Trial) -> str:
    """Whether a fix without any measurement claims a position."""
    if "prior" in trial.estimator.needs:
        raise NotTried("a filter predicts")
    found = trial.run(worlds.without(trial.batch, True))
    claimed = ~np.isin(found.outcome, (Outcome.FAILED, Outcome.REJECTED))
    return f"{int(claimed.sum())} of {claimed.size} such fixes have a position" * bool(
        claimed.any()
    )


def poles(trial: Trial) -> str:
    """What goes wrong at elevations of +-90 deg."""
    return _survives(trial, "an anchor's elevation at +-90 deg", worlds.at_poles(trial.batch))


RULES = (
    Rule("members", "each optional member has the type that aoabench.Estimator states", members),
    Rule(
        "values",
        "arrays of the shapes of aoabench.Estimates; a fix is FAILED or REJECTED and NaN, or has "
        "finite x and y; its reason is NONE if and only if it is OK",
        values,
    ),
    Rule("covariances", "covariances are symmetric and have no negative eigenvalue", covariances),
    Rule(
        "missing",
        "NaN means not measured: each fix has a position from the rest, or an outcome",
        missing,
    ),
    Rule("nothing", "a fix without any measurement is FAILED or REJECTED", nothing),
    Rule("repeatable", "random numbers come from `streams` alone", dependence.repeatable),
    Rule(
        "untouched",
        "all estimators get the same arrays, which stay as they are",
        dependence.untouched,
    ),
    Rule(
        "uninformed",
        "only an estimator that needs the truth may know it (`needs`)",
        dependence.uninformed,
    ),
    Rule("unused", "estimates depend on no measurements that `uses` leaves out", dependence.unused),
    Rule(
        "replications",
        "a replication depends on nothing but itself, its anchors, rotations and streams",
        dependence.replications,
    ),
    Rule(
        "moving_anchors",
        "anchors may differ from step to step: anchors.at(k)",
        dependence.moving_anchors,
    ),
    Rule("heard", "with heard_only, anchors that measure nothing change nothing", dependence.heard),
    Rule(
        "causal", "an estimate uses no later measurements, or `causal` is False", dependence.causal
    ),
    Rule("sendable", "an estimator can be pickled, for worker processes", dependence.sendable),
    Rule("permuted", "an estimator must not depend on the order of the anchors", laws.permuted),
    Rule("shifted", "positions move with the world", laws.shifted),
    Rule("turned", "positions turn with the world", laws.turned),
    Rule("rotated", "positions rotate with the world", laws.rotated),
    Rule("azimuths", "azimuths are subtracted modulo 360 deg", laws.azimuths),
    Rule("poles", "at a pole there is no azimuth: a position from the rest, or an outcome", poles),
)
