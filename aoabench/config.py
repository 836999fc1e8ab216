"""Composed YAML to validated objects, and every message about a bad one.

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
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from aoabench.store import flatten
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
        raise UserError(f"{path}: a mapping with _target_ is needed here, got keys {', '.join(map(str, node)) or 'none'}")
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
    cfg: Any, choices: Mapping[str, Any], *, overrides: Sequence[str] = (), extra: Mapping[str, Any] | None = None
) -> Cell:
    """Validate one composed job (a DictConfig) and make its objects. Call it where Hydra is initialised.

    `choices` are Hydra's runtime choices, `overrides` what the command line says (the only place that may name
    plugins), `extra` further estimators given as objects. Raises UserError for everything that can be known before a
    run.
    """
    from omegaconf import OmegaConf
    from omegaconf.errors import OmegaConfBaseException

    raw: dict[str, Any] = OmegaConf.to_container(cfg, resolve=False)  # type: ignore[assignment]
    try:
        plain: dict[str, Any] = OmegaConf.to_container(cfg, resolve=True, throw_on_missing=True)  # type: ignore[assignment]
    except OmegaConfBaseException as error:
        raise UserError(_first_line(error)) from None
    for key in plain:
        if key not in _TOP_LEVEL:
            raise UserError(f"{key}: unknown key{did_you_mean(str(key), _TOP_LEVEL) or '; allowed: ' + ', '.join(_TOP_LEVEL)}")
    plugins = _plugins(overrides)
    if list(plain.get("plugins") or []) != list(plugins):
        raise UserError(f"plugins={plain.get('plugins')}: plugins can only be given on the command line, never in a file")
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
        changed=_changed(raw),
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
                raise UserError(f"{path}.{key}: unknown key{did_you_mean(key, known) or '; allowed: ' + ', '.join(known)}")
    return RunnerOptions(**node, **store)


def _import_plugins(plugins: Sequence[str]) -> None:
    if plugins and os.getcwd() not in sys.path:
        sys.path.insert(0, os.getcwd())
    for name in plugins:
        try:
            importlib.import_module(name)
        except ImportError as error:
            raise UserError(f"plugins=[{name}]: cannot be imported from here ({error})") from None


def _changed(raw: Mapping[str, Any]) -> dict[str, Any]:
    """Estimators' parameters, dotted, whose values differ from their presets' own."""
    from hydra import compose
    from omegaconf import OmegaConf

    changed: dict[str, Any] = {}
    for group in ("filter", "estimator"):
        names = list(raw.get(group) or {})
        if not names:
            continue
        preset = compose("config", overrides=[f"{group}=[{','.join(names)}]"])
        default = dict(flatten(OmegaConf.to_container(preset[group], resolve=False), group))
        for key, value in flatten(raw[group], group):
            if key not in default or default[key] != value:
                changed[key] = value
    return changed


# --- composing with Hydra ---------------------------------------------------------------------------------------------


def options(group: str, config_dir: str | None = None) -> dict[str, str]:
    """Presets of a config group with the one-line description that heads each file."""
    found = {}
    for root in (shipped("configs"), *([Path(config_dir)] if config_dir else [])):
        for file in sorted((root / group).glob("*.yaml")):
            head = file.read_text(encoding="utf-8").splitlines()
            lines = [line[1:].strip() for line in head if line.startswith("#") and "@package" not in line]
            found.setdefault(file.stem, lines[0] if lines else "")
    return found


def compose_cells(
    overrides: Sequence[str],
    *,
    config_dir: str | None = None,
    plugins: Sequence[str] = (),
    extra: Mapping[str, Any] | None = None,
) -> list[Cell]:
    """The cells of a (multi)run given as command-line overrides; commas and the experiment's own sweep expand."""
    from hydra import compose
    from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
    from hydra.core.override_parser.overrides_parser import OverridesParser

    overrides = list(overrides) + ([f"plugins=[{','.join(plugins)}]"] if plugins else [])
    with hydra_initialised(config_dir), explained(overrides, config_dir):
        parser = OverridesParser.create()
        plain = [o.input_line for o in parser.parse_overrides(overrides) if not o.is_sweep_override()]
        base = compose("config", overrides=plain, return_hydra_config=True)
        sweep = [f"{key}={value}" for key, value in (base.hydra.sweeper.params or {}).items()]
        cells = []
        for job in BasicSweeper.split_arguments(parser.parse_overrides([*sweep, *overrides]), None)[0]:
            cfg = compose("config", overrides=job, return_hydra_config=True)
            choices = dict(cfg.hydra.runtime.choices)
            cells.append(build(without_hydra(cfg), choices, overrides=job, extra=extra))
        return cells


def without_hydra(cfg: Any) -> Any:
    from omegaconf import OmegaConf, open_dict

    cfg = OmegaConf.create(cfg)
    with open_dict(cfg):
        del cfg["hydra"]
    return cfg


@contextmanager
def hydra_initialised(config_dir: str | None = None) -> Iterator[None]:
    """Hydra's compose API over the shipped configs, a user's own appended to the search path."""
    from hydra._internal.hydra import Hydra
    from hydra._internal.utils import create_config_search_path
    from hydra.core.config_search_path import SearchPathQuery
    from hydra.core.global_hydra import GlobalHydra
    from hydra.core.singleton import Singleton
    from hydra.version import setbase

    refuse_foreign_hydra(config_dir)
    before = Singleton.get_state()
    GlobalHydra.instance().clear()
    setbase("1.3")
    path = create_config_search_path(str(shipped("configs")))
    if config_dir:
        path.prepend("command-line", f"file://{Path(config_dir).resolve()}", SearchPathQuery(provider="schema"))
    Hydra.create_main_hydra2(task_name="aoabench", config_search_path=path)
    try:
        yield
    finally:
        Singleton.set_state(before)


