"""Whether estimators get what they need from scenario and noise, and what else would fit."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from aoabench.config import catalogue
from aoabench.errors import BadValue, Unfit
from aoabench.roles import Estimator, Noise, Scenario

_MOST = 12  # number of names in a message


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
            recorded = scenario.recorded is not None
            group = "scenario" if recorded else error.group
            rest = _instead(group, recorded, estimator, scenario, noise)
            allowed = f"{error.allowed}, which {path} needs{rest}"
            raise BadValue(group, choices[group], allowed) from None
        except BadValue as error:
            raise BadValue(f"{path}.{error.key}", error.value, error.allowed) from None


def _instead(
    group: str, recorded: bool, estimator: Estimator, scenario: Scenario, noise: Noise
) -> str:
    """What fits in place of the preset of `group`, as the end of a message."""
    if recorded:
        found = catalogue.fitting_estimators(scenario, noise)
        height = "height" in estimator.needs - scenario.offers()
        advice = "; scenario.height_m states it" if height else ""
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
