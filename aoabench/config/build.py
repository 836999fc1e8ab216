"""From a composed and resolved config to a validated cell."""

from __future__ import annotations

import dataclasses
import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePath
from typing import Any

from aoabench.cell import Cell, RunnerOptions, Until
from aoabench.config.adopt import as_estimator, as_noise, as_scenario
from aoabench.config.fit import those_that_fit
from aoabench.config.heard import remark, share_heard
from aoabench.config.plugins import construct, import_plugins
from aoabench.config.presets import options
from aoabench.config.recording import as_recorded
from aoabench.errors import BadValue, UserError, check_number, did_you_mean
from aoabench.roles import Estimator, Scenario

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

_MOST_REPS = 1_000_000  # of a config; the command line may ask for more


@dataclass
class Builder:
    """Builds the cells of a sweep; cells with equal nodes of shipped classes share the objects.

    `plugins`: the packages that the command line names; `extra`: further estimators, given as
    objects. The cells keep their objects alive, so that ids of objects stay unique.
    """

    plugins: Sequence[str] = ()
    extra: Mapping[str, Any] = field(default_factory=dict)
    objects: dict[tuple[str, str], Any] = field(default_factory=dict)  # by path and node
    runners: dict[str, RunnerOptions] = field(default_factory=dict)  # by their nodes
    heard: dict[tuple[int, int | None], tuple[str, ...]] = field(default_factory=dict)

    def cell(
        self,
        plain: Mapping[str, Any],
        choices: Mapping[str, Any],
        *,
        keys: Sequence[str] = (),
        typed: Iterable[str] = (),
        changed: Mapping[str, Any] | None = None,
    ) -> Cell:
        """Validate one composed and resolved job and return its cell.

        `choices`: the presets chosen; `keys`: the keys that the job sets; `typed`: the keys that
        the user's own command line sets; `changed`: the estimators' parameters that differ from
        their presets. Raises UserError for every mistake that can be found before a run.
        """
        typed = set(typed)
        _check_top_level(plain, choices, self.plugins)
        import_plugins(self.plugins)
        runner = self._runner(plain, typed)
        if "reps" not in typed:
            check_number("reps", plain["reps"], least=1, most=_MOST_REPS, integer=True)
        scenario = self._object(plain["scenario"], "scenario", as_scenario)
        plain, choices, notes = as_recorded(plain, choices, scenario, keys)
        noise = self._object(plain["noise"], "noise", as_noise)
        estimators = self._estimators(plain, choices.get("experiment"))
        estimators |= _extra(plain, self.extra)
        notes += self._heard(scenario, plain["seed"])
        estimators, left_out = those_that_fit(estimators, scenario, noise, choices, keys)
        notes += left_out
        return Cell(
            scenario_name=choices["scenario"],
            noise_name=choices["noise"],
            scenario=scenario,
            noise=noise,
            estimators={path.partition(".")[2]: one for path, one in estimators.items()},
            seed=plain["seed"],
            reps=plain["reps"],
            runner=runner,
            config=_config(plain, estimators),
            changed=dict(changed or {}),
            swept=tuple(key for key in keys if "." in key),
            experiment=choices.get("experiment"),
            plugins=tuple(self.plugins),
            notes=notes,
        )

    def _object(self, node: Any, path: str, adopted: Callable[[Any, str], Any]) -> Any:
        """The object that a node describes, in its role; one for all cells if its classes are
        shipped ones, whose objects do not change.
        """
        if _names_class_of(self.plugins, node):
            return adopted(construct(node, path, self.plugins), path)
        key = (path, repr(node))
        if key not in self.objects:
            self.objects[key] = adopted(construct(node, path, self.plugins), path)
        return self.objects[key]

    def _runner(self, plain: Mapping[str, Any], typed: set[str]) -> RunnerOptions:
        key = repr([plain.get(group) for group in ("runner", "store", "until")])
        if key not in self.runners:
            runner = _runner(plain)
            _check_reach(runner, typed)
            self.runners[key] = replace(runner, out=_expanded(runner.out))
        return self.runners[key]

    def _heard(self, scenario: Scenario, seed: int) -> tuple[str, ...]:
        """The remark of `check_heard`; positions that are always the same are looked at once."""
        always, now = (id(scenario), None), (id(scenario), seed)
        if always in self.heard:
            return self.heard[always]
        if now not in self.heard:
            found = share_heard(scenario, seed)
            self.heard[always if found is None or found[1] else now] = remark(scenario, found)
        return self.heard.get(always) or self.heard.get(now, ())

    def _estimators(self, plain: Mapping[str, Any], experiment: str | None) -> dict[str, Estimator]:
        """Filters and estimators by their dotted keys."""
        found: dict[str, Estimator] = {}
        for group in ("filter", "estimator"):
            nodes = plain.get(group) or {}
            if not isinstance(nodes, dict):
                raise BadValue(
                    group, nodes, f"{group}=[NAME,NAME] with presets of `aoabench list {group}`"
                )
            for name, node in nodes.items():
                path = f"{group}.{name}"
                bare = isinstance(node, dict) and "_target_" not in node
                if bare and experiment and name in options(group):
                    continue  # an experiment's setting for a preset that this run leaves out
                if f"filter.{name}" in found:
                    raise UserError(
                        f"{path}: a filter has this name; "
                        "allowed: a name that no other filter or estimator has"
                    )
                found[path] = self._object(node, path, as_estimator)
        return found


