"""From a composed and resolved config to a validated cell."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from aoabench.cell import Cell, RunnerOptions
from aoabench.config.adopt import as_estimator, as_noise, as_scenario
from aoabench.config.checks import check_names, check_top_level
from aoabench.config.every import ByAll
from aoabench.config.fit import Fitting, misbuilt, those_that_fit
from aoabench.config.heard import remark, share_heard
from aoabench.config.plugins import construct, import_plugins
from aoabench.config.presets import LISTS, options
from aoabench.config.recording import as_recorded, unused
from aoabench.config.running import MOST_REPS, runner_options
from aoabench.errors import BadValue, Mistakes, UserError, check_number
from aoabench.roles import Estimator, Noise, Scenario


@dataclass
class Builder:
    """Builds the cells of a sweep; cells with equal nodes of shipped classes share the objects.

    `plugins`: the packages that the command line names; `extra`: further estimators, given as
    objects. The cells keep their objects alive, so that ids of objects stay unique.
    """

    plugins: Sequence[str] = ()
    extra: Mapping[str, Any] = field(default_factory=dict)
    objects: dict[tuple[str, str], Any] = field(default_factory=dict)  # by path and node
    runners: dict[str, RunnerOptions] = field(default_factory=dict)  # by their nodes
    heard: dict[tuple[int, int | None], tuple[str, ...]] = field(default_factory=dict)

    def cell(
        self,
        plain: Mapping[str, Any],
        choices: Mapping[str, Any],
        *,
        keys: Sequence[str] = (),
        typed: Iterable[str] = (),
        changed: Mapping[str, Any] | None = None,
        by_all: ByAll | None = None,
    ) -> Cell:
        """Validate one composed and resolved job and return its cell.

        `choices`: the presets chosen; `keys`: the keys that the job sets; `typed`: the keys that
        the user's own command line sets; `changed`: the estimators' parameters that differ from
        their presets; `by_all`: what `all` stands for. Raises UserError, ManyErrors for several,
        for the mistakes that can be found before a run.
        """
        typed, mistakes, by_all = set(typed), Mistakes(), by_all or ByAll()
        check_top_level(plain, choices, self.plugins, mistakes)
        import_plugins(self.plugins)
        runner = mistakes.tried(self._runner, plain, typed)
        if "reps" not in typed and isinstance(plain["reps"], int):
            limits: dict[str, Any] = {"least": 1, "most": MOST_REPS, "integer": True}
            mistakes.tried(check_number, "reps", plain["reps"], **limits)
        found = self._plugged(plain, choices, keys, by_all, mistakes)
        mistakes.check()
        assert runner is not None
        assert found is not None
        left_out = {**by_all.left_out, **found.fitting.left_out}
        estimators = found.fitting.estimators
        return Cell(
            scenario_name=found.choices["scenario"],
            noise_name=found.choices["noise"],
            scenario=found.scenario,
            noise=found.noise,
            estimators={path.partition(".")[2]: one for path, one in estimators.items()},
            seed=found.plain["seed"],
            reps=found.plain["reps"],
            runner=runner,
            config=_config(found.plain, estimators),
            changed=_without(left_out, changed or {}),
            swept=tuple(key for key in keys if "." in key),
            experiment=found.choices.get("experiment"),
            plugins=tuple(self.plugins),
            notes=found.notes,
            left_out=left_out,
        )

    def _plugged(
        self,
        plain: Mapping[str, Any],
        choices: Mapping[str, Any],
        keys: Sequence[str],
        by_all: ByAll,
        mistakes: Mistakes,
    ) -> _Plugged | None:
        """The scenario, the noise and the estimators that run; None if one of the two cannot be
        built. What is wrong is entered in `mistakes`.
        """
        scenario = mistakes.tried(self._object, plain["scenario"], "scenario", as_scenario)
        notes: tuple[str, ...] = ()
        if scenario is not None and not mistakes.found:
            plain, choices, notes = as_recorded(plain, choices, scenario, keys)
        noise = mistakes.tried(self._object, plain["noise"], "noise", as_noise)
        made = self._estimators(plain, choices.get("experiment"), mistakes)
        left_out = _unbuilt(by_all, made, keys)
        for error in made.wrong.values():
            mistakes.note(error)
        mistakes.tried(check_names, plain, self.extra)
        if scenario is None or noise is None:
            return None
        if not mistakes.found:
            notes += self._heard(scenario, plain["seed"])
        nothing = Fitting({}, (), left_out)
        if mistakes.found and scenario.tracks is not None:
            # which estimators a recording does not suit depends on what else runs
            return _Plugged(plain, choices, scenario, noise, nothing, notes)
        words = scenario, noise, choices, keys, by_all.chosen
        fit = mistakes.tried(those_that_fit, made.objects, *words) or nothing
        fit = fit._replace(left_out={**left_out, **fit.left_out})
        if by_all.words and not fit.estimators and not mistakes.found:
            mistakes.note(_nothing_runs(by_all, choices, fit))
        notes = *notes, *fit.notes, *unused(scenario, fit.estimators)
        return _Plugged(plain, choices, scenario, noise, fit, notes)

    def _object(self, node: Any, path: str, adopted: Callable[[Any, str], Any]) -> Any:
        """The object that a node describes, in its role; one for all cells if its classes are
        shipped ones, whose objects do not change.
        """
        if _names_class_of(self.plugins, node):
            return adopted(construct(node, path, self.plugins), path)
        key = (path, repr(node))
        if key not in self.objects:
            self.objects[key] = adopted(construct(node, path, self.plugins), path)
        return self.objects[key]

    def _runner(self, plain: Mapping[str, Any], typed: set[str]) -> RunnerOptions:
        key = repr([plain.get(group) for group in ("runner", "store", "until")])
        if key not in self.runners:
            self.runners[key] = runner_options(plain, typed)
        return self.runners[key]

    def _heard(self, scenario: Scenario, seed: int) -> tuple[str, ...]:
        """The remark of `check_heard`; positions that are always the same are looked at once."""
        always, now = (id(scenario), None), (id(scenario), seed)
        if always in self.heard:
            return self.heard[always]
        if now not in self.heard:
            found = share_heard(scenario, seed)
            self.heard[always if found is None or found[1] else now] = remark(scenario, found)
        return self.heard.get(always) or self.heard.get(now, ())

    def _estimators(
        self, plain: Mapping[str, Any], experiment: str | None, mistakes: Mistakes
    ) -> _Made:
        """Filters, estimators and objects given as such (estimators.NAME), by their dotted keys."""
        made = _Made({}, {})
        for group in LISTS:
            nodes = plain.get(group) or {}
            if not isinstance(nodes, dict):
                allowed = f"{group}=[NAME,NAME] with presets of `aoabench list {group}`"
                mistakes.note(BadValue(group, nodes, allowed))
                continue
            for name, node in nodes.items():
                path = f"{group}.{name}"
                bare = isinstance(node, dict) and "_target_" not in node
                if bare and experiment and name in options(group):
                    continue  # an experiment's setting for a preset that this run leaves out
                if f"filter.{name}" in made.objects:
                    text = (
                        f"{path}: a filter has this name; "
                        "allowed: a name that no other filter or estimator has"
                    )
                    mistakes.note(UserError(text))
                made.add(path, self._object, node, path, as_estimator)
        for name, given in self.extra.items():
            made.add(f"estimators.{name}", as_estimator, given, f"estimators[{name!r}]")
        return made


class _Made(NamedTuple):
    """The estimators that were built, and the errors about the others, by their dotted keys."""

    objects: dict[str, Estimator]
    wrong: dict[str, UserError]

    def add(self, path: str, build: Callable[..., Estimator], *arguments: Any) -> None:
        """Build an estimator."""
        try:
            self.objects[path] = build(*arguments)
        except UserError as error:
            self.wrong[path] = error


class _Plugged(NamedTuple):
    """The objects of a cell, with the config and the choices that a recording changes."""

    plain: Mapping[str, Any]
    choices: Mapping[str, Any]
    scenario: Scenario
    noise: Noise
    fitting: Fitting
    notes: tuple[str, ...]


def _unbuilt(by_all: ByAll, made: _Made, keys: Sequence[str]) -> dict[str, str]:
    """The presets chosen by `all` that cannot be built as they are, with the reason, taken out of
    the errors; those of which the job sets a key at fault stay there.
    """
    found = {}
    for path, error in list(made.wrong.items()):
        if path in by_all.chosen and isinstance(error, BadValue) and error.key not in keys:
            found[path] = misbuilt(path, error)
            del made.wrong[path]
    return found


def _nothing_runs(by_all: ByAll, choices: Mapping[str, Any], fit: Fitting) -> UserError:
    """The error for a job in which nothing runs of what `all` stands for."""
    why = "; ".join(dict.fromkeys(fit.left_out.values()))
    scenario = choices["scenario"]
    return UserError(
        f"{by_all.words}: nothing runs with scenario={scenario} noise={choices['noise']}: {why}; "
        f"`aoabench list --fits {scenario}` shows what does"
    )


def _without(left_out: Iterable[str], changed: Mapping[str, Any]) -> dict[str, Any]:
    """The changed parameters without those of presets that are left out."""
    heads = tuple(f"{path}." for path in left_out)
    return {key: value for key, value in changed.items() if not key.startswith(heads)}


def _config(plain: Mapping[str, Any], estimators: Mapping[str, Estimator]) -> dict[str, Any]:
    """The config of a cell, without the presets of estimators that do not run."""
    found = {group: plain[group] or None for group in ("scenario", "noise")}
    for group in ("filter", "estimator"):
        nodes = (plain.get(group) or {}).items()
        found[group] = {n: node for n, node in nodes if f"{group}.{n}" in estimators} or None
    return found | {"seed": plain["seed"]}


def _names_class_of(plugins: Sequence[str], node: Any) -> bool:
    """Whether a node, or one inside it, names a class that is not shipped."""
    if not plugins:
        return False
    if isinstance(node, list):
        return any(_names_class_of(plugins, item) for item in node)
    if not isinstance(node, dict):
        return False
    shipped = str(node.get("_target_", "aoabench.")).startswith("aoabench.")
    return not shipped or any(_names_class_of(plugins, item) for item in node.values())
