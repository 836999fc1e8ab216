"""Overrides to cells, composed with Hydra.

Only Hydra's compose API is used. Hydra's callbacks, launchers, logging configuration and reruns are
not used, because their `_target_`s would run code before our checks.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from aoabench.cell import Cell
from aoabench.config.build import build
from aoabench.config.guard import refuse_hydra
from aoabench.config.messages import explained
from aoabench.config.nodes import hydra_initialised, resolved, with_defaults
from aoabench.config.overrides import Setting, jobs, read
from aoabench.config.plugins import parse_plugins
from aoabench.config.presets import LISTS, options
from aoabench.errors import UserError, did_you_mean, shorten
from aoabench.maths.digest import flatten


def compose_cells(
    overrides: Sequence[str],
    *,
    config_dir: str | None = None,
    plugins: Sequence[str] = (),
    extra: Mapping[str, Any] | None = None,
    sweep: bool = True,
) -> list[Cell]:
    """Return the cells of command-line overrides: one for each combination of the values that
    commas in the overrides, and the experiment's own sweep, give to the keys.

    Without `sweep` the list has one cell, and several values for a key are a mistake. Raises
    UserError for every mistake.
    """
    from hydra import compose

    named = [f"plugins=[{','.join(plugins)}]"] if plugins else []
    settings = _checked([*overrides, *named], sweep)
    allowed = parse_plugins(settings)
    with hydra_initialised(config_dir), explained(settings, config_dir):
        swept = [*_own_sweep(settings), *settings] if sweep else settings
        keys = tuple(dict.fromkeys(s.key for s in swept if not s.is_deletion))
        typed = [s.key for s in settings]
        job = _Job(keys, typed, allowed, extra, config_dir)
        cells = [
            job.cell(compose("config", overrides=lines, return_hydra_config=True))
            for lines in jobs(swept)
        ]
    if not cells:
        raise UserError(
            f"{' '.join(shorten(s.word) for s in settings)}: the sweep is empty; "
            "allowed: at least one value for each key"
        )
    if len({cell.runner for cell in cells}) > 1:
        raise UserError("runner, store and until cannot be swept: the cells of one run share them")
    return cells


def _checked(words: Sequence[str], sweep: bool) -> list[Setting]:
    """The overrides as settings; UserError if one sets Hydra's own node, or several values without
    `sweep`.
    """
    settings = read(words, sweep)
    for setting in settings:
        refuse_hydra(setting)
        if setting.is_sweep and not sweep:
            raise UserError(
                f"{shorten(setting.word)}: several values need -m (a sweep over the values), "
                "or brackets (one list)"
            )
    return settings


def _own_sweep(settings: Sequence[Setting]) -> list[Setting]:
    """The sweep defined by the chosen experiment. Call this where Hydra is initialised."""
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
    """The composed config as YAML, or one dotted part of it; for a `sweep`, the part common to all
    jobs.
    """
    from hydra import compose
    from omegaconf import OmegaConf

    settings = _checked(overrides, sweep)
    with hydra_initialised(config_dir), explained(settings, config_dir):
        cfg = compose("config", overrides=[s.line for s in settings if not s.is_sweep])
        whole = OmegaConf.create(with_defaults(cfg, parse_plugins(settings)))
        part = OmegaConf.select(whole, package) if package else whole
        if part is None:
            raise UserError(
                f"--package={package}: unknown key; `aoabench run --cfg job` shows the keys"
            )
        return (
            OmegaConf.to_yaml(part, resolve=resolve) if OmegaConf.is_config(part) else f"{part}\n"
        )


@dataclass
class _Job:
    """Settings common to all jobs of a sweep; `keys`: the keys that the jobs set, `typed`: the keys
    that the user's own command line sets.
    """

    keys: Sequence[str]
    typed: Sequence[str]
    plugins: Sequence[str]
    extra: Mapping[str, Any] | None
    config_dir: str | None
    presets: dict[tuple[str, ...], dict[str, Any]] = field(default_factory=dict)

    def cell(self, cfg: Any) -> Cell:
        """The cell of one composed job."""
        raw = with_defaults(cfg, self.plugins)
        self._check_selected(raw, dict(cfg.hydra.runtime.choices).get("experiment"))
        plain = resolved(raw)
        return build(
            plain,
            dict(cfg.hydra.runtime.choices),
            keys=self.keys,
            typed=self.typed,
            plugins=self.plugins,
            changed=self._changed(raw, plain),
            extra=self.extra,
        )

    def _check_selected(self, raw: Mapping[str, Any], experiment: str | None) -> None:
        """Raise UserError for a parameter of a filter or estimator that is not selected."""
        for key in self.keys:
            group, _, rest = key.partition(".")
            name = rest.partition(".")[0]
            node = (raw.get(group) or {}).get(name) if group in LISTS and rest else None
            if not isinstance(node, dict) or "_target_" in node:
                continue
            known = options(group, self.config_dir)
            if name not in known:
                raise UserError(f"{key}: unknown {group} {name!r}{did_you_mean(name, known)}")
            if experiment is None or key in self.typed:
                raise UserError(
                    f"{key}: {name} is not selected; allowed: together with {group}=[{name}]"
                )

    def _changed(self, raw: Mapping[str, Any], plain: Mapping[str, Any]) -> dict[str, Any]:
        """Parameters of the estimators, by dotted key, whose values differ from their presets."""
        given = {group: raw[group] for group in LISTS if isinstance(raw.get(group), dict)}
        default = self._defaults(given)
        resolved = dict(flatten(plain))
        return {
            key: resolved.get(key, value)
            for key, value in flatten(given)
            if key and (key not in default or default[key] != value)
        }

    def _defaults(self, given: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
        """The parameters of these presets without any override, by dotted key."""
        from hydra import compose

        chosen = []
        for group, nodes in given.items():
            names = [name for name in nodes if name in options(group, self.config_dir)]
            chosen.append(f"{group}=[{','.join(names)}]")
        if tuple(chosen) not in self.presets:
            whole = with_defaults(compose("config", overrides=chosen), self.plugins)
            self.presets[tuple(chosen)] = dict(flatten(whole))
        return self.presets[tuple(chosen)]
