"""Loaded code and objects against their source: what a program has changed at run time, as values.

A class attribute, a global variable or a method may differ from what the source says. Plain values
become part of a key; anything else is `NotPlain`, and results that depend on it are not reused.
"""

from __future__ import annotations

import ast
import enum
import functools
import hashlib
import inspect
import logging
import re
import sys
import types
from collections import namedtuple
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path, PurePath
from typing import Any, NamedTuple

import numpy as np

from aoabench import loaded
from aoabench.errors import UserError
from aoabench.store.reach import Reach

_UNSTATED = object()
_FIELD = type(vars(namedtuple("_Pair", "first second"))["first"])  # of a named tuple
_HARMLESS = (
    *(types.ModuleType, types.GenericAlias, types.MemberDescriptorType, logging.Logger, _FIELD),
)
_MACHINERY = ("_abc_impl", "_fields", "_field_defaults", "_is_protocol")  # Python's own
_OF_NUMBA = ("numba.", "aoabench.kernels.compile")  # their objects hold a function as `py_func`


class NotPlain(Exception):
    """Something whose content cannot be stated as a value; the text says what and why."""


def plain(value: Any, name: str = "value") -> Any:
    """The content of a value as lists, dicts, numbers and strings; NotPlain if it has another
    type, or attributes that its dataclass does not declare.
    """
    if value is None or isinstance(value, bool | int | float | str | complex | bytes):
        return (
            value if value is None or isinstance(value, bool | int | float | str) else repr(value)
        )
    if isinstance(value, enum.Enum | PurePath | re.Pattern | range | slice):
        return repr(value)
    if isinstance(value, np.ndarray | np.generic) and value.dtype != object:
        content = hashlib.blake2b(np.ascontiguousarray(value).tobytes()).hexdigest()
        return [str(value.dtype), list(np.shape(value)), content]
    if isinstance(value, list | tuple):
        return [plain(one, f"{name}[{i}]") for i, one in enumerate(value)]
    if isinstance(value, set | frozenset):
        return sorted((plain(one, name) for one in value), key=repr)
    if isinstance(value, Mapping) and type(value) in (dict, types.MappingProxyType):
        return [[plain(k, name), plain(v, f"{name}[{k!r}]")] for k, v in value.items()]
    if isinstance(value, types.MethodType):
        return [plain(v, name) for v in (value.__self__, value.__func__)]
    if isinstance(value, functools.partial):
        return [plain(v, name) for v in (value.func, value.args, value.keywords)]
    if isinstance(value, type) or isinstance(function_in(value), types.FunctionType):
        return _importable(value, name)
    if is_dataclass(value):
        return _dataclass(value, name)
    raise NotPlain(f"{name} is a {type(value).__qualname__}, which is no plain value")


def _dataclass(value: Any, name: str) -> Any:
    """The fields of an object whose whole state they are."""
    cls = type(value)
    if "__dataclass_fields__" not in vars(cls):
        raise NotPlain(f"{name}: {cls.__qualname__} derives from a dataclass and is none itself")
    given = {f.name: getattr(value, f.name) for f in fields(value)}
    cached = {n for c in cls.__mro__ for n, v in vars(c).items() if _is_cached(v)}
    shipped = cls.__module__.startswith("aoabench.")
    try:
        own = vars(value)
    except TypeError:  # its slots are its fields
        own = {}
    more = [] if shipped else sorted(set(own) - set(given) - cached)
    if more:
        raise NotPlain(f"{name}: {cls.__qualname__} has {more[0]!r}, which is no field")
    taken = {n: f.type for n, f in cls.__dataclass_fields__.items() if n not in given}
    if hidden := [n for n, kind in taken.items() if "InitVar" in str(kind)]:
        raise NotPlain(f"{name}: {cls.__qualname__} takes {hidden[0]!r}, which it does not keep")
    inner = {n: plain(v, f"{name}.{n}") for n, v in given.items()}
    return [_importable(cls, name), sorted(inner.items())]


