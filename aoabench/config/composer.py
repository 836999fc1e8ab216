"""The composed configs of the jobs of a sweep.

Hydra composes each choice of presets once, which is slow. Each job's values are then set on a copy,
by Hydra's own function and in the order of the overrides, so that the result equals Hydra's
composition of the whole job.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from aoabench.config.every import ByAll, expanded
from aoabench.config.messages import NotComposed
from aoabench.config.nodes import is_open


class Composed(NamedTuple):
    """A composed config as plain nodes, without Hydra's own node and with interpolations
    unresolved; `base`, the same before values were set; the preset that is chosen of each group;
    what `all` stands for; Hydra's exceptions about the values that it could not set.
    """

    nodes: Mapping[str, Any]
    base: Mapping[str, Any]
    choices: Mapping[str, Any]
    by_all: ByAll
    problems: Sequence[Exception]


@dataclass(frozen=True)
class _Base:
    """The config of a choice of presets, and the sweep that the chosen experiment defines."""

    cfg: Any  # omegaconf.DictConfig
    nodes: Mapping[str, Any]
    choices: Mapping[str, Any]
    sweep: Mapping[str, Any]


@dataclass
class Composer:
    """Composes jobs, given as lines of overrides; use it where Hydra is initialised.

    The nodes of different jobs share parts; they must not be changed. `config_dir`: the user's own
    presets, for `filter=all`.
    """

    config_dir: str | None = None
    bases: dict[tuple[str, ...], _Base] = field(default_factory=dict)
    parsed: dict[str, Any] = field(default_factory=dict)
    groups: dict[str, bool] = field(default_factory=dict)

    def composed(self, lines: Sequence[str]) -> Composed:
        """The config of a job; NotComposed if a preset does not exist."""
        lines, by_all = self._expanded(lines)
        overrides = [self._override(line) for line in lines]
        values = [one for one in overrides if not self._chooses(one)]
        base = self._base([line for line, one in zip(lines, overrides) if self._chooses(one)])
        nodes, problems = _with(values, base)
        return Composed(nodes, base.nodes, base.choices, by_all, problems)

    def sweep(self, lines: Sequence[str]) -> Mapping[str, Any]:
        """The sweep that the experiment of a job defines: values by key, resolved."""
        from hydra import compose

        lines, _ = self._expanded(lines)
        found = self._base([line for line in lines if self._chooses(self._override(line))]).sweep
        if not is_open(found):
            return found
        cfg = compose("config", overrides=list(lines), return_hydra_config=True)
        return dict(cfg.hydra.sweeper.params.items())

    def _expanded(self, lines: Sequence[str]) -> tuple[list[str], ByAll]:
        """The lines with presets in place of `all`, and what it stands for."""
        each = [expanded(line, self._override(line), self.config_dir) for line in lines]
        by_all = ByAll()
        for _, one in each:
            by_all |= one
        return [line for line, _ in each], by_all

    def _base(self, lines: Sequence[str]) -> _Base:
        """The config of overrides that choose presets."""
        from hydra import compose
        from omegaconf import OmegaConf, open_dict

        if tuple(lines) not in self.bases:
            try:
                cfg = compose("config", overrides=list(lines), return_hydra_config=True)
            except Exception as error:
                raise NotComposed(_alone(lines) or {"": error}) from error
            choices = dict(cfg.hydra.runtime.choices)
            sweep: Any = OmegaConf.to_container(cfg.hydra.sweeper, resolve=False)
            with open_dict(cfg):
                del cfg["hydra"]
            nodes: Any = OmegaConf.to_container(cfg, resolve=False)
            self.bases[tuple(lines)] = _Base(cfg, nodes, choices, sweep["params"] or {})
        return self.bases[tuple(lines)]

    def _override(self, line: str) -> Any:
        """A line as Hydra's parser reads it."""
        from hydra.core.override_parser.overrides_parser import OverridesParser

        if line not in self.parsed:
            (self.parsed[line],) = OverridesParser.create().parse_overrides([line])
        return self.parsed[line]

    def _chooses(self, override: Any) -> bool:
        """Whether an override chooses, adds or deletes a preset, as Hydra decides it; a sweep,
        which Hydra refuses, counts as a choice.
        """
        from hydra.core.global_hydra import GlobalHydra

        if override.is_sweep_override():
            return True
        key = override.key_or_group
        if key not in self.groups:
            loader: Any = GlobalHydra.instance().config_loader()
            self.groups[key] = loader.repository.group_exists(key)
        return bool(self.groups[key]) and not isinstance(override.value(), dict)


def _alone(lines: Sequence[str]) -> dict[str, Exception]:
    """The exceptions of the lines that Hydra refuses even alone."""
    from hydra import compose

    found: dict[str, Exception] = {}
    for line in lines:
        try:
            compose("config", overrides=[line])
        except Exception as error:
            found[line] = error
    return found


def _with(values: Sequence[Any], base: _Base) -> tuple[Mapping[str, Any], list[Exception]]:
    """The nodes of a config with the values of parsed overrides set, and Hydra's exceptions about
    those that it could not set.

    A value can reach other top-level keys than its own by interpolations only. Where its own key
    holds none, only the nodes of the values' own keys are copied.
    """
    from omegaconf import OmegaConf

    if not values:
        return base.nodes, []
    own = {one.key_or_group.partition(".")[0] for one in values}
    if is_open([base.nodes.get(key) for key in own]) or is_open([one.value() for one in values]):
        whole = copy.deepcopy(base.cfg)
        problems = _set(values, whole)
        nodes: Any = OmegaConf.to_container(whole, resolve=False)
        return dict(nodes), problems
    part = OmegaConf.masked_copy(base.cfg, [key for key in base.nodes if key in own])
    OmegaConf.set_struct(part, True)
    problems = _set(values, part)
    changed: Any = OmegaConf.to_container(part, resolve=False)
    rest = {key: node for key, node in base.nodes.items() if key not in own}
    return {**rest, **changed}, problems


def _set(values: Sequence[Any], cfg: Any) -> list[Exception]:
    """Set the values of parsed overrides in a composed config; the exceptions that Hydra raises."""
    from hydra._internal.config_loader_impl import ConfigLoaderImpl
    from hydra.errors import ConfigCompositionException
    from omegaconf.errors import OmegaConfBaseException

    found: list[Exception] = []
    for one in values:
        try:
            ConfigLoaderImpl._apply_overrides_to_config([one], cfg)
        except OmegaConfBaseException as error:
            found.append(ConfigCompositionException())
            found[-1].__cause__ = error
        except Exception as error:
            found.append(error)
    return found
