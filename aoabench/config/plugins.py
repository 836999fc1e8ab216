"""From `_target_` nodes to objects.

`resolve` below, and never Hydra, resolves a `_target_`: its real module must lie in one of our
plug-in packages, or in a package that the user named on the command line (`plugins=[...]`).
"""

from __future__ import annotations

import dataclasses
import importlib
import os
import sys
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from aoabench.config.overrides import Setting
from aoabench.errors import BadValue, Mistakes, UserError, did_you_mean
from aoabench.maths.digest import default_of, no_default
from aoabench.params import check_field, key_of

PLUG_INS = tuple(
    f"aoabench.{room}" for room in ("scenarios", "noise", "models", "filters", "estimators")
)


def resolve(target: object, path: str, plugins: Sequence[str] = ()) -> type:
    """The class that a `_target_` names; UserError for a class that a config must not name."""
    allowed = (
        f"a dataclass in {', '.join(PLUG_INS)}, "
        f"or in a package of your own, named on the command line: 'plugins=[{_package(target)}]'"
    )
    key = f"{path}._target_"
    if not isinstance(target, str) or not all(part.isidentifier() for part in target.split(".")):
        raise BadValue(key, target, allowed)
    module_name, _, name = target.rpartition(".")
    if not _within(module_name, (*PLUG_INS, *plugins)):
        raise BadValue(key, target, allowed)
    try:
        module = importlib.import_module(module_name)
    except ImportError as error:
        raise UserError(f"{key}={target!r} cannot be imported: {error}") from None
    found = getattr(module, name, None)
    if found is None:
        raise UserError(
            f"{key}={target!r}: {module_name} has no {name!r}{did_you_mean(name, vars(module))}"
        )
    if not (isinstance(found, type) and dataclasses.is_dataclass(found)) or name.startswith("_"):
        raise BadValue(key, target, allowed)
    if not _within(found.__module__, (*PLUG_INS, *plugins)):
        raise BadValue(key, target, allowed)
    return found


def _package(target: object) -> str:
    """The package that a `_target_` lies in, ... where it names none."""
    first, dot, _ = str(target).partition(".")
    return first if dot and first.isidentifier() and first != "aoabench" else "..."


def _within(module: str, packages: Iterable[str]) -> bool:
    return any(module == p or module.startswith(p + ".") for p in packages)


def construct(node: Any, path: str, plugins: Sequence[str] = ()) -> Any:
    """The object that a plain YAML node describes; mappings need a `_target_`, lists and scalars
    stay as they are.

    Raises UserError for unknown, missing and invalid keys, all of them in one message.
    """
    if isinstance(node, list):
        return [construct(item, f"{path}[{i}]", plugins) for i, item in enumerate(node)]
    if not isinstance(node, dict):
        return node
    if "_target_" not in node:
        raise UserError(
            f"{path}: a mapping without _target_ is not allowed; "
            f"allowed: _target_ beside its keys ({', '.join(map(str, node)) or 'none'})"
        )
    cls = resolve(node["_target_"], path, plugins)
    mistakes = Mistakes()
    arguments = _arguments(cls, node, path, plugins, mistakes)
    for f in dataclasses.fields(cls):
        if f.init and f.name not in arguments and no_default(f):
            mistakes.note(UserError(f"{path}.{key_of(f)}: missing, {cls.__name__} needs it"))
    mistakes.check()
    try:
        return cls(**arguments)
    except BadValue as error:
        raise BadValue(f"{path}.{error.key}", error.value, error.allowed) from None
    except (TypeError, ValueError, AttributeError, ArithmeticError) as error:
        raise UserError(f"{path}: {error}") from None