def _is_cached(value: object) -> bool:
    return isinstance(value, functools.cached_property)


def _importable(value: Any, name: str) -> str:
    """Module and name of a class or function; NotPlain unless it is found under them."""
    function = function_in(value)
    module, path = function.__module__, function.__qualname__
    found: Any = sys.modules.get(module)
    for part in path.split("."):
        known = isinstance(found, type | types.ModuleType)
        found = vars(found).get(part, _UNSTATED) if known else _UNSTATED
    if found is not value and function_in(found) is not function:
        raise NotPlain(f"{name} is {path}, which cannot be imported from {module} by its name")
    return f"{module}.{path}"


def function_in(value: Any) -> Any:
    """The function inside what decorators of Python, numba and kernels make of one, or the value
    itself.
    """
    while True:
        if isinstance(value, staticmethod | classmethod | types.MethodType):
            value = value.__func__
        elif isinstance(value, property):
            value = value.fget
        elif isinstance(value, functools.cached_property):
            value = value.func
        elif isinstance(value, functools._lru_cache_wrapper):
            value = value.__wrapped__
        elif type(value).__module__.startswith(_OF_NUMBA):
            return getattr(value, "py_func", value)
        else:
            return value


def changes(reach: Reach) -> list[Any]:
    """Values that the loaded code has instead of those in its source, by module and name, and the
    values of the user's own variables.

    Raises NotPlain for a replaced function or a variable that is no plain value, and UserError for
    a module whose file was changed after it was imported.
    """
    found: list[Any] = []
    for (module, name), definition in sorted(reach.definitions.items(), key=lambda d: repr(d[0])):
        live = sys.modules.get(module)
        if live is not None and name is not None and name in vars(live):
            found += _changes(_Place(module, name), definition.nodes[-1], vars(live)[name])
    for module, name in sorted(reach.values, key=repr):
        live = sys.modules.get(module)
        if live is not None and name is not None and name in vars(live):
            found += _values(f"{module}.{name}", vars(live)[name])
    return found


class _Place(NamedTuple):
    """Where something is defined: a module, and the path of names inside it."""

    module: str
    path: str

    def __str__(self) -> str:
        return f"{self.module}.{self.path}"

    @property
    def name(self) -> str:
        return self.path.rpartition(".")[2]

    @property
    def shipped(self) -> bool:
        return self.module.startswith("aoabench.")

    def replaced(self) -> NotPlain:
        return NotPlain(f"{self} is not what its source says; it was replaced or wrapped")


def _changes(place: _Place, node: ast.stmt, value: Any) -> Iterator[Any]:
    """What differs between the statement that defines a name, and its live value."""
    if isinstance(node, ast.ClassDef):
        if not isinstance(value, type):
            raise place.replaced()
        yield from _class_changes(place, node, value)
    elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
        _check_function(place, node, value)
    else:
        stated = _literal(node)
        if stated is _UNSTATED:
            yield from () if place.shipped else _values(str(place), value)
        elif not _same(stated, value):
            yield from _values(str(place), value)


def _class_changes(place: _Place, node: ast.ClassDef, cls: type) -> Iterator[Any]:
    """The attributes of a class that differ from its source."""
    if (cls.__module__, cls.__qualname__) != place:
        raise place.replaced()
    if issubclass(cls, enum.Enum):
        yield from () if place.shipped else [[str(place), plain([m.value for m in cls])]]
        return
    stated = {n.name: n for n in node.body if isinstance(n, ast.FunctionDef | ast.ClassDef)}
    values = {name: _literal(n) for n in node.body for name in _targets(n)}
    for name, value in vars(cls).items():
        inner = _Place(place.module, f"{place.path}.{name}")
        known, literal = stated.get(name), values.get(name, _UNSTATED)
        if isinstance(known, ast.ClassDef):
            yield from _changes(inner, known, value)
        elif known is not None:
            _check_function(inner, known, value)
        elif isinstance(function_in(value), types.FunctionType):
            _check_unstated(inner, node, function_in(value))
        elif literal is not _UNSTATED:
            yield from () if _same(literal, value) else _values(str(inner), value)
        elif not (
            name.startswith("__") or name in _MACHINERY or (place.shipped and name in values)
        ):
            yield from _values(str(inner), value)
    if missing := [name for name in stated if name not in vars(cls)]:
        raise _Place(place.module, f"{place.path}.{missing[0]}").replaced()


