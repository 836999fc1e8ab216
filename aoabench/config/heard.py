"""Whether the anchors measure anything, as far as that is known before a run."""

from __future__ import annotations

import numpy as np

from aoabench.errors import BadValue
from aoabench.roles import Scenario
from aoabench.streams import TRUTH, generator

_ENOUGH = 400  # number of evenly spaced steps that are looked at first


def check_heard(scenario: Scenario, seed: int) -> tuple[str, ...]:
    """Return a line to print if few steps have a measurement; raise BadValue if it is known that no
    step of any replication has one.
    """
    return remark(scenario, share_heard(scenario, seed))


def remark(scenario: Scenario, found: tuple[float, bool] | None) -> tuple[str, ...]:
    """`check_heard` for a result of `share_heard`."""
    if found is None:
        return ()
    share, certain = found
    if share == 0 and certain:
        error = scenario.unheard()
        raise BadValue(f"scenario.{error.key}", error.value, error.allowed)
    if share >= scenario.least_heard:
        return ()
    which = "" if certain else " of replication 0"
    return (
        f"scenario: an anchor measures at {100 * share:.3g} % of the steps{which}; this line is "
        f"printed below scenario.least_heard={scenario.least_heard:g}",
    )


def share_heard(scenario: Scenario, seed: int) -> tuple[float, bool] | None:
    """The share of the steps at which an anchor measures, and whether it is the same in all
    replications; None for a scenario in which all anchors measure at all steps.
    """
    tracks = scenario.tracks
    if tracks is not None:
        recorded = tracks.measured
        measured = [np.isfinite(recorded.azimuth), np.isfinite(recorded.elevation)]
        measured += [] if recorded.delay is None else [np.isfinite(recorded.delay)]
        return float(np.any(measured, axis=(0, 2)).mean()), True
    if type(scenario).hears is Scenario.hears:
        return None
    truth, other = (
        scenario.truth(generator(seed, scenario.name, replication, TRUTH)) for replication in (0, 1)
    )
    points = truth[:, :3]
    heard = scenario.hears(points[:: max(len(points) // _ENOUGH, 1)])
    if heard is not None and not heard.any():
        heard = scenario.hears(points)
    if heard is None:
        return None
    return float(heard.any(axis=1).mean()), np.array_equal(truth, other)
