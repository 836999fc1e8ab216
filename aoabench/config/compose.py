"""Overrides to cells, composed with Hydra.

Only Hydra's compose API is used. Hydra's callbacks, launchers, logging configuration and reruns are
not used, because their `_target_`s would run code before our checks.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from aoabench.cell import Cell
from aoabench.config.build import Builder
from aoabench.config.composer import Composed, Composer
from aoabench.config.guard import refuse_hydra, refuse_unreadable
from aoabench.config.messages import explained
from aoabench.config.nodes import Resolver, hydra_initialised, with_defaults
from aoabench.config.overrides import Setting, jobs, read
from aoabench.config.plugins import Speller, parse_plugins
from aoabench.config.presets import LISTS, options
from aoabench.errors import UserError, did_you_mean, shorten
from aoabench.maths.digest import flatten

_SILENT_S = 0.3  # seconds of composing without a line of progress
_EVERY_S = 10.0  # seconds between further lines


def compose_cells(
    overrides: Sequence[str],
    *,
    config_dir: str | None = None,
    plugins: Sequence[str] = (),
    extra: Mapping[str, Any] | None = None,
    sweep: bool = True,
    out: str | None = None,
    say: Callable[[str], None] | None = None,
) -> list[Cell]:
    """Return the cells of command-line overrides: one for each combination of the values that
    commas in the overrides, and the experiment's own sweep, give to the keys.

    Without `sweep` the list has one cell, and several values for a key are a mistake. `out` is the
    folder of the tables, literally, in place of runner.out. `say` gets a line of progress where
    composing takes longer than _SILENT_S. Raises UserError for every mistake.
    """
    named = [f"plugins=[{','.join(plugins)}]"] if plugins else []
    settings = _checked([*overrides, *named], sweep)
    refuse_unreadable(config_dir, settings)
    allowed = parse_plugins(settings)
    with hydra_initialised(config_dir), explained(settings, config_dir):
        composer = Composer()
        swept = [*_own_sweep(settings, composer), *settings] if sweep else settings
        keys = tuple(dict.fromkeys(s.key for s in swept if not s.is_deletion))
        typed = [s.key for s in settings]
        job = _Job(composer, keys, typed, allowed, config_dir, out, Builder(allowed, extra or {}))
        cells = [job.cell(lines) for lines in _reported(jobs(swept), say)]
    if not cells:
        raise UserError(
            f"{' '.join(shorten(s.word) for s in settings)}: the sweep is empty; "
            "allowed: at least one value for each key"
        )
    if len({cell.runner for cell in cells}) > 1:
        raise UserError("runner, store and until cannot be swept: the cells of one run share them")
    return cells


def _reported(
    lines: Sequence[Sequence[str]], say: Callable[[str], None] | None
) -> Iterator[Sequence[str]]:
    """Yield the jobs; tell `say` how far they are composed, where that takes long."""
    due = time.monotonic() + _SILENT_S
    for number, job in enumerate(lines):
        if say and time.monotonic() >= due:
            say(f"composing {len(lines)} cells: {number} done ...")
            due = time.monotonic() + _EVERY_S
        yield job


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


def _own_sweep(settings: Sequence[Setting], composer: Composer) -> list[Setting]:
    """The sweep defined by the chosen experiment. Call this where Hydra is initialised."""
    params = composer.sweep([s.line for s in settings if not s.is_sweep])
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
    from omegaconf import OmegaConf

    settings = _checked(overrides, sweep)
    refuse_unreadable(config_dir, settings)
    with hydra_initialised(config_dir), explained(settings, config_dir):
        nodes = Composer().composed([s.line for s in settings if not s.is_sweep]).nodes
        whole = OmegaConf.create(with_defaults(nodes, Speller(parse_plugins(settings))))
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
    that the user's own command line sets, `out`: the folder of the tables in place of runner.out.
    """

    composer: Composer
    keys: Sequence[str]
    typed: Sequence[str]
    plugins: Sequence[str]
    config_dir: str | None
    out: str | None
    builder: Builder
    speller: Speller = field(init=False)
    resolver: Resolver = field(default_factory=Resolver)
    presets: dict[tuple[str, ...], dict[str, Any]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.speller = Speller(self.plugins)

    def cell(self, lines: Sequence[str]) -> Cell:
        """The cell of one job, given as lines of overrides."""
        job = self.composer.composed(lines)
        raw = with_defaults(job.nodes, self.speller)
        self._check_selected(raw, job.choices.get("experiment"))
        plain = self.resolver(raw)
        keys, typed = self.keys, self.typed
        if self.out is not None:
            out = os.path.abspath(self.out) if self.out.startswith("~") else self.out
            plain = {**plain, "runner": {**(plain.get("runner") or {}), "out": out}}
            keys, typed = (*keys, "runner.out"), (*typed, "runner.out")
        changed = self._changed(raw, plain, job)
        return self.builder.cell(plain, job.choices, keys=keys, typed=typed, changed=changed)

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

    def _changed(
        self, raw: Mapping[str, Any], plain: Mapping[str, Any], job: Composed
    ) -> dict[str, Any]:
        """Parameters of the estimators, by dotted key, whose values differ from their presets."""
        given = {group: raw[group] for group in LISTS if isinstance(raw.get(group), dict)}
        default = self._defaults(given, job)
        values = dict(flatten({group: plain[group] for group in given}))
        return {
            key: values.get(key, value)
            for key, value in flatten(given)
            if key and (key not in default or default[key] != value)
        }

    def _defaults(self, given: Mapping[str, Mapping[str, Any]], job: Composed) -> dict[str, Any]:
        """The parameters of these presets without any override, by dotted key."""
        names = tuple(f"{group}:{','.join(map(str, nodes))}" for group, nodes in given.items())
        if names not in self.presets:
            whole = with_defaults(self._of_presets(given, job), self.speller)
            self.presets[names] = dict(flatten({group: whole[group] for group in given}))
        return self.presets[names]

    def _of_presets(
        self, given: Mapping[str, Mapping[str, Any]], job: Composed
    ) -> Mapping[str, Any]:
        """The nodes of a config in which these presets are as their files hold them."""
        packages = any("@" in group for group in job.choices)
        if self.config_dir is None and job.choices.get("experiment") is None and not packages:
            return job.base  # nothing else sets parameters of filters and estimators
        chosen = []
        for group, nodes in given.items():
            known = options(group, self.config_dir)
            chosen.append(f"{group}=[{','.join(name for name in nodes if name in known)}]")
        return self.composer.composed(chosen).nodes
