"""Plain composed YAML to validated objects, and every message about a bad one.

A `_target_` is resolved by the few lines below and never by Hydra: its real module must lie in one
of our plug-in packages, or in a package that the user named on the command line (`plugins=[...]`).
"""

from __future__ import annotations

import dataclasses
import difflib
import importlib
import math
import os
import re
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePath
from typing import Any

from aoabench.store import REPLICATIONS, digest, shipped
from aoabench.types import BadValue, UserError, check_choice, check_number

PLUG_INS = tuple(
    f"aoabench.{room}" for room in ("scenarios", "noise", "models", "filters", "estimators")
)
GROUPS = ("scenario", "noise", "filter", "estimator", "runner", "experiment")
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


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """'; did you mean X?' for a misspelt word, or nothing."""
    close = difflib.get_close_matches(word, list(known), n=1, cutoff=0.6)
    return f"; did you mean {close[0]!r}?" if close else ""


def options(group: str, config_dir: str | None = None) -> dict[str, str]:
    """Presets of a config group with the one-line description that heads each file."""
    found: dict[str, str] = {}
    for root in (shipped("configs"), *([Path(config_dir)] if config_dir else [])):
        for file in sorted((root / group).glob("*.yaml")):
            head = file.read_text(encoding="utf-8").splitlines()
            lines = [
                line[1:].strip() for line in head if line.startswith("#") and "@package" not in line
            ]
            found.setdefault(file.stem, lines[0] if lines else "")
    return found


# --- from YAML nodes to objects -------------------------------------------------------------------


def resolve(target: object, path: str, plugins: Sequence[str] = ()) -> type:
    """The class that a `_target_` names, or UserError if it is not one that a config may name."""
    allowed = (
        f"a dataclass in {', '.join(PLUG_INS)}, "
        "or in a package listed in plugins=[...] on the command line"
    )
    key = f"{path}._target_"
    if not isinstance(target, str) or not all(part.isidentifier() for part in target.split(".")):
        raise BadValue(key, target, allowed)
    module_name, _, name = target.rpartition(".")
    if not _within(module_name, (*PLUG_INS, *plugins)):
        raise BadValue(key, target, allowed)
    try:
        module = importlib.import_module(module_name)
    except ImportError as error:
        raise UserError(f"{key}={target!r} cannot be imported: {error}") from None
    found = getattr(module, name, None)
    if found is None:
        raise UserError(
            f"{key}={target!r}: {module_name} has no {name!r}{did_you_mean(name, vars(module))}"
        )
    if not (isinstance(found, type) and dataclasses.is_dataclass(found)) or name.startswith("_"):
        raise BadValue(key, target, allowed)
    if not _within(found.__module__, (*PLUG_INS, *plugins)):
        raise BadValue(key, target, allowed)
    return found


def _within(module: str, packages: Iterable[str]) -> bool:
    return any(module == p or module.startswith(p + ".") for p in packages)


def construct(node: Any, path: str, plugins: Sequence[str] = ()) -> Any:
    """The object that a plain YAML node describes; mappings need a `_target_`, lists and scalars
    stay as they are.
    """
    if isinstance(node, list):
        return [construct(item, f"{path}[{i}]", plugins) for i, item in enumerate(node)]
    if not isinstance(node, dict):
        return node
    if "_target_" not in node:
        raise UserError(
            f"{path}: a mapping with _target_ is needed here, "
            f"got keys {', '.join(map(str, node)) or 'none'}"
        )
    cls = resolve(node["_target_"], path, plugins)
    known = [f.name for f in dataclasses.fields(cls) if f.init]
    arguments = {}
    for key, value in node.items():
        if key == "_target_":
            continue
        if key not in known:
            hint = did_you_mean(str(key), known)
            raise UserError(f"{path}.{key}: unknown key{hint or '; allowed: ' + ', '.join(known)}")
        arguments[key] = construct(value, f"{path}.{key}", plugins)
    missing = [
        f.name
        for f in dataclasses.fields(cls)
        if f.init
        and f.name not in arguments
        and f.default is f.default_factory is dataclasses.MISSING
    ]
    if missing:
        raise UserError(f"{path}.{missing[0]}: missing, {cls.__name__} needs it")
    try:
        return cls(**arguments)
    except BadValue as error:
        raise BadValue(f"{path}.{error.key}", error.value, error.allowed) from None
    except (TypeError, ValueError, AttributeError, ArithmeticError) as error:
        raise UserError(f"{path}: {error}") from None


# --- one cell of an experiment --------------------------------------------------------------------


@dataclass(frozen=True)
class Until:
    """Replications until the mean of `metric` is known to a standard error: `se` in its unit, or
    relative to the mean.

    Looked at when all of the first min_reps, 1.25 min_reps, 1.25^2 min_reps ... max_reps are there,
    so that the outcome depends on the replications alone. Both errors have to be reached where both
    are given.
    """

    metric: str
    se: float | None = None
    relative_se: float | None = None
    min_reps: int = 200
    max_reps: int = 20_000

    def __post_init__(self) -> None:
        check_choice(
            "until.metric", self.metric, [c for c, kind in REPLICATIONS.items() if kind == "double"]
        )
        check_number("until.se", self.se, above=0, optional=True)
        check_number("until.relative_se", self.relative_se, above=0, optional=True)
        check_number("until.min_reps", self.min_reps, least=2, most=100_000_000, integer=True)
        check_number(
            "until.max_reps", self.max_reps, least=self.min_reps, most=100_000_000, integer=True
        )
        if self.se is self.relative_se is None:
            raise BadValue(
                "until.se",
                None,
                "a number > 0, here or for until.relative_se, where until.metric is given",
            )

    @property
    def counts(self) -> list[int]:
        """The numbers of replications at which to look, increasing; the last one is max_reps."""
        found = [self.min_reps]
        while found[-1] < self.max_reps:
            found.append(min(math.ceil(1.25 * found[-1]), self.max_reps))
        return found


