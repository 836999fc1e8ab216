"""From a composed and resolved config to a validated cell."""

from __future__ import annotations

import dataclasses
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import PurePath
from typing import Any

from aoabench.cell import Cell, RunnerOptions, Until
from aoabench.config.plugins import construct, import_plugins
from aoabench.config.presets import options
from aoabench.errors import BadValue, UserError, check_number, did_you_mean

_TOP_LEVEL = (
    "scenario",
    "noise",
    "filter",
    "estimator",
    "runner",
    "store",
    "until",
    "reps",
    "seed",
    "plugins",
)


def build(
    plain: Mapping[str, Any],
    choices: Mapping[str, Any],
    *,
    keys: Sequence[str] = (),
    typed: Iterable[str] = (),
    plugins: Sequence[str] = (),
    changed: Mapping[str, Any] | None = None,
    extra: Mapping[str, Any] | None = None,
) -> Cell:
    """Validate one composed and resolved job and make its objects.

    `choices` names the presets chosen, `keys` what the job sets, `typed` the keys that the
    user's own command line sets and `plugins` the packages that it names, `changed` the estimators'
    parameters that differ from their presets, `extra` further estimators given as objects. Raises
    UserError for all that can be known before a run.
    """
    for key in plain:
        if key not in _TOP_LEVEL:
            hint = did_you_mean(str(key), _TOP_LEVEL) or "; allowed: " + ", ".join(_TOP_LEVEL)
            raise UserError(f"{key}: unknown key{hint}")
    if list(plain.get("plugins") or []) != list(plugins):
        raise UserError(
            f"plugins={plain.get('plugins')}: only plugins=[...] on the command line can name them"
        )
    import_plugins(plugins)
    check_number("reps", plain.get("reps"), least=1, most=100_000_000, integer=True)
    check_number("seed", plain.get("seed"), least=0, most=2**63 - 1, integer=True)
    runner = _runner(plain)
    _check_reach(runner, set(typed))
    for group in ("scenario", "noise"):
        if not isinstance(choices.get(group), str) or not plain.get(group):
            raise UserError(
                f"{group}={choices.get(group)}: exactly one is needed; "
                f"allowed: {', '.join(options(group))}"
            )
    scenario = _as(
        "scenario",
        construct(plain["scenario"], "scenario", plugins),
        ("truth", "prior", "known_anchors"),
    )
    plain, choices, notes = _as_recorded(plain, choices, scenario, keys)
    noise = _as("noise", construct(plain["noise"], "noise", plugins), ("sample",))
    if not isinstance(scenario.name, str) or not scenario.name:
        raise BadValue("scenario.name", scenario.name, "a text, which keys the random streams")
    estimators = _estimators(plain, plugins, scenario, choices.get("experiment"))
    for name, estimator in (extra or {}).items():
        if name in estimators:
            raise UserError(
                f"estimators[{name!r}]: a preset of this name is selected; choose another name"
            )
        estimators[name] = _as(f"estimators[{name!r}]", estimator, ("__call__",))
    for name in estimators:
        if not isinstance(name, str) or re.search(r"^\.|[/\\\x00-\x1f]", name):
            raise UserError(
                f"{name!r}: not a name for an estimator; allowed: no slashes, no dot in front"
            )
    if not estimators:
        known = ", ".join((*options("filter"), *options("estimator")))
        raise UserError(
            f"filter=[], estimator=[]: one must be given, e.g. 'filter=[ekf_vmf]'; allowed: {known}"
        )
    return Cell(
        scenario_name=choices["scenario"],
        noise_name=choices["noise"],
        scenario=scenario,
        noise=noise,
        estimators=estimators,
        seed=plain["seed"],
        reps=plain["reps"],
        runner=runner,
        config={k: plain.get(k) or None for k in ("scenario", "noise", "filter", "estimator")}
        | {"seed": plain["seed"]},
        changed=dict(changed or {}),
        swept=tuple(key for key in keys if "." in key),
        experiment=choices.get("experiment"),
        plugins=tuple(plugins),
        notes=notes,
    )


def _as_recorded(
    plain: Mapping[str, Any], choices: Mapping[str, Any], scenario: Any, keys: Sequence[str]
) -> tuple[Mapping[str, Any], Mapping[str, Any], tuple[str, ...]]:
    """The job with the recording for its noise and no more replications than it has; and lines
    about it.
    """
    if getattr(scenario, "recorded", None) is None:
        return plain, choices, ()
    notes = [*getattr(scenario, "notes", ())]
    if any(key.split(".")[0] == "noise" for key in keys):
        notes.append("noise is not used: scenario.path has the measurements")
    reps = min(plain["reps"], getattr(scenario, "replications", plain["reps"]))
    if reps < plain["reps"] and "reps" in keys:
        notes.append(f"reps={plain['reps']} is taken as {reps}: a recording is one replication")
    node = {"_target_": "aoabench.noise.recorded.Recorded"}
    return {**plain, "noise": node, "reps": reps}, {**choices, "noise": "recorded"}, tuple(notes)


