"""Composing with Hydra: overrides to cells, what a config from outside may set, Hydra's errors in one clear line."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from aoabench.config import GROUPS, Cell, build, did_you_mean, options, shipped
from aoabench.store import flatten
from aoabench.types import UserError


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
        plain = [str(o.input_line) for o in parser.parse_overrides(overrides) if not o.is_sweep_override()]
        base = compose("config", overrides=plain, return_hydra_config=True)
        sweep = [f"{key}={value}" for key, value in (base.hydra.sweeper.params or {}).items()]
        cells = []
        for job in BasicSweeper.split_arguments(parser.parse_overrides([*sweep, *overrides]), None)[0]:
            cfg = compose("config", overrides=job, return_hydra_config=True)
            cells.append(make_cell(cfg, cfg.hydra.runtime.choices, overrides=job, extra=extra))
        return cells


def make_cell(
    cfg: Any, choices: Mapping[str, Any], *, overrides: Sequence[str], extra: Mapping[str, Any] | None = None
) -> Cell:
    """The cell of one composed job (a DictConfig, its hydra node ignored); call it where Hydra is initialised."""
    from omegaconf import OmegaConf
    from omegaconf.errors import OmegaConfBaseException

    parts = {key: cfg._get_node(key) for key in cfg if key != "hydra"}
    job = OmegaConf.create(parts)
    try:
        plain: Any = OmegaConf.to_container(job, resolve=True, throw_on_missing=True)
    except OmegaConfBaseException as error:
        raise UserError(_first_line(error)) from None
    raw: Any = OmegaConf.to_container(job, resolve=False)
    return build(plain, dict(choices), overrides=overrides, changed=_changed(raw, plain), extra=extra)


def _changed(raw: Mapping[str, Any], plain: Mapping[str, Any]) -> dict[str, Any]:
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
        resolved = dict(flatten(plain[group], group))
        for key, value in flatten(raw[group], group):
            if key not in default or default[key] != value:
                changed[key] = resolved.get(key, value)
    return changed


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
            return f"no such key, or {head} {name!r} is not selected: {head}=[{name}]" + did_you_mean(
                key, known_keys(name, head)
            )
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
