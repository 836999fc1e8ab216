"""What a job on a recording runs: the recorded measurements, all tracks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from aoabench.roles import Scenario

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