def _check_function(place: _Place, node: Any, value: Any) -> None:
    """Raise NotPlain unless a live function is the one in the source, and UserError if the source
    is another one by now.
    """
    function = function_in(value)
    if node.decorator_list and isinstance(function, types.FunctionType):
        function = inspect.unwrap(function)
    if not isinstance(function, types.FunctionType):
        if type(function).__module__.startswith("numba."):
            return  # one of numba's own kinds, which keeps no function
        raise place.replaced()
    code = function.__code__
    lines = {node.lineno, *(d.lineno for d in node.decorator_list)}
    if code.co_qualname != place.path or loaded.differs_from_source(place.module, code):
        _check_source(place, code)
        raise place.replaced()
    if code.co_firstlineno not in lines:
        raise place.replaced()
    stated = [_literal_of(d) for d in (*node.args.defaults, *filter(None, node.args.kw_defaults))]
    live = [*(function.__defaults__ or ()), *(function.__kwdefaults__ or {}).values()]
    if any(a is not _UNSTATED and not _same(a, b) for a, b in zip(stated, live)):
        raise NotPlain(f"the defaults of {place} are not those in its source")


def _check_source(place: _Place, code: types.CodeType) -> None:
    """Raise UserError if a function comes from its module's file, which says something else now."""
    known = loaded.source(place.module)
    if known and not known.certain and code.co_filename == str(known.path):
        raise UserError(f"{known.path} was changed after it was imported; start again")


def _check_unstated(place: _Place, node: ast.ClassDef, function: types.FunctionType) -> None:
    """Raise NotPlain for a function of a class that neither its source nor Python put there."""
    code, known = function.__code__, loaded.source(place.module)
    generated = code.co_filename.startswith("<") and place.name.startswith("__")
    if generated or code.co_filename.startswith("namedtuple_") or loaded.is_standard(code):
        return
    inside = node.lineno <= code.co_firstlineno <= (node.end_lineno or 0)
    if known is None or Path(code.co_filename) != known.path or not inside:
        raise place.replaced()


def _values(where: str, value: Any) -> Iterator[Any]:
    """The value of a variable, unless its type says that it holds no data."""
    if not isinstance(value, _HARMLESS) and type(value).__module__ != "typing":
        yield [where, plain(value, where)]


def _targets(node: ast.stmt) -> list[str]:
    """The single names that an assignment binds."""
    targets = node.targets if isinstance(node, ast.Assign) else []
    targets = [node.target] if isinstance(node, ast.AnnAssign) else targets
    return [t.id for t in targets if isinstance(t, ast.Name)]


def _literal(node: ast.stmt) -> Any:
    """The value of an assignment of a literal to one name; _UNSTATED for any other."""
    if isinstance(node, ast.Assign | ast.AnnAssign) and node.value and _targets(node):
        return _literal_of(node.value)
    return _UNSTATED


def _literal_of(node: ast.expr) -> Any:
    try:
        return ast.literal_eval(node)
    except (ValueError, TypeError, SyntaxError, MemoryError, RecursionError):
        return _UNSTATED


def _same(stated: Any, value: Any) -> bool:
    """Whether two plain values are equal, types included; sets have no order."""
    try:
        return type(stated) is type(value) and repr(plain(stated)) == repr(plain(value))
    except NotPlain:
        return False
