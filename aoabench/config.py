"""Plain composed YAML to validated objects, and every message about a bad one.

A `_target_` is resolved by the few lines below and never by Hydra: its real module must lie in one of our plug-in
packages, or in a package that the user named on the command line (`plugins=[...]`).
"""

from __future__ import annotations

import dataclasses
import difflib
import hashlib
import importlib
import json
import os
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from aoabench.types import BadValue, UserError, check_number

PLUG_INS = tuple(f"aoabench.{room}" for room in ("scenarios", "noise", "models", "filters", "estimators"))
GROUPS = ("scenario", "noise", "filter", "estimator", "runner", "experiment")
_TOP_LEVEL = ("scenario", "noise", "filter", "estimator", "runner", "store", "reps", "seed", "plugins")


def shipped(folder: str) -> Path:
    """Where `configs` or `experiments` lie: inside the installed package, or beside it in a checkout."""
    package = Path(__file__).resolve().parent
    inside = package / folder
    return inside if inside.is_dir() else package.parent / folder


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
            lines = [line[1:].strip() for line in head if line.startswith("#") and "@package" not in line]
            found.setdefault(file.stem, lines[0] if lines else "")
    return found


# --- from YAML nodes to objects ---------------------------------------------------------------------------------------


def resolve(target: object, path: str, plugins: Sequence[str] = ()) -> type:
    """The class that a `_target_` names, or UserError if it is not one that a config may name."""
    allowed = f"a dataclass in {', '.join(PLUG_INS)}, or in a package listed in plugins=[...] on the command line"
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
        raise UserError(f"{key}={target!r}: {module_name} has no {name!r}{did_you_mean(name, vars(module))}")
    if not (isinstance(found, type) and dataclasses.is_dataclass(found)) or name.startswith("_"):
        raise BadValue(key, target, allowed)
    if not _within(found.__module__, (*PLUG_INS, *plugins)):
        raise BadValue(key, target, allowed)
    return found


def _within(module: str, packages: Iterable[str]) -> bool:
    return any(module == p or module.startswith(p + ".") for p in packages)


def construct(node: Any, path: str, plugins: Sequence[str] = ()) -> Any:
    """The object that a plain YAML node describes; mappings need a `_target_`, lists and scalars stay as they are."""
    if isinstance(node, list):
        return [construct(item, f"{path}[{i}]", plugins) for i, item in enumerate(node)]
    if not isinstance(node, dict):
        return node
    if "_target_" not in node:
        raise UserError(
            f"{path}: a mapping with _target_ is needed here, got keys {', '.join(map(str, node)) or 'none'}"
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
        if f.init and f.name not in arguments and f.default is f.default_factory is dataclasses.MISSING
    ]
    if missing:
        raise UserError(f"{path}.{missing[0]}: missing, {cls.__name__} needs it")
    try:
        return cls(**arguments)
    except BadValue as error:
        raise BadValue(f"{path}.{error.key}", error.value, error.allowed) from None
    except (TypeError, ValueError) as error:
        raise UserError(f"{path}: {error}") from None


# --- one cell of an experiment ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class RunnerOptions:
    """How to run: never part of what is computed."""

    out: str
    n_jobs: int = -1
    backend: str = "loky"
    chunk: int | None = None
    steps: bool = False

    def __post_init__(self) -> None:
        check_number("runner.n_jobs", self.n_jobs, least=-1, integer=True)
        if self.n_jobs == 0:
            raise BadValue("runner.n_jobs", 0, "an integer >= 1, or -1 for all cores")
        check_number("runner.chunk", self.chunk, least=1, integer=True, optional=True)
        if self.backend not in ("loky", "threading", "sequential"):
            raise BadValue("runner.backend", self.backend, "one of loky, threading, sequential")
        if not isinstance(self.out, str) or not self.out.strip():
            raise BadValue("runner.out", self.out, "the path of a folder")
        if not isinstance(self.steps, bool):
            raise BadValue("store.steps", self.steps, "true or false")


@dataclass(frozen=True)
class Cell:
    """One scenario with one noise and the estimators to compare: objects, and the plain config they came from."""

    scenario_name: str
    noise_name: str
    scenario: Any
    noise: Any
    estimators: Mapping[str, Any]
    seed: int
    reps: int
    runner: RunnerOptions
    config: Mapping[str, Any]
    changed: Mapping[str, Any] = field(default_factory=dict)  # estimators' parameters that differ from their presets
    swept: tuple[str, ...] = ()  # dotted parameters that the command line sets
    experiment: str | None = None
    plugins: tuple[str, ...] = ()

    @property
    def id(self) -> str:
        """Short name of the cell: scenario, noise, seed and changed parameters decide it; estimators join in."""
        parts = [self.config["scenario"], self.config["noise"], self.seed, self.scenario_name, self.noise_name]
        return digest([*parts, dict(self.changed)])[:12]


