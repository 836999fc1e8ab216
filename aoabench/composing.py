"""Composing with Hydra: overrides to cells, what a config from outside may set, Hydra's errors in
one clear line.

Only Hydra's compose API is used: no callbacks, launchers, logging configuration or reruns of
Hydra's own, whose `_target_`s would run code before ours could look at them.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from aoabench.config import GROUPS, Cell, build, did_you_mean, options, parse_plugins
from aoabench.store import flatten, shipped
from aoabench.types import UserError


def compose_cells(
    overrides: Sequence[str],
    *,
    config_dir: str | None = None,
    plugins: Sequence[str] = (),
    extra: Mapping[str, Any] | None = None,
    sweep: bool = True,
) -> list[Cell]:
    """The cells of a (multi)run given as command-line overrides; commas and the experiment's own
    sweep expand.

    Without `sweep` there is one cell, and a comma is the user's mistake. Raises UserError for every
    mistake.
    """
    from hydra import compose
    from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
    from hydra.core.global_hydra import GlobalHydra
    from hydra.core.override_parser.overrides_parser import OverridesParser

    overrides = list(overrides) + ([f"plugins=[{','.join(plugins)}]"] if plugins else [])
    allowed = parse_plugins(overrides)
    with hydra_initialised(config_dir), explained(overrides, config_dir):
        parser = OverridesParser.create(config_loader=GlobalHydra.instance().config_loader())
        parsed = parser.parse_overrides(overrides)
        for override in parsed:
            _refuse_hydra(str(override.input_line))
            if override.is_sweep_override() and not sweep:
                raise UserError(
                    f"{override.input_line}: several values are a sweep; "
                    "add -m, or brackets for one list"
                )
        typed = [str(o.key_or_group) for o in parsed]
        plain = [str(o.input_line) for o in parsed if not o.is_sweep_override()]
        jobs = [plain]
        if sweep:
            base = compose("config", overrides=plain, return_hydra_config=True)
            own = [f"{key}={value}" for key, value in (base.hydra.sweeper.params or {}).items()]
            for line in own:
                _refuse_hydra(line)
                if parse_plugins([line]):
                    raise UserError(
                        f"{line}: only plugins=[...] on the command line can name plugins"
                    )
            jobs = BasicSweeper.split_arguments(parser.parse_overrides([*own, *overrides]), None)[0]
        if not jobs:
            raise UserError(
                f"{' '.join(overrides)}: the sweep is empty; "
                "allowed: at least one value for each key"
            )
        cells = []
        for job in jobs:
            cfg = compose("config", overrides=job, return_hydra_config=True)
            cells.append(_cell(cfg, job, typed, allowed, extra, config_dir))
    if len({cell.runner for cell in cells}) > 1:
        raise UserError("runner, store and until cannot be swept: the cells of one run share them")
    return cells


def show(
    overrides: Sequence[str],
    config_dir: str | None = None,
    resolve: bool = False,
    package: str = "",
    sweep: bool = False,
) -> str:
    """The composed config as YAML, or one dotted part of it; of a `sweep` what all its jobs have in
    common.
    """
    from hydra import compose
    from hydra.core.global_hydra import GlobalHydra
    from hydra.core.override_parser.overrides_parser import OverridesParser
    from omegaconf import OmegaConf

    with hydra_initialised(config_dir), explained(overrides, config_dir):
        for override in overrides:
            _refuse_hydra(override)
        parsed = OverridesParser.create(GlobalHydra.instance().config_loader()).parse_overrides(
            list(overrides)
        )
        plain = [str(o.input_line) for o in parsed if not (sweep and o.is_sweep_override())]
        cfg = compose("config", overrides=plain)
        part = OmegaConf.select(cfg, package) if package else cfg
        if part is None:
            raise UserError(f"--package={package}: no such part of the config")
        return (
            OmegaConf.to_yaml(part, resolve=resolve) if OmegaConf.is_config(part) else f"{part}\n"
        )


def _cell(
    cfg: Any,
    job: Sequence[str],
    typed: Sequence[str],
    plugins: Sequence[str],
    extra: Mapping[str, Any] | None,
    config_dir: str | None,
) -> Cell:
    """The cell of one composed job."""
    from omegaconf import OmegaConf
    from omegaconf.errors import OmegaConfBaseException

    node = OmegaConf.create({key: cfg._get_node(key) for key in cfg if key != "hydra"})
    try:
        plain: Any = OmegaConf.to_container(node, resolve=True, throw_on_missing=True)
    except OmegaConfBaseException as error:
        key = getattr(error, "full_key", None)
        raise UserError(f"{key}: {_first_line(error)}" if key else _first_line(error)) from None
    raw: Any = OmegaConf.to_container(node, resolve=False)
    choices = dict(cfg.hydra.runtime.choices)
    changed = _changed(raw, plain, config_dir)
    return build(
        plain, choices, overrides=job, typed=typed, plugins=plugins, changed=changed, extra=extra
    )


def _changed(
    raw: Mapping[str, Any], plain: Mapping[str, Any], config_dir: str | None
) -> dict[str, Any]:
    """Estimators' parameters, dotted, whose values differ from their presets' own."""
    from hydra import compose
    from omegaconf import OmegaConf

    given = {
        group: raw[group] for group in ("filter", "estimator") if isinstance(raw.get(group), dict)
    }
    presets = {
        group: [n for n in nodes if n in options(group, config_dir)]
        for group, nodes in given.items()
    }
    cfg = compose(
        "config", overrides=[f"{group}=[{','.join(names)}]" for group, names in presets.items()]
    )
    default = dict(flatten(OmegaConf.to_container(cfg, resolve=False)))
    resolved = dict(flatten(plain))
    return {
        key: resolved.get(key, value)
        for key, value in flatten(given)
        if key and (key not in default or default[key] != value)
    }


# --- Hydra, kept to composing ---------------------------------------------------------------------


@contextmanager
def hydra_initialised(config_dir: str | None = None) -> Iterator[None]:
    """Hydra's compose API over the shipped configs, a user's own (checked) appended to the search
    path.
    """
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
        path.prepend(
            "command-line",
            f"file://{Path(config_dir).resolve()}",
            SearchPathQuery(provider="schema"),
        )
    Hydra.create_main_hydra2(task_name="aoabench", config_search_path=path)
    try:
        yield
    finally:
        Singleton.set_state(before)


def _refuse_hydra(override: str) -> None:
    """Raise UserError for an override that reaches Hydra's own node, or a file that was not looked
    at.
    """
    key, _, value = override.partition("=")
    parts = [part.strip(" +~/") for part in key.replace("@", " ").replace(":", " ").split()]
    if any(part.split(".")[0].split("/")[0] == "hydra" for part in parts):
        raise UserError(
            f"{override}: nothing under hydra can be set; a sweep is written as -m KEY=VALUE,VALUE"
        )
    if parts and "." not in parts[0] and (".." in value or "${" in value):
        raise UserError(f"{override}: the name of a preset is needed; allowed: see `aoabench list`")


def refuse_foreign_hydra(config_dir: str | None) -> None:
    """Raise UserError if a config from outside sets anything under `hydra` but the sweeper's
    params, or plugins.

    Read before Hydra starts; links are followed, as Hydra follows them. Files outside the config
    groups are not meant for us, but Hydra could reach them: they only have to leave `hydra` alone.
    """
    if config_dir is None:
        return
    root = Path(config_dir)
    if not root.is_dir():
        raise UserError(
            f"--config-dir={config_dir}: no such folder; "
            f"allowed: a folder with {', '.join(GROUPS)} in it"
        )
    if (root / "hydra").exists() or (root / "hydra").is_symlink():
        raise UserError(f"--config-dir={config_dir}: a folder 'hydra' is not allowed in it")
    for folder, _, files in os.walk(root, followlinks=True):
        place = Path(folder).relative_to(root).parts
        for name in sorted(files):
            if name.endswith((".yaml", ".yml")):
                _check_file(Path(folder) / name, place[0] if place and place[0] in GROUPS else None)


def _check_file(file: Path, group: str | None) -> None:
    """Raise UserError for what a file may not hold; `group` is the config group that it is in, if
    any.
    """
    import yaml

    allowed = "a config may only set hydra.sweeper.params, and no plugins"
    try:
        text = file.read_text(encoding="utf-8")
        nodes = list(yaml.safe_load_all(text))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        if group is None:  # nothing that Hydra could compose
            return
        raise UserError(f"{file}: not plain YAML: {_first_line(error)}") from None
    for line in text.splitlines():
        words = line.strip().lstrip("#").split()
        if (
            line.strip().startswith("#")
            and words[:1] == ["@package"]
            and words[1:] not in (["_global_"], ["_group_"])
        ):
            raise UserError(
                f"{file}: {line.strip()!r} is not allowed; allowed: # @package _global_"
            )
    for node in nodes:
        for bad in _foreign_settings(node):
            if group or "hydra" in bad:
                raise UserError(f"{file}: {bad!r} is not allowed; {allowed}")
    if group is None:
        return
    if file.stem in options(group):
        raise UserError(f"{file}: {group} {file.stem!r} is a shipped preset; choose another name")
    if group in ("filter", "estimator"):
        keys = [key for node in nodes if isinstance(node, dict) for key in node]
        if keys != [file.stem]:
            raise UserError(
                f"{file}: holds {', '.join(map(str, keys)) or 'nothing'}; "
                f"allowed: one key, {file.stem!r}"
            )


def _foreign_settings(node: Any) -> Iterator[str]:
    """What a document sets and must not: at the top level, and in its defaults list."""
    if not isinstance(node, dict):
        return
    for key, value in node.items():
        name = str(key)
        if name == "defaults":
            for entry in value if isinstance(value, list) else [value]:
                target, chosen = (
                    next(iter(entry.items())) if isinstance(entry, dict) and entry else (entry, "")
                )
                words = str(target).split()
                plain = words[-1] if words else ""
                group = plain.lstrip("/").partition("/")[0]
                text = f"{target}: {chosen}" if chosen else str(target)
                inside = group in GROUPS or "/" not in plain
                if not inside or any(mark in text for mark in ("hydra", "@", "..", "${")):
                    yield f"defaults: {text}"
        elif name.split(".")[0] in ("plugins", "hydra") and name != "hydra":
            yield name
        elif name == "hydra":
            yield from _foreign_hydra(value)


def _foreign_hydra(node: Any) -> Iterator[str]:
    for leaf, value in flatten(node, "hydra"):
        parts = leaf.split(".")
        key = ".".join(parts[3:]).lstrip("+~ ")
        swept = parts[:3] == ["hydra", "sweeper", "params"] and len(parts) > 3
        if (
            not swept
            or key.split(".")[0].split("/")[0].split("@")[0] in ("hydra", "plugins")
            or "@" in key
        ):
            yield leaf
        elif isinstance(value, dict | list):
            yield f"{leaf}: {value}"


# --- one clear line -------------------------------------------------------------------------------


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
    except (
        ValueError,
        TypeError,
        AssertionError,
    ) as error:  # Hydra's own: noise=null, range(1,5,0)
        raise UserError(
            f"{' '.join(overrides)}: cannot be composed: {_first_line(error)}"
        ) from None


def _explain(error: Exception, overrides: Sequence[str], config_dir: str | None) -> str:
    from hydra.errors import MissingConfigException, OverrideParseException

    if isinstance(error, OverrideParseException):
        return f"{error.override!r} cannot be read: {_first_line(error)}"
    missing = getattr(error, "missing_cfg_file", None)
    if isinstance(error, MissingConfigException) and missing:
        group, _, name = str(missing).rpartition("/")
        known = list(getattr(error, "options", None) or options(group, config_dir))
        hint = did_you_mean(name, known)
        return (
            f"{group or 'config'}={name!r}: unknown preset{hint or ';'} "
            f"allowed: {', '.join(known) or 'none'}"
        )
    text = str(error)
    for override in overrides:
        key = override.partition("=")[0].lstrip("+~")
        if f"'{key}'" in text or f"full_key: {key}" in text:
            chosen = [
                o.partition(",")[0] for o in overrides if o.startswith("scenario=")
            ]  # the first of a sweep
            return f"{override}: {_about_key(key, chosen, config_dir)}"
    return f"{' '.join(overrides)}: {_first_line(error)}"


def _about_key(key: str, chosen: Sequence[str], config_dir: str | None) -> str:
    """Why a key given on the command line does not exist; `chosen` are the overrides that name a
    scenario.
    """
    head, _, rest = key.partition(".")
    if head in ("filter", "estimator") and rest:
        name = rest.partition(".")[0]
        if name in options(head, config_dir):
            hint = did_you_mean(key, [k for k in known_keys(name, head) if k != key])
            return f"no such key, or {head} {name!r} is not selected: {head}=[{name}]{hint}"
        return f"unknown {head} {name!r}{did_you_mean(name, options(head, config_dir))}"
    hint = did_you_mean(key, [k for k in known_keys(chosen=chosen) if k != key])
    return f"unknown key {key!r}{hint or '; `aoabench run --cfg job` shows the keys'}"


def known_keys(
    preset: str | None = None, group: str = "filter", chosen: Sequence[str] = ()
) -> list[str]:
    """Dotted keys of the default config, with one preset and what is `chosen`; call it where Hydra
    is initialised.
    """
    from hydra import compose
    from omegaconf import OmegaConf

    cfg = compose("config", overrides=[*chosen, *([f"{group}=[{preset}]"] if preset else [])])
    keys = [key for key, _ in flatten(OmegaConf.to_container(cfg, resolve=False))]
    return [*keys, *GROUPS]


def _first_line(error: Exception) -> str:
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return lines[0] if lines else type(error).__name__
