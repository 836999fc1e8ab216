"""What a job on a recording runs: the recorded measurements, all tracks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from aoabench.roles import Estimator, Scenario

_MEASURED = {  # names of roles.NEEDS that a recording offers: the measurements, and their columns
    "elevation": ("elevations", "elevation"),
    "delay": ("ranges", "range"),
    "rssi": ("signal strengths", "rssi"),
    "stated_sigma": ("deviations of angles", "azimuth_sigma"),
}
_NOISE = {"_target_": "aoabench.noise.recorded.Recorded"}


def as_recorded(
    plain: Mapping[str, Any],
    choices: Mapping[str, Any],
    scenario: Scenario,
    keys: Sequence[str],
) -> tuple[Mapping[str, Any], Mapping[str, Any], tuple[str, ...]]:
    """The config, choices and notes of a job. For a recording, its noise is the recording, and its
    replications are all tracks, or the first `reps` if the job's `keys` say so.
    """
    tracks = scenario.tracks
    if tracks is None:
        return plain, choices, scenario.notes
    notes = [*scenario.notes]
    if any(key.split(".")[0] == "noise" for key in keys):
        notes.append("noise is not used: scenario.path has the measurements")
    reps = count = len(tracks.counts)
    if "reps" in keys:
        reps = min(plain["reps"], count)
        have = "one track is" if count == 1 else f"{count} tracks are"
        many = "" if count == 1 else "s"
        if reps < plain["reps"]:
            notes.append(
                f"reps={plain['reps']} is taken as {reps}: a recording of {have} "
                f"{reps} replication{many}"
            )
        elif reps < count:
            notes.append(f"reps={reps}: only the first {reps} of {count} tracks are run")
    return {**plain, "noise": _NOISE, "reps": reps}, {**choices, "noise": "recorded"}, tuple(notes)


def unused(scenario: Scenario, estimators: Mapping[str, Estimator]) -> tuple[str, ...]:
    """A note on the measurements of a recording that none of the estimators, by their dotted keys,
    uses; nothing if there are none, or an estimator does not state what it uses.
    """
    tracks, each = scenario.tracks, [one.uses for one in estimators.values()]
    if tracks is None or not each or None in each:
        return ()
    left = tracks.measured.offers().difference(*filter(None, each))
    names = [f"{name} (scenario.columns.{at})" for n, (name, at) in _MEASURED.items() if n in left]
    who = next(iter(estimators)) if len(each) == 1 else f"any of the {len(each)} methods"
    return (f"in the log, and not used by {who}: {', '.join(names)}",) if names else ()