def digest(value: Any) -> str:
    """Hexadecimal hash of a plain value, equal for equal content."""
    text = json.dumps(value, sort_keys=True, separators=(",", ":"), default=str)
    return hashlib.blake2b(text.encode(), digest_size=20).hexdigest()


def build(
    plain: Mapping[str, Any],
    choices: Mapping[str, Any],
    *,
    overrides: Sequence[str] = (),
    changed: Mapping[str, Any] | None = None,
    extra: Mapping[str, Any] | None = None,
) -> Cell:
    """Validate one composed and resolved job and make its objects.

    `choices` names the presets chosen, `overrides` what the command line says (the only place that may name plugins),
    `changed` the estimators' parameters that differ from their presets, `extra` further estimators given as objects.
    Raises UserError for everything that can be known before a run.
    """
    for key in plain:
        if key not in _TOP_LEVEL:
            raise UserError(
                f"{key}: unknown key{did_you_mean(str(key), _TOP_LEVEL) or '; allowed: ' + ', '.join(_TOP_LEVEL)}"
            )
    plugins = _plugins(overrides)
    if list(plain.get("plugins") or []) != list(plugins):
        raise UserError(
            f"plugins={plain.get('plugins')}: plugins can only be given on the command line, never in a file"
        )
    _import_plugins(plugins)
    check_number("reps", plain.get("reps"), least=1, integer=True)
    check_number("seed", plain.get("seed"), least=0, integer=True)
    runner = _runner(plain)
    for group in ("scenario", "noise"):
        if not plain.get(group):
            raise UserError(f"{group}: none chosen; allowed: {', '.join(options(group))}")
    scenario = construct(plain["scenario"], "scenario", plugins)
    noise = construct(plain["noise"], "noise", plugins)
    estimators: dict[str, Any] = {}
    for group in ("filter", "estimator"):
        for name, node in (plain.get(group) or {}).items():
            if name in estimators:
                raise UserError(f"{group}.{name}: the name is taken by a filter; every estimator needs its own")
            estimators[name] = construct(node, f"{group}.{name}", plugins)
            if not callable(estimators[name]):
                raise UserError(f"{group}.{name}: {type(estimators[name]).__name__} is not an estimator")
            _check_fit(f"{group}.{name}", estimators[name], scenario)
    estimators.update(extra or {})
    if not estimators:
        choices_text = ", ".join((*options("filter"), *options("estimator"))) or "none"
        raise UserError(f"filter=[], estimator=[]: one must be given, e.g. 'filter=[ekf_vmf]'; allowed: {choices_text}")
    return Cell(
        scenario_name=str(choices.get("scenario")),
        noise_name=str(choices.get("noise")),
        scenario=scenario,
        noise=noise,
        estimators=estimators,
        seed=plain["seed"],
        reps=plain["reps"],
        runner=runner,
        config={k: plain.get(k) for k in ("scenario", "noise", "filter", "estimator", "seed")},
        changed=dict(changed or {}),
        swept=tuple(o.partition("=")[0].lstrip("+") for o in overrides if "." in o.partition("=")[0]),
        experiment=choices.get("experiment"),
        plugins=plugins,
    )


def _plugins(overrides: Sequence[str]) -> tuple[str, ...]:
    """The packages that `plugins=[...]` on the command line names."""
    import yaml

    for override in overrides:
        key, _, value = override.partition("=")
        if key.lstrip("+") == "plugins":
            names = yaml.safe_load(value) or []
            names = names if isinstance(names, list) else [names]
            for name in names:
                if not isinstance(name, str) or not all(part.isidentifier() for part in name.split(".")):
                    raise BadValue("plugins", value, "a list of importable packages, e.g. plugins=[my_estimators]")
            return tuple(names)
    return ()


def _check_fit(path: str, estimator: Any, scenario: Any) -> None:
    """Refuse, before the run, a filter on a scenario without motion."""
    if hasattr(estimator, "measurement") and getattr(scenario, "motion", None) is None:
        raise UserError(f"{path}: a filter needs a scenario with a motion model; {type(scenario).__name__} has none")


def _runner(plain: Mapping[str, Any]) -> RunnerOptions:
    node, store = plain.get("runner") or {}, plain.get("store") or {}
    for path, given, known in (("runner", node, ("out", "n_jobs", "backend", "chunk")), ("store", store, ("steps",))):
        for key in given:
            if key not in known:
                raise UserError(
                    f"{path}.{key}: unknown key{did_you_mean(key, known) or '; allowed: ' + ', '.join(known)}"
                )
    return RunnerOptions(**node, **store)


def _import_plugins(plugins: Sequence[str]) -> None:
    if plugins and os.getcwd() not in sys.path:
        sys.path.insert(0, os.getcwd())
    for name in plugins:
        try:
            importlib.import_module(name)
        except ImportError as error:
            raise UserError(f"plugins=[{name}]: cannot be imported from here ({error})") from None
