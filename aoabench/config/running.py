"""The options of a run from a config: the nodes runner, store and until."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path, PurePath
from typing import Any

from aoabench.cell import RunnerOptions, Until
from aoabench.errors import BadValue, Mistakes, UserError, check_number, did_you_mean

MOST_REPS = 1_000_000  # of a config; the command line may ask for more


def runner_options(plain: Mapping[str, Any], typed: set[str]) -> RunnerOptions:
    """The options of a run; `typed`: the keys that the user's own command line sets.

    Raises UserError for unknown keys and values that are not allowed, and for a config that reaches
    beyond the working folder or this machine.
    """
    found = _read(plain)
    _check_reach(found, typed)
    return replace(found, out=_expanded(found.out))


def _read(plain: Mapping[str, Any]) -> RunnerOptions:
    """The options, as a config has them."""
    runner = tuple(
        f.name for f in dataclasses.fields(RunnerOptions) if f.name not in ("steps", "until")
    )
    until = tuple(f.name for f in dataclasses.fields(Until))
    nodes: dict[str, dict[str, Any]] = {}
    mistakes = Mistakes()
    for path, known in (("runner", runner), ("store", ("steps",)), ("until", until)):
        node = plain.get(path)
        if not isinstance(node, dict):
            raise BadValue(path, node, "keys " + ", ".join(known))
        for key in node:
            if key not in known:
                hint = did_you_mean(key, known, path=f"{path}.") or f"; allowed: {', '.join(known)}"
                mistakes.note(UserError(f"{path}.{key}: unknown key{hint}"))
        nodes[path] = {key: value for key, value in node.items() if key in known}
    goal, wanted = nodes["until"], None
    if goal.get("metric") is not None:
        wanted = mistakes.tried(Until, **goal)
    for key in ("se", "relative_se"):
        if goal.get("metric") is None and goal.get(key) is not None:
            mistakes.note(
                UserError(
                    f"until.{key}={goal[key]} is not allowed without until.metric; "
                    "allowed: together with a metric, e.g. until.metric=rmse_3d_m"
                )
            )
    if "out" not in nodes["runner"]:
        mistakes.note(UserError("runner.out: missing; allowed: the path of a folder"))
        mistakes.check()
    found = mistakes.tried(RunnerOptions, **nodes["runner"], **nodes["store"], until=wanted)
    mistakes.check()
    assert found is not None
    return found


def _expanded(folder: str) -> str:
    """The folder with the home folder in place of a leading ~; one that is called ~ gets its full
    name, because Arrow too takes ~ for a home folder.
    """
    found = os.path.expanduser(folder)
    return os.path.abspath(found) if str(PurePath(found)).startswith("~") else found


def _check_reach(runner: RunnerOptions, typed: set[str]) -> None:
    """Raise UserError if a config, not the command line, names a folder outside the working folder
    or another machine, or very many replications.

    Data from a scheduler are unpickled, so its owner could run code on this machine.
    """
    out = PurePath(runner.out)
    if "runner.out" not in typed and (
        out.is_absolute()
        or ".." in out.parts
        or runner.out.startswith("~")
        or not Path(out).resolve().is_relative_to(Path.cwd().resolve())  # by a link
    ):
        allowed = (
            "a folder below the working folder, "
            "or any folder given as runner.out=... on the command line"
        )
        raise BadValue("runner.out", runner.out, allowed)
    if "until.max_reps" not in typed and runner.until:
        check_number("until.max_reps", runner.until.max_reps, least=1, most=MOST_REPS)
    own = (
        runner.address in (None, os.environ.get("DASK_SCHEDULER_ADDRESS"))
        or "runner.address" in typed
    )
    if not own:
        allowed = (
            "runner.address=... on the command line, "
            "or the environment variable DASK_SCHEDULER_ADDRESS"
        )
        raise BadValue("runner.address", runner.address, allowed)
    for name, file in runner.tls.items():
        if file is not None and f"runner.{name}" not in typed:
            raise BadValue(f"runner.{name}", file, f"runner.{name}=... on the command line")
