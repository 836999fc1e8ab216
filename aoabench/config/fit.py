"""Whether estimators get what they need from scenario and noise, and what else would fit."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from aoabench.config import catalogue
from aoabench.errors import BadValue, Unfit
from aoabench.roles import NEEDS, Estimator, Noise, Scenario

_MOST = 12  # number of names in a message
_ADVICE = {  # parameters of a recording that may mend what it lacks
    "height": "; scenario.height_m states it",
    "several_anchors": "; scenario.window_s puts rows of nearly equal times into one fix",
}


def check_fit(
    estimators: Mapping[str, Estimator],
    scenario: Scenario,
    noise: Noise,
    choices: Mapping[str, Any],
) -> None:
    """Raise BadValue if scenario or noise lacks a property that an estimator needs.

    `estimators` by their dotted keys; `choices` are the names of the presets. The message names
    presets that fit: estimators for a recording, which cannot be changed, else scenarios or noises.
    """
    for path, estimator in estimators.items():
        try:
            estimator.check(scenario, noise)
        except Unfit as error:
            group = error.group if scenario.recorded is None else "scenario"
            rest = _instead(error, estimator, scenario, noise)
            allowed = f"{error.allowed}, which {path} needs{rest}"
            raise BadValue(group, choices[group], allowed) from None
        except BadValue as error:
            raise BadValue(f"{path}.{error.key}", error.value, error.allowed) from None


def _instead(error: Unfit, estimator: Estimator, scenario: Scenario, noise: Noise) -> str:
    """What mends an error or fits in place of the preset at fault, as the end of a message."""
    group, lacks = error.group, error.allowed
    if scenario.recorded is not None:
        found = catalogue.fitting_estimators(scenario, noise)
        advice = "".join(text for need, text in _ADVICE.items() if NEEDS[need][1] == lacks)
        some = [f"{one}=[{','.join(names)}]" for one, names in found.items() if names]
        return f"{advice}; with this recording fit {' '.join(some) or 'no shipped estimators'}"
    names = (
        catalogue.fitting_noises(scenario, estimator)
        if group == "noise"
        else catalogue.fitting_scenarios(noise, estimator)
    )
    if not names:
        return f"; no shipped {group} fits with the rest"
    more = ", ..." * (len(names) > _MOST)
    return f"; these fit: {', '.join(names[:_MOST])}{more}"
