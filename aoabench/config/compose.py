"""Overrides to cells, composed with Hydra.

Only Hydra's compose API is used: no callbacks, launchers, logging configuration or reruns of
Hydra's own, whose `_target_`s would run code before ours could look at them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from aoabench.cell import Cell
from aoabench.config.build import build
from aoabench.config.guard import refuse_foreign_hydra, refuse_hydra
from aoabench.config.messages import explained, first_line
from aoabench.config.overrides import Setting, jobs, read
from aoabench.config.plugins import parse_plugins
from aoabench.config.presets import options
from aoabench.errors import UserError, shorten
from aoabench.maths.digest import flatten
from aoabench.resources import shipped


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

    named = [f"plugins=[{','.join(plugins)}]"] if plugins else []
    settings = _checked([*overrides, *named], sweep)
    allowed = parse_plugins(settings)
    with hydra_initialised(config_dir), explained(settings, config_dir):
        swept = [*_own_sweep(settings), *settings] if sweep else settings
        keys = tuple(dict.fromkeys(s.key for s in swept if not s.is_deletion))
        typed = [s.key for s in settings]
        cells = []
        for job in jobs(swept):
            cfg = compose("config", overrides=job, return_hydra_config=True)
            cells.append(_cell(cfg, keys, typed, allowed, extra, config_dir))
    if not cells:
        raise UserError(
            f"{' '.join(shorten(s.word) for s in settings)}: the sweep is empty; "
            "allowed: at least one value for each key"
        )
    if len({cell.runner for cell in cells}) > 1:
        raise UserError("runner, store and until cannot be swept: the cells of one run share them")
    return cells


def _checked(words: Sequence[str], sweep: bool) -> list[Setting]:
    """The overrides, none of which reaches Hydra's own node; several values only in a `sweep`."""
    settings = read(words, sweep)
    for setting in settings:
        refuse_hydra(setting)
        if setting.is_sweep and not sweep:
            raise UserError(
                f"{shorten(setting.word)}: several values are a sweep; "
                "add -m, or brackets for one list"
            )
    return settings


def _own_sweep(settings: Sequence[Setting]) -> list[Setting]:
    """The sweep that the chosen experiment brings along. Call it where Hydra is initialised."""
    from hydra import compose

    plain = [s.line for s in settings if not s.is_sweep]
    base = compose("config", overrides=plain, return_hydra_config=True)
    params = base.hydra.sweeper.params or {}
    own = read(f"{key}={value}" for key, value in params.items())
    for setting in own:
        refuse_hydra(setting)
        if setting.key == "plugins":
            raise UserError(
                f"{shorten(setting.word)}: only plugins=[...] on the command line can name plugins"
            )
    return own


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
    from omegaconf import OmegaConf

    settings = _checked(overrides, sweep)
    with hydra_initialised(config_dir), explained(settings, config_dir):
        cfg = compose("config", overrides=[s.line for s in settings if not s.is_sweep])
        part = OmegaConf.select(cfg, package) if package else cfg
        if part is None:
            raise UserError(f"--package={package}: no such part of the config")
        return (
            OmegaConf.to_yaml(part, resolve=resolve) if OmegaConf.is_config(part) else f"{part}\n"
        )


def _cell(
    cfg: Any,
    keys: Sequence[str],
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
        raise UserError(f"{key}: {first_line(error)}" if key else first_line(error)) from None
    raw: Any = OmegaConf.to_container(node, resolve=False)
    choices = dict(cfg.hydra.runtime.choices)
    changed = _changed(raw, plain, config_dir)
    return build(
        plain, choices, keys=keys, typed=typed, plugins=plugins, changed=changed, extra=extra
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
