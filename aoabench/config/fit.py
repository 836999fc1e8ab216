"""Whether estimators get what they need from scenario and noise, and what else would fit."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

from aoabench.config import catalogue
from aoabench.errors import BadValue, Unfit
from aoabench.roles import NEEDS, Estimator, Noise, Scenario

_MOST = 12  # number of names in a message
_ADVICE = {  # parameters of a recording that may mend what it lacks
    "height": "; scenario.height_m states it",
    "motion": "; scenario.motion states how the target moves, and scenario.columns.time, or else "
    "scenario.dt from fix to fix, when",
    "several_anchors": "; scenario.window_s puts rows of nearly equal times into one fix",
}


def those_that_fit(
    estimators: Mapping[str, Estimator],
    scenario: Scenario,
    noise: Noise,
    choices: Mapping[str, Any],
    keys: Collection[str] = (),
) -> tuple[dict[str, Estimator], tuple[str, ...]]:
    """Return the estimators that run, by their dotted keys, and a line about each other one.

    In a simulated scenario all run. Those that a recording does not suit are left out if another
    one runs, unless one of the job's `keys` is at fault. Raises BadValue if scenario or noise lacks
    a property that an estimator needs; `choices` are the names of the presets. The message names
    presets that fit: estimators for a recording, which cannot be changed, else scenarios or noises.
    """
    fit, found = dict[str, Estimator](), dict[str, Unfit | BadValue]()
    for path, estimator in estimators.items():
        try:
            estimator.check(scenario, noise)
        except (Unfit, BadValue) as error:
            found[path] = error
        else:
            fit[path] = estimator
    for path, problem in found.items():
        own = isinstance(problem, BadValue) and f"{path}.{problem.key}" in keys
        if scenario.tracks is None or not fit or own:
            raise _error(path, problem, estimators[path], scenario, noise, choices) from None
    return fit, tuple(f"{path} does not run: {_why(path, one)}" for path, one in found.items())


def _error(
    path: str,
    error: Unfit | BadValue,
    estimator: Estimator,
    scenario: Scenario,
    noise: Noise,
    choices: Mapping[str, Any],
) -> BadValue:
    """The error for an estimator that does not fit, which names what does."""
    if not isinstance(error, Unfit):
        return BadValue(f"{path}.{error.key}", error.value, error.allowed)
    group = error.group if scenario.tracks is None else "scenario"
    rest = _instead(error, estimator, scenario, noise)
    if scenario.tracks is None and error.allowed == NEEDS["motion"][1]:
        rest = f", because its fixes are separate points and no track in time{rest}"
    return BadValue(group, choices[group], f"{error.allowed}, which {path} needs{rest}")


def _why(path: str, error: Unfit | BadValue) -> str:
    """Why an estimator does not run on a recording, and what may mend it."""
    if not isinstance(error, Unfit):
        return str(BadValue(f"{path}.{error.key}", error.value, error.allowed))
    needed = error.allowed.partition(", such as ")[0].replace("one ", "a recording ", 1)
    return f"it needs {needed}{_advice(error)}"


def _advice(error: Unfit) -> str:
    """The parameter of a recording that may mend what it lacks, as the end of a message."""
    return "".join(text for need, text in _ADVICE.items() if NEEDS[need][1] == error.allowed)


def _instead(error: Unfit, estimator: Estimator, scenario: Scenario, noise: Noise) -> str:
    """What mends an error or fits in place of the preset at fault, as the end of a message."""
    group = error.group
    if scenario.tracks is not None:
        found = catalogue.fitting_estimators(scenario, noise)
        some = [f"{one}=[{','.join(names)}]" for one, names in found.items() if names]
        return (
            f"{_advice(error)}; with this recording fit {' '.join(some) or 'no shipped estimators'}"
        )
    names = (
        catalogue.fitting_noises(scenario, estimator)
        if group == "noise"
        else catalogue.fitting_scenarios(noise, estimator)
    )
    if not names:
        return f"; no shipped {group} fits with the rest"
    more = ", ..." * (len(names) > _MOST)
    return f"; these fit: {', '.join(names[:_MOST])}{more}"
