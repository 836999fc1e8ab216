"""The plug-ins of a module or a file, and of the presets that name them."""

from __future__ import annotations

import dataclasses
import inspect
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

from aoabench.config.adopt import as_estimator, as_noise, as_scenario
from aoabench.config.catalogue import own_presets
from aoabench.config.plugins import import_plugins, package_names
from aoabench.errors import BadValue, UserError, did_you_mean
from aoabench.roles import Estimator, Noise, Scenario
from aoabench.testing import estimators, noises, scenarios
from aoabench.testing.rules import Result, Rule, examined
from aoabench.testing.settings import setting

ROLES: dict[str, type] = {"estimator": Estimator, "noise": Noise, "scenario": Scenario}
_RULES: Mapping[str, Sequence[Rule[Any]]] = {
    "estimator": estimators.RULES,
    "noise": noises.RULES,
    "scenario": scenarios.RULES,
}


@dataclass(frozen=True)
class PlugIn:
    """A plug-in: the name of its class or preset, its role, and the object; `lacks` says why there
    is no object.
    """

    name: str
    role: str
    made: Any
    lacks: str = ""


def module_of(name: str) -> ModuleType:
    """The module of this name, or in the file NAME.py, imported; raises UserError for one that does
    not exist or cannot be imported.
    """
    if name.endswith(".py"):
        file = Path(name)
        if not file.is_file():
            raise BadValue("PLUGIN", name, "an existing file, or the name of a module")
        folder = str(file.resolve().parent)
        if folder not in sys.path:
            sys.path.insert(0, folder)
        name = file.stem
    import_plugins(package_names([name]))
    return sys.modules[name]


def plugins_of(module: ModuleType, config_dir: str | None) -> list[PlugIn]:
    """The plug-ins that a module defines: a preset of `config_dir` for each that names one of its
    classes, and each other class with its default parameters. Raises UserError if there are none.
    """
    presets = own_presets(config_dir, module.__name__) if config_dir else {}
    found = [_of_preset(group, name, made) for (group, name), made in presets.items()]
    used = {type(one.made) for one in found}
    found += [_of_class(cls) for cls in _classes(module) if cls not in used]
    if not found:
        raise UserError(
            f"{module.__name__}: no plug-in in it; allowed: a module with a class that derives "
            "from aoabench.Estimator, Filter, KalmanFilter, Noise or Scenario"
        )
    return found


def _classes(module: ModuleType) -> Iterator[type]:
    """The public classes of a role that a module defines itself."""
    for name, cls in vars(module).items():
        own = inspect.isclass(cls) and cls.__module__ == module.__name__ and name[0] != "_"
        if own and issubclass(cls, tuple(ROLES.values())):
            yield cls


def _of_preset(group: str, name: str, made: Any) -> PlugIn:
    role = "estimator" if group in ("filter", "estimator") else group
    return PlugIn(f"{group}={name}", role, made)


def _of_class(cls: type) -> PlugIn:
    role = next(role for role, base in ROLES.items() if issubclass(cls, base))
    fields = dataclasses.fields(cls) if dataclasses.is_dataclass(cls) else ()
    missing = dataclasses.MISSING
    needed = [f.name for f in fields if f.init and f.default is f.default_factory is missing]
    if needed:
        lacks = f"needs {', '.join(needed)}; a preset in --config-dir gives them"
        return PlugIn(cls.__name__, role, None, lacks)
    return PlugIn(cls.__name__, role, cls())


def tried(plugin: PlugIn, skip: Mapping[str, str]) -> list[Result]:
    """What came out of trying each rule of its role on a plug-in, but for those in `skip`."""
    rules = _RULES[plugin.role]
    mine = {name: reason for name, reason in skip.items() if name in {r.name for r in rules}}
    return examined(rules, _subject(plugin), mine)


def _subject(plugin: PlugIn) -> Any:
    """The plug-in in the simulation that it is tried in."""
    made = plugin.made
    if plugin.role == "estimator":
        adopted = as_estimator(made, plugin.name)
        return estimators.Trial(adopted, *setting(adopted, None, None))
    if plugin.role == "noise":
        return noises.Sampling(as_noise(made, plugin.name), noises.usual_scenario())
    return scenarios.Place(as_scenario(made, plugin.name))


def check_names(skip: Sequence[str]) -> None:
    """Raise UserError for a rule of no role."""
    known = [rule.name for rules in _RULES.values() for rule in rules]
    for name in skip:
        if name not in known:
            hint = did_you_mean(name, known) or f"; allowed: {', '.join(dict.fromkeys(known))}"
            raise UserError(f"--skip={name}: no such rule{hint}")
