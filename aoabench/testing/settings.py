"""The simulations in which plug-ins are tried."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

from aoabench.config.compose import compose_cells
from aoabench.errors import UserError
from aoabench.roles import Estimator, Noise, Scenario

_SETTINGS = {  # scenario and noise: overrides of each; the first in which an estimator fits counts
    ("square_track_upright", "vmf"): [],
    ("ble_room", "ble_multipath"): ["scenario.packets=2"],
    ("square_track_upright", "ofdm_crlb"): [],
}


@cache
def shipped(scenario: str, noise: str) -> tuple[Scenario, Noise]:
    """A shipped scenario and a shipped noise, small where they can be."""
    words = [f"scenario={scenario}", f"noise={noise}", "estimator=[ls_lines]"]
    cell = compose_cells([*words, *_SETTINGS.get((scenario, noise), [])])[0]
    return cell.scenario, cell.noise


def _candidates(scenario: Scenario | None, noise: Noise | None) -> Iterator[tuple[Scenario, Noise]]:
    for names in _SETTINGS:
        place, errors = shipped(*names)
        yield scenario or place, noise or errors


def setting(
    estimator: Estimator, scenario: Scenario | None, noise: Noise | None
) -> tuple[Scenario, Noise]:
    """The scenario and the noise to try an estimator in, where not given ones in which it fits;
    raises UserError if it fits in none.
    """
    problem: UserError | None = None
    for place, errors in _candidates(scenario, noise):
        try:
            estimator.check(place, errors)
        except UserError as error:
            problem = problem or error
            continue
        return place, errors
    tried = ", ".join(f"{place} with {noise}" for place, noise in _SETTINGS)
    where = "the given scenario and noise" if scenario and noise else f"in any of {tried}"
    raise UserError(
        f"{estimator.label} does not fit {where}: it {problem}; state a scenario and a noise"
    )