def _config(plain: Mapping[str, Any], estimators: Mapping[str, Estimator]) -> dict[str, Any]:
    """The config of a cell, without the presets of estimators that do not run."""
    found = {group: plain[group] or None for group in ("scenario", "noise")}
    for group in ("filter", "estimator"):
        nodes = (plain.get(group) or {}).items()
        found[group] = {n: node for n, node in nodes if f"{group}.{n}" in estimators} or None
    return found | {"seed": plain["seed"]}


def _names_class_of(plugins: Sequence[str], node: Any) -> bool:
    """Whether a node, or one inside it, names a class that is not shipped."""
    if not plugins:
        return False
    if isinstance(node, list):
        return any(_names_class_of(plugins, item) for item in node)
    if not isinstance(node, dict):
        return False
    shipped = str(node.get("_target_", "aoabench.")).startswith("aoabench.")
    return not shipped or any(_names_class_of(plugins, item) for item in node.values())


def _check_top_level(
    plain: Mapping[str, Any], choices: Mapping[str, Any], plugins: Sequence[str]
) -> None:
    """Raise UserError for unknown keys, plugins from a file, reps, seed and missing groups."""
    for key in plain:
        if key not in _TOP_LEVEL:
            hint = did_you_mean(str(key), _TOP_LEVEL) or "; allowed: " + ", ".join(_TOP_LEVEL)
            raise UserError(f"{key}: unknown key{hint}")
    if list(plain.get("plugins") or []) != list(plugins):
        raise UserError(
            f"plugins={plain.get('plugins')}: a file must not name plug-in packages; "
            "allowed: plugins=[...] on the command line"
        )
    check_number("reps", plain.get("reps"), least=1, most=100_000_000, integer=True)
    check_number("seed", plain.get("seed"), least=0, most=2**63 - 1, integer=True)
    for group in ("scenario", "noise"):
        if not isinstance(choices.get(group), str) or not plain.get(group):
            raise UserError(
                f"{group}={choices.get(group)}: exactly one preset is needed; "
                f"allowed: {', '.join(options(group))}"
            )


def _extra(plain: Mapping[str, Any], extra: Mapping[str, Any]) -> dict[str, Estimator]:
    """Estimators given as objects, by keys `estimators.NAME`; UserError for a job without any
    preset or object as an estimator, and for invalid names.
    """
    presets = {**(plain.get("filter") or {}), **(plain.get("estimator") or {})}
    for name in extra:
        if name in presets:
            raise UserError(
                f"estimators[{name!r}]: a preset of this name is selected; choose another name"
            )
    for name in (*presets, *extra):
        if not isinstance(name, str) or re.search(r"^\.|[/\\\x00-\x1f]", name):
            raise UserError(
                f"{name!r} is not allowed as the name of an estimator; "
                "allowed: a text without slashes and without a dot as its first character"
            )
    if not presets and not extra:
        known = ", ".join((*options("filter"), *options("estimator")))
        raise UserError(
            "filter=[], estimator=[]: at least one filter or estimator must be given, "
            f"e.g. 'filter=[ekf_vmf]'; allowed: {known}"
        )
    return {f"estimators.{n}": as_estimator(e, f"estimators[{n!r}]") for n, e in extra.items()}


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
                hint = did_you_mean(key, known, path=f"{path}.") or f"; allowed: {', '.join(known)}"
                raise UserError(f"{path}.{key}: unknown key{hint}")
        nodes[path] = node
    if "out" not in nodes["runner"]:
        raise UserError("runner.out: missing; allowed: the path of a folder")
    goal = nodes["until"]
    if goal.get("metric") is None:
        for key in ("se", "relative_se"):
            if goal.get(key) is not None:
                raise UserError(
                    f"until.{key}={goal[key]} is not allowed without until.metric; "
                    "allowed: together with a metric, e.g. until.metric=rmse_3d_m"
                )
        return RunnerOptions(**nodes["runner"], **nodes["store"])
    return RunnerOptions(**nodes["runner"], **nodes["store"], until=Until(**goal))


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
        check_number("until.max_reps", runner.until.max_reps, least=1, most=_MOST_REPS)
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