def refuse_foreign_hydra(config_dir: str | None) -> None:
    """Raise UserError if a config from outside sets anything under `hydra` but the sweeper's params.

    Read before Hydra starts, because Hydra's own callbacks run code before ours.
    """
    import yaml

    if config_dir is None:
        return
    root = Path(config_dir)
    if not root.is_dir():
        raise UserError(f"--config-dir={config_dir}: no such folder")
    if (root / "hydra").exists():
        raise UserError(f"--config-dir={config_dir}: a folder 'hydra' is not allowed in it")
    for file in sorted([*root.rglob("*.yaml"), *root.rglob("*.yml")]):
        text = file.read_text(encoding="utf-8", errors="replace")
        try:
            nodes = list(yaml.safe_load_all(text))
        except yaml.YAMLError as error:
            raise UserError(f"{file}: not valid YAML: {_first_line(error)}") from None
        bad = [line for line in text.splitlines() if line.startswith("#") and "@package" in line and "hydra" in line]
        for node in nodes:
            bad += list(_foreign_settings(node))
        if bad:
            raise UserError(f"{file}: {bad[0].strip()!r} is not allowed; a config may only set hydra.sweeper.params")


def _foreign_settings(node: Any) -> Iterator[str]:
    if not isinstance(node, dict):
        return
    for key, value in node.items():
        name = str(key)
        if name == "defaults":
            for entry in value if isinstance(value, list) else [value]:
                text = " ".join(map(str, entry)) if isinstance(entry, dict) else str(entry)
                if "hydra" in text:
                    yield f"defaults: {text}"
        elif name == "plugins":
            yield "plugins"
        elif name == "hydra":
            inside = value if isinstance(value, dict) else {"": value}
            for leaf, _ in flatten(inside, "hydra"):
                if not leaf.startswith("hydra.sweeper.params"):
                    yield leaf
        elif name.startswith("hydra."):
            yield name


@contextmanager
def explained(overrides: Sequence[str], config_dir: str | None = None) -> Iterator[None]:
    """Turn Hydra's and OmegaConf's exceptions into one clear line."""
    from hydra.errors import HydraException
    from omegaconf.errors import OmegaConfBaseException

    try:
        yield
    except UserError:
        raise
    except (HydraException, OmegaConfBaseException) as error:
        raise UserError(_explain(error, overrides, config_dir)) from None
    except ValueError as error:  # Hydra's own, of a group set to something that is no name: noise=null
        if not any(o.partition("=")[0] in GROUPS for o in overrides):
            raise
        given = " ".join(o for o in overrides if o.partition("=")[0] in GROUPS)
        raise UserError(f"{given}: {_first_line(error)}") from None


def _explain(error: Exception, overrides: Sequence[str], config_dir: str | None) -> str:
    from hydra.errors import MissingConfigException, OverrideParseException

    if isinstance(error, OverrideParseException):
        return f"{error.override!r} cannot be read: {_first_line(error)}"
    missing = getattr(error, "missing_cfg_file", None)
    if isinstance(error, MissingConfigException) and missing:
        group, _, name = str(missing).rpartition("/")
        known = list(getattr(error, "options", None) or options(group, config_dir))
        hint = did_you_mean(name, known)
        return f"{group or 'config'}={name!r}: unknown preset{hint or ';'} allowed: {', '.join(known) or 'none'}"
    text = str(error)
    for override in overrides:
        key = override.partition("=")[0].lstrip("+~")
        if f"'{key}'" in text or f"full_key: {key}" in text:
            return f"{override}: {_about_key(key, config_dir)}"
    return _first_line(error)


def _about_key(key: str, config_dir: str | None) -> str:
    """Why a key given on the command line does not exist."""
    head, _, rest = key.partition(".")
    if head in ("filter", "estimator") and rest:
        name = rest.partition(".")[0]
        if name in options(head, config_dir):
            return f"no such key, or {head} {name!r} is not selected: {head}=[{name}]" + did_you_mean(key, known_keys(name, head))
        return f"unknown {head} {name!r}{did_you_mean(name, options(head, config_dir))}"
    known = known_keys()
    return f"unknown key {key!r}" + (did_you_mean(key, known) or "; `aoabench run --cfg job` shows the keys")


def known_keys(preset: str | None = None, group: str = "filter") -> list[str]:
    """Dotted keys of the default config, with one preset selected if named."""
    from hydra import compose
    from hydra.core.global_hydra import GlobalHydra
    from omegaconf import OmegaConf

    if not GlobalHydra.instance().is_initialized():
        with hydra_initialised():
            return known_keys(preset, group)
    cfg = compose("config", overrides=[f"{group}=[{preset}]"] if preset else [])
    keys = [key for key, _ in flatten(OmegaConf.to_container(cfg, resolve=False))]
    return [*keys, *GROUPS]


def _first_line(error: Exception) -> str:
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return lines[0] if lines else type(error).__name__