@dataclass(frozen=True)
class RunnerOptions:
    """How to run: never part of what is computed."""

    out: str
    n_jobs: int = -1
    backend: str = "loky"
    chunk: int | None = None
    address: str | None = None
    steps: bool = False
    max_failed: float = 0.5
    until: Until | None = None

    def __post_init__(self) -> None:
        check_number("runner.n_jobs", self.n_jobs, least=-1, integer=True)
        if self.n_jobs == 0:
            raise BadValue("runner.n_jobs", 0, "an integer >= 1, or -1 for all cores")
        check_number("runner.chunk", self.chunk, least=1, integer=True, optional=True)
        check_number("runner.max_failed", self.max_failed, least=0, most=1)
        check_choice("runner.backend", self.backend, ("loky", "threading", "sequential", "dask"))
        if self.backend == "dask" and not _is_address(self.address):
            raise BadValue(
                "runner.address",
                self.address,
                "the scheduler's tcp://HOST:PORT (or tls://HOST:PORT)",
            )
        if self.backend != "dask" and self.address is not None:
            raise BadValue("runner.address", self.address, "null, unless runner.backend=dask")
        if not isinstance(self.out, str) or not self.out.strip():
            raise BadValue("runner.out", self.out, "the path of a folder")
        if not isinstance(self.steps, bool):
            raise BadValue("store.steps", self.steps, "true or false")


def _is_address(value: object) -> bool:
    return (
        isinstance(value, str)
        and re.fullmatch(r"(tcp|tls)://(\[[0-9a-fA-F:]+\]|[\w.-]+):\d{1,5}", value) is not None
    )


@dataclass(frozen=True)
class Cell:
    """One scenario with one noise and the estimators to compare: objects, and the plain config they
    came from.
    """

    scenario_name: str
    noise_name: str
    scenario: Any
    noise: Any
    estimators: Mapping[str, Any]
    seed: int
    reps: int
    runner: RunnerOptions
    config: Mapping[str, Any]
    changed: Mapping[str, Any] = field(
        default_factory=dict
    )  # estimators' parameters that differ from their presets
    swept: tuple[str, ...] = ()  # dotted parameters that the command line sets
    experiment: str | None = None
    plugins: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()  # lines for whoever asked for it

    @property
    def id(self) -> str:
        """Short name of the cell: scenario, noise, seed and changed parameters decide it;
        estimators join in.
        """
        parts = [
            self.config["scenario"],
            self.config["noise"],
            self.seed,
            self.scenario_name,
            self.noise_name,
        ]
        return digest([*parts, dict(self.changed)])[:12]

    @property
    def draws(self) -> str:
        """Hash of the config that the simulated data come from."""
        return digest([self.config["scenario"], self.config["noise"], self.seed])


def build(
    plain: Mapping[str, Any],
    choices: Mapping[str, Any],
    *,
    overrides: Sequence[str] = (),
    typed: Iterable[str] = (),
    plugins: Sequence[str] = (),
    changed: Mapping[str, Any] | None = None,
    extra: Mapping[str, Any] | None = None,
) -> Cell:
    """Validate one composed and resolved job and make its objects.

    `choices` names the presets chosen, `overrides` the job's settings, `typed` the keys that the
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
    plain, choices, notes = _as_recorded(plain, choices, scenario, overrides)
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
        swept=tuple(
            o.partition("=")[0].lstrip("+") for o in overrides if "." in o.partition("=")[0]
        ),
        experiment=choices.get("experiment"),
        plugins=tuple(plugins),
        notes=notes,
    )


def _as_recorded(
    plain: Mapping[str, Any], choices: Mapping[str, Any], scenario: Any, overrides: Sequence[str]
) -> tuple[Mapping[str, Any], Mapping[str, Any], tuple[str, ...]]:
    """The job with the recording for its noise and no more replications than it has; and lines
    about it.
    """
    if getattr(scenario, "recorded", None) is None:
        return plain, choices, ()
    notes = [*getattr(scenario, "notes", ())]
    keys = [override.partition("=")[0].lstrip("+") for override in overrides]
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


def parse_plugins(overrides: Sequence[str]) -> tuple[str, ...]:
    """The packages that `plugins=[...]` among the user's own overrides names."""
    found: tuple[str, ...] = ()
    for override in overrides:
        key, _, value = override.partition("=")
        if key.lstrip("+") == "plugins":
            names = [name.strip(" '\"") for name in value.strip(" []").split(",") if name.strip()]
            for name in names:
                if not all(part.isidentifier() for part in name.split(".")):
                    raise BadValue(
                        "plugins",
                        value,
                        "a list of importable packages, e.g. plugins=[my_estimators]",
                    )
            found = tuple(names)
    return found


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


def import_plugins(plugins: Sequence[str]) -> None:
    """Import the user's own packages, from the working folder too; UserError for whatever they
    raise.
    """
    if plugins and os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())  # last: what is installed is found first
    for name in plugins:
        try:
            importlib.import_module(name)
        except Exception as error:  # the user's code: whatever it raises
            raise UserError(
                f"plugins=[{name}]: cannot be imported: {type(error).__name__}: {error}"
            ) from None
