"""The parameters of presets, and the estimators that fit a scenario."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cache
from typing import Any, NamedTuple

from aoabench.config.adopt import as_estimator, as_noise, as_scenario
from aoabench.config.every import SMOOTHER, variant_of
from aoabench.config.messages import explained
from aoabench.config.nodes import hydra_initialised, plain_nodes, resolved
from aoabench.config.plugins import Speller, construct, resolve
from aoabench.config.presets import GROUPS, LISTS, options, own_options, unread, variants
from aoabench.errors import BadValue, UserError, did_you_mean
from aoabench.params import allowed, key_of
from aoabench.roles import Estimator, Noise, Scenario


class Parameter(NamedTuple):
    """A parameter of a preset: its dotted key, value in the preset, unit, meaning, and the allowed
    values in words.
    """

    key: str
    value: Any
    unit: str
    help: str
    allowed: str


def group_of(name: str, config_dir: str | None = None) -> str:
    """The config group that a preset belongs to; UserError for an unknown name."""
    found = {preset: group for group in GROUPS for preset in options(group, config_dir)}
    if name not in found:
        known = [*GROUPS, *found]
        own = "".join(unread(group, name) for group in GROUPS)
        hint = did_you_mean(name, known) or f"; allowed: {', '.join(GROUPS)}, or a preset"
        raise UserError(f"{name!r}: no such group or preset{own or hint}")
    return found[name]


def parameters(
    name: str, config_dir: str | None = None, plugins: Sequence[str] = ()
) -> list[Parameter]:
    """The parameters of a preset of a scenario, noise, filter or estimator, nested ones too."""
    from hydra import compose

    group = group_of(name, config_dir)
    with hydra_initialised(config_dir), explained((), config_dir):
        chosen = f"{group}=[{name}]" if group in LISTS else f"{group}={name}"
        whole = plain_nodes(compose("config", overrides=[chosen]), Speller(plugins))
    node = whole[group][name] if group in LISTS else whole[group]
    return list(_walk(node, f"{group}.{name}" if group in LISTS else group, plugins))


def _walk(node: Mapping[str, Any], path: str, plugins: Sequence[str]) -> Iterator[Parameter]:
    cls = resolve(node["_target_"], path, plugins) if "_target_" in node else None
    known = {key_of(f): f for f in dataclasses.fields(cls)} if cls else {}
    for key, value in node.items():
        if isinstance(value, dict):
            yield from _walk(value, f"{path}.{key}", plugins)
        elif key != "_target_":
            meta = known[key].metadata.get("param") if key in known else None
            about = (meta.unit, meta.help, allowed(known[key])) if meta else ("", "", "")
            yield Parameter(f"{path}.{key}", value, *about)


def own_presets(config_dir: str, plugin: str) -> dict[tuple[str, str], Any]:
    """By group and name, the objects of the presets in a user's folder whose class is that of the
    module `plugin`, or of a module in that package.

    Raises UserError for a folder that does not exist and for a preset that cannot be built.
    """
    found = {}
    for group in GROUPS[:4]:
        for name in own_options(group, config_dir):
            chosen = f"{group}=[{name}]" if group in LISTS else f"{group}={name}"
            plain = composed([chosen], config_dir, (plugin,))
            path = f"{group}.{name}" if group in LISTS else group
            node = plain[group][name] if group in LISTS else plain[group]
            target = str(node.get("_target_", "")) if isinstance(node, dict) else ""
            if target.startswith(f"{plugin}."):
                found[group, name] = construct(node, path, (plugin,))
    return found


def fitting(
    scenario: str, config_dir: str | None = None, plugins: Sequence[str] = ()
) -> dict[str, dict[str, list[str]]]:
    """By group and name, the filters and estimators that run in a scenario, each with its possible
    noises.

    Raises UserError for a scenario that is unknown or cannot be built.
    """
    known = options("scenario", config_dir)
    if scenario not in known:
        hint = did_you_mean(scenario, known) or f"; allowed: {', '.join(known)}"
        raise UserError(f"--fits={scenario}: unknown scenario{hint}")
    plain = composed([f"scenario={scenario}"], config_dir, plugins)
    place = as_scenario(construct(plain["scenario"], "scenario", plugins), "scenario")
    found: dict[str, dict[str, list[str]]] = {group: {} for group in LISTS}
    for noise in options("noise", config_dir):
        for group, name in _that_fit(*_with_noise(noise, config_dir, plugins), place, plugins):
            found[group].setdefault(name, []).append(noise)
    return found


def fitting_places(
    group: str, name: str, config_dir: str | None = None, plugins: Sequence[str] = ()
) -> dict[str, list[str]]:
    """By scenario, the noises with which a preset of a filter or estimator runs in it."""
    places = _scenarios(config_dir, plugins)
    found: dict[str, list[str]] = {}
    for noise in options("noise", config_dir):
        plain = composed([f"{group}=[{name}]", f"noise={noise}"], config_dir, plugins)
        try:
            errors = as_noise(construct(plain["noise"], "noise", plugins), "noise")
        except UserError:  # a preset of another package than `plugins`
            continue
        for scenario, place in places.items():
            if (group, name) in _that_fit(plain, errors, place, plugins):
                found.setdefault(scenario, []).append(noise)
    return found


def scenarios_of(
    noise: str, config_dir: str | None = None, plugins: Sequence[str] = ()
) -> list[str]:
    """The scenarios in which a filter or estimator runs with a noise."""
    plain, errors = _with_noise(noise, config_dir, plugins)
    places = _scenarios(config_dir, plugins).items()
    return [name for name, place in places if any(_that_fit(plain, errors, place, plugins))]


def _with_noise(
    noise: str, config_dir: str | None, plugins: Sequence[str]
) -> tuple[Mapping[str, Any], Noise]:
    """The config with a noise and all filters and estimators, which may be fitted to it; and the
    noise.
    """
    if config_dir is None:
        return _shipped_with_noise(noise)
    plain = composed([f"noise={noise}", *_every_estimator(config_dir)], config_dir, plugins)
    return plain, as_noise(construct(plain["noise"], "noise", plugins), "noise")


@cache
def _shipped_with_noise(noise: str) -> tuple[Mapping[str, Any], Noise]:
    plain = composed([f"noise={noise}", *_every_estimator()])
    return plain, as_noise(construct(plain["noise"], "noise"), "noise")


def _scenarios(config_dir: str | None = None, plugins: Sequence[str] = ()) -> dict[str, Scenario]:
    """The scenarios that can be built from their presets alone."""
    own = own_options("scenario", config_dir) if config_dir else ()
    return _shipped_scenarios() | _built(own, config_dir, plugins)


@cache
def _shipped_scenarios() -> dict[str, Scenario]:
    return _built(options("scenario"), None)


def _built(
    names: Iterable[str], config_dir: str | None, plugins: Sequence[str] = ()
) -> dict[str, Scenario]:
    """The scenarios with these names that can be built from their presets alone."""
    from hydra import compose

    with hydra_initialised(config_dir), explained((), config_dir):
        each = {name: compose("config", overrides=[f"scenario={name}"]) for name in names}
        nodes = {name: resolved(plain_nodes(cfg, Speller(plugins))) for name, cfg in each.items()}
    found = {}
    for name, plain in nodes.items():
        try:
            built = construct(plain["scenario"], "scenario", plugins)
            found[name] = as_scenario(built, "scenario")
        except UserError:  # a recording needs the file that it is in
            continue
    return found


def not_in_all(
    config_dir: str | None = None, plugins: Sequence[str] = ()
) -> dict[str, dict[str, str]]:
    """By group and name, the presets that `all` leaves out in every scenario, with the reason."""
    nodes = composed(_every_estimator(config_dir), config_dir, plugins)
    found: dict[str, dict[str, str]] = {}
    for group in LISTS:
        known = {name: variant_of(words) for name, words in variants(group, config_dir).items()}
        built = {n: construct(one, n, plugins) for n, one in nodes[group].items()}
        causal = {name: as_estimator(one, name).causal for name, one in built.items()}
        found[group] = {n: SMOOTHER for n, one in causal.items() if not one} | known
    return found


def fitting_estimators(scenario: Scenario, noise: Noise) -> dict[str, list[str]]:
    """By group, the shipped filters and estimators that run in this scenario with this noise."""
    found: dict[str, list[str]] = {group: [] for group in LISTS}
    for group, name in _that_fit(_shipped_estimators(), noise, scenario):
        found[group].append(name)
    return found


def causal_estimators() -> set[str]:
    """Names of the shipped filters and estimators that use no later measurements."""
    each = [pair for group in LISTS for pair in _shipped_estimators()[group].items()]
    return {name for name, node in each if as_estimator(construct(node, name), name).causal}


def fitting_noises(scenario: Scenario, estimator: Estimator) -> list[str]:
    """The shipped noises with which an estimator runs in this scenario."""
    nodes = {name: composed([f"noise={name}"])["noise"] for name in options("noise")}
    noises = {name: as_noise(construct(node, "noise"), "noise") for name, node in nodes.items()}
    return [name for name, noise in noises.items() if _fits(estimator, scenario, noise)]


def fitting_scenarios(noise: Noise, estimator: Estimator) -> list[str]:
    """The shipped scenarios in which an estimator runs with this noise."""
    return [name for name, place in _scenarios().items() if _fits(estimator, place, noise)]


@cache
def _shipped_estimators() -> dict[str, Any]:
    """The resolved config with all shipped filters and estimators."""
    return composed(_every_estimator())


def _every_estimator(config_dir: str | None = None) -> list[str]:
    """The overrides that choose all filters and estimators."""
    return [f"{group}=[{','.join(options(group, config_dir))}]" for group in LISTS]


def composed(
    overrides: Sequence[str], config_dir: str | None = None, plugins: Sequence[str] = ()
) -> dict[str, Any]:
    """The resolved config with these overrides."""
    from hydra import compose

    with hydra_initialised(config_dir), explained((), config_dir):
        cfg = compose("config", overrides=list(overrides))
        return resolved(plain_nodes(cfg, Speller(plugins)))


def _that_fit(
    plain: Mapping[str, Any], noise: Noise, scenario: Scenario, plugins: Sequence[str] = ()
) -> Iterator[tuple[str, str]]:
    """Group and name of each estimator of a config that fits."""
    for group in LISTS:
        for name, node in plain.get(group, {}).items():
            try:
                estimator = as_estimator(construct(node, name, plugins), name)
            except BadValue:  # a model that is fitted to another kind of noise
                continue
            if _fits(estimator, scenario, noise):
                yield group, name


def _fits(estimator: Estimator, scenario: Scenario, noise: Noise) -> bool:
    try:
        estimator.check(scenario, noise)
    except UserError:
        return False
    return True