def _arguments(
    cls: Any, node: Mapping[str, Any], path: str, plugins: Sequence[str], mistakes: Mistakes
) -> dict[str, Any]:
    """The arguments of a class from a node's values; unknown keys and values out of range are
    entered in `mistakes`.
    """
    known = {key_of(f): f for f in dataclasses.fields(cls) if f.init}
    arguments = {}
    for key, value in node.items():
        if key == "_target_":
            continue
        if key not in known:
            hint = (
                did_you_mean(str(key), known, path=f"{path}.") or f"; allowed: {', '.join(known)}"
            )
            mistakes.note(UserError(f"{path}.{key}: unknown key{hint}"))
            continue
        before = len(mistakes.found)
        given = mistakes.tried(construct, value, f"{path}.{key}", plugins)
        arguments[known[key].name] = given
        if len(mistakes.found) == before:
            try:
                check_field(known[key], given)
            except BadValue as error:
                mistakes.note(BadValue(f"{path}.{error.key}", error.value, error.allowed))
    return arguments


def parse_plugins(settings: Iterable[Setting]) -> tuple[str, ...]:
    """The packages that the user's own override `plugins=[...]` names; the last one counts."""
    found: tuple[str, ...] = ()
    for setting in settings:
        if setting.key == "plugins" and not setting.is_deletion:
            value = [] if setting.value is None else setting.value
            if not isinstance(value, list):
                text = setting.texts[0]
                raise BadValue("plugins", text, f"a list of importable packages: plugins=[{text}]")
            found = package_names(value)
    return found


def package_names(names: Iterable[object]) -> tuple[str, ...]:
    """The names as a tuple; BadValue if one is not a valid package name."""
    given = tuple(str(name) for name in names)
    for name in given:
        if not all(part.isidentifier() for part in name.split(".")):
            allowed = "a list of importable packages, e.g. plugins=[my_estimators]"
            raise BadValue("plugins", ",".join(given), allowed)
    return given


def import_plugins(plugins: Sequence[str]) -> None:
    """Import the user's own packages, from the working folder too; UserError for every exception
    that they raise.
    """
    if plugins and os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())  # last, so that installed packages are found first
    for name in plugins:
        try:
            importlib.import_module(name)
        except Exception as error:  # the user's code can raise anything
            raise UserError(
                f"plugins=[{name}]: cannot be imported: {type(error).__name__}: {error}"
            ) from None


def spelled_out(node: Any, plugins: Sequence[str] = ()) -> Any:
    """A plain YAML node with the defaults of its classes filled in, so that a thin preset shows and
    stores every parameter; a `_target_` that cannot be resolved is left as it is.
    """
    if isinstance(node, list):
        return [spelled_out(item, plugins) for item in node]
    if not isinstance(node, dict):
        return node
    given = {key: spelled_out(value, plugins) for key, value in node.items()}
    try:
        cls = resolve(node.get("_target_"), "", plugins)
    except UserError:
        return given
    whole = {"_target_": given.pop("_target_")}
    for f in dataclasses.fields(cls):
        default = None if no_default(f) else _as_node(default_of(f))
        key = key_of(f)
        if f.init and key in given:
            value = given.pop(key)
            if isinstance(default, dict) and isinstance(value, dict) and "_target_" not in value:
                value = spelled_out({"_target_": default["_target_"], **value}, plugins)
            whole[key] = value
        elif f.init and not no_default(f):
            whole[key] = default
    return whole | given


@dataclasses.dataclass
class Speller:
    """`spelled_out` for the nodes of one sweep; equal nodes share the result, which stays as it
    is. The plug-ins are imported first, so that all nodes have the defaults of their classes.
    """

    plugins: Sequence[str] = ()
    known: dict[str, Any] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        import_plugins(self.plugins)

    def __call__(self, node: Any) -> Any:
        text = repr(node)
        if text not in self.known:
            self.known[text] = spelled_out(node, self.plugins)
        return self.known[text]


def _as_node(value: Any) -> Any:
    """A default as a plain YAML node."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        name = f"{type(value).__module__}.{type(value).__qualname__}"
        inner = {key_of(f): _as_node(getattr(value, f.name)) for f in dataclasses.fields(value)}
        return {"_target_": name, **inner}
    return [_as_node(item) for item in value] if isinstance(value, list | tuple) else value