def _estimators(
    plain: Mapping[str, Any], plugins: Sequence[str], scenario: Any, experiment: str | None
) -> dict[str, Any]:
    """Filters and estimators by name, each checked for what the runner will ask of it."""
    found: dict[str, Any] = {}
    for group in ("filter", "estimator"):
        nodes = plain.get(group) or {}
        if not isinstance(nodes, dict):
            raise BadValue(
                group, nodes, f"{group}=[NAME,NAME] with presets of `aoabench list {group}`"
            )
        for name, node in nodes.items():
            path = f"{group}.{name}"
            if (
                isinstance(node, dict)
                and "_target_" not in node
                and experiment
                and name in options(group)
            ):
                continue  # an experiment's setting for a preset that this run leaves out
            if name in found:
                raise UserError(
                    f"{path}: the name is taken by a filter; every estimator needs its own"
                )
            found[name] = _as(path, construct(node, path, plugins), ("__call__",))
            if (
                not isinstance(getattr(found[name], "tile", 1), int)
                or getattr(found[name], "tile", 1) < 1
            ):
                raise BadValue(f"{path}.tile", found[name].tile, "an integer >= 1")
            if hasattr(found[name], "check"):
                try:
                    found[name].check(scenario)
                except BadValue as error:
                    raise BadValue(f"{path}.{error.key}", error.value, error.allowed) from None
            if hasattr(found[name], "measurement"):
                _as(
                    f"{path}.measurement",
                    found[name].measurement,
                    ("observe", "predict", "residual"),
                )
                motion = getattr(scenario, "motion", None)
                if motion is None:
                    raise UserError(
                        f"{path}: a filter needs a scenario with a motion model; "
                        "scenario.motion is null"
                    )
                _as("scenario.motion", motion, ("matrices",))
    return found


def _as(path: str, obj: Any, needs: Sequence[str]) -> Any:
    """The object, if it has the attributes that its role needs."""
    for name in needs:
        if not hasattr(obj, name):
            raise UserError(f"{path}: {type(obj).__name__} has no {name!r}, which is needed here")
    return obj


def _runner(plain: Mapping[str, Any]) -> RunnerOptions:
    runner = tuple(
        f.name for f in dataclasses.fields(RunnerOptions) if f.name not in ("steps", "until")
    )
    until = tuple(f.name for f in dataclasses.fields(Until))
    nodes: dict[str, dict[str, Any]] = {}
    for path, known in (("runner", runner), ("store", ("steps",)), ("until", until)):
        node = plain.get(path)
        if not isinstance(node, dict):
            raise BadValue(path, node, "keys " + ", ".join(known))
        for key in node:
            if key not in known:
                raise UserError(
                    f"{path}.{key}: unknown key"
                    f"{did_you_mean(key, known) or '; allowed: ' + ', '.join(known)}"
                )
        nodes[path] = node
    if "out" not in nodes["runner"]:
        raise UserError("runner.out: missing; allowed: the path of a folder")
    goal = nodes["until"]
    if goal.get("metric") is None:
        for key in ("se", "relative_se"):
            if goal.get(key) is not None:
                raise UserError(
                    f"until.{key}={goal[key]}: of what? "
                    "allowed: until.metric=rmse_3d_m with it, say"
                )
        return RunnerOptions(**nodes["runner"], **nodes["store"])
    return RunnerOptions(**nodes["runner"], **nodes["store"], until=Until(**goal))


def _check_reach(runner: RunnerOptions, typed: set[str]) -> None:
    """Raise UserError where a config, not the command line, leads out of the working folder or to
    another machine.

    What a scheduler sends back is unpickled: whoever names it could run code here.
    """
    out = PurePath(runner.out)
    if "runner.out" not in typed and (
        out.is_absolute() or ".." in out.parts or runner.out.startswith("~")
    ):
        allowed = (
            "a folder below the working folder; "
            "elsewhere only by runner.out=... on the command line"
        )
        raise BadValue("runner.out", runner.out, allowed)
    own = (
        runner.address in (None, os.environ.get("DASK_SCHEDULER_ADDRESS"))
        or "runner.address" in typed
    )
    if not own:
        allowed = (
            "only runner.address=... on the command line, "
            "or the environment's DASK_SCHEDULER_ADDRESS"
        )
        raise BadValue("runner.address", runner.address, allowed)
