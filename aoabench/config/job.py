"""The cell of one job of a sweep, with the mistakes of all its overrides in one message."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from aoabench.cell import Cell
from aoabench.config.build import Builder
from aoabench.config.checks import NoEstimator
from aoabench.config.composer import Composed, Composer
from aoabench.config.messages import NotComposed, explain, unknown_preset
from aoabench.config.nodes import Resolver, with_defaults
from aoabench.config.overrides import Setting, leaves, read
from aoabench.config.plugins import Speller
from aoabench.config.presets import LISTS, options
from aoabench.errors import Mistakes, UserError, did_you_mean
from aoabench.maths.digest import flatten


class _NotChosen(UserError):
    """A filter or estimator that does not exist or is not selected."""


@dataclass
class Job:
    """Settings common to all jobs of a sweep; `keys`: the keys that the jobs set, `typed`: the keys
    that the user's own command line sets, `out`: the folder of the tables in place of runner.out.
    """

    composer: Composer
    settings: Sequence[Setting]
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
        mistakes = Mistakes()
        job = self._composed(lines, mistakes)
        for problem in job.problems:
            mistakes.note(explain(problem, self.settings, self.config_dir))
        raw = with_defaults(job.nodes, self.speller)
        chosen = self._of_selected(raw, job.choices.get("experiment"), mistakes)
        cell = mistakes.tried(self._cell, chosen, job)
        if any(isinstance(one, _NotChosen) for one in mistakes.found.values()):
            found = mistakes.found.items()  # that no estimator is left follows from the others
            mistakes.found = {t: one for t, one in found if not isinstance(one, NoEstimator)}
        mistakes.check()
        assert cell is not None
        return cell

    def _composed(self, lines: Sequence[str], mistakes: Mistakes) -> Composed:
        """The config of a job, without the names of filters and estimators that no preset has,
        which are entered in `mistakes`; UserError for other presets that do not exist.
        """
        try:
            return self.composer.composed(lines)
        except NotComposed as error:
            rest: dict[str, str] = {}
            for line, one in error.errors.items():
                chosen = _names(line)
                if chosen is None:
                    mistakes.note(explain(one, self.settings, self.config_dir))
                    continue
                group, names = chosen
                known = options(group, self.config_dir)
                for name in names:
                    if name not in known:
                        mistakes.note(_NotChosen(unknown_preset(group, name, list(known))))
                some = ",".join(name for name in names if name in known)
                rest[line] = f"{group}=[{some}]"
            if len(rest) < len(error.errors) or len(mistakes.found) < len(rest):
                mistakes.check()
                raise
            return self.composer.composed([rest.get(line, line) for line in lines])

    def _cell(self, raw: Mapping[str, Any], job: Composed) -> Cell:
        """The cell of a composed job."""
        plain = self.resolver(raw)
        keys, typed = self.keys, self.typed
        if self.out is not None:
            out = os.path.abspath(self.out) if self.out.startswith("~") else self.out
            plain = {**plain, "runner": {**(plain.get("runner") or {}), "out": out}}
            keys, typed = (*keys, "runner.out"), (*typed, "runner.out")
        changed = self._changed(raw, plain, job)
        more: dict[str, Any] = {"keys": keys, "typed": typed, "changed": changed}
        return self.builder.cell(plain, job.choices, **more, by_all=job.by_all)

    def _of_selected(
        self, raw: Mapping[str, Any], experiment: str | None, mistakes: Mistakes
    ) -> Mapping[str, Any]:
        """The nodes without parameters of filters and estimators that are not selected, which are
        entered in `mistakes`.
        """
        found = dict(raw)
        for key in self.keys:
            group, _, rest = key.partition(".")
            name = rest.partition(".")[0]
            node = (raw.get(group) or {}).get(name) if group in LISTS and rest else None
            if not isinstance(node, dict) or "_target_" in node:
                continue
            known = options(group, self.config_dir)
            if name not in known:
                text = f"{key}: unknown {group} {name!r}{did_you_mean(name, known)}"
            elif experiment is None or key in self.typed:
                text = f"{key}: {name} is not selected; allowed: together with {group}=[{name}]"
            else:
                continue
            mistakes.note(_NotChosen(text))
            found[group] = {other: one for other, one in found[group].items() if other != name}
        return found

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
            self.presets[names] = dict(flatten({group: whole.get(group) or {} for group in given}))
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


def _names(line: str) -> tuple[str, list[str]] | None:
    """The group and names of a line that chooses filters or estimators; None for another line."""
    (setting,) = read([line])
    plain = not (setting.package or setting.is_deletion)
    return (setting.key, list(leaves(setting.value))) if plain and setting.key in LISTS else None
