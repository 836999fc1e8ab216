"""Check a user's objects against their roles; only this module inspects their attributes.

Scenarios, noises and measurement models derive from the base classes in `roles`. An estimator may
also be any callable (batch, scenario, streams) -> Estimates: an object, a function, a lambda.
"""

from __future__ import annotations

import dataclasses
import inspect
import warnings
from typing import Any

from aoabench.errors import BadValue, UserError, did_you_mean
from aoabench.roles import (
    NEEDS,
    Estimator,
    Filter,
    Measurement,
    Motion,
    Noise,
    PlainEstimator,
    Scenario,
)

# members of earlier versions, and their present names
RENAMED = {
    "known_anchors": "true_anchors",
    "same_truth": "shares_positions",
    "reported": "hears",
    "days_of": "day_of",
    "segments": "wall_segments",
    "sees_truth": 'needs = frozenset({"truth"})',
}
_OPTIONAL = ("tile", "needs", "check", "prepare", "trace", "files", "cache_key")


def as_scenario(obj: Any, path: str) -> Scenario:
    """The object, if it is a scenario; UserError otherwise."""
    _check_renamed(obj, path, set(RENAMED))
    if not isinstance(obj, Scenario):
        raise UserError(f"{path}: {_name(obj)} must derive from aoabench.Scenario")
    _check_spelling(obj, Scenario, path)
    if not isinstance(obj.name, str) or not obj.name:
        raise BadValue(f"{path}.name", obj.name, "a text, which keys the random streams")
    if obj.motion is not None and not isinstance(obj.motion, Motion):
        raise UserError(f"{path}.motion: {_name(obj.motion)} must derive from aoabench.Motion")
    return obj


def as_noise(obj: Any, path: str) -> Noise:
    """The object, if it is a noise; UserError otherwise."""
    if not isinstance(obj, Noise):
        raise UserError(f"{path}: {_name(obj)} must derive from aoabench.Noise")
    _check_spelling(obj, Noise, path)
    return obj


def as_estimator(obj: Any, path: str) -> Estimator:
    """The object as an estimator: itself, or wrapped if it is a bare callable.

    Raises UserError for an object that cannot be called and for an invalid tile or needs.
    """
    _check_renamed(obj, path, {"sees_truth"})
    if not isinstance(obj, Estimator):
        if not callable(obj) or isinstance(obj, type):
            allowed = "a callable (batch, scenario, streams) -> Estimates"
            raise UserError(f"{path}: {_name(obj)} cannot be called; allowed: {allowed}")
        _check_spelling(obj, Estimator, path)
        obj = _wrapped(obj, path)
    else:
        _check_spelling(obj, Filter if isinstance(obj, Filter) else Estimator, path)
    tile = obj.tile
    if tile is not None and (isinstance(tile, bool) or not isinstance(tile, int) or tile < 1):
        raise BadValue(f"{path}.tile", tile, "an integer >= 1, or None")
    if isinstance(obj, Filter) and not isinstance(obj.measurement, Measurement):
        name = _name(obj.measurement)
        raise UserError(f"{path}.measurement: {name} must derive from aoabench.Measurement")
    for need in obj.needs:
        if need not in NEEDS:
            hint = did_you_mean(str(need), NEEDS)
            raise BadValue(f"{path}.needs", need, f"{', '.join(NEEDS)}{hint}")
    found: Estimator = obj
    return found


def _wrapped(function: Any, path: str) -> Estimator:
    """A bare callable as an estimator, with the optional members that it has."""
    given = {name: getattr(function, name) for name in _OPTIONAL if hasattr(function, name)}
    if "check" in given and len(inspect.signature(given["check"]).parameters) != 2:
        raise UserError(f"{path}.check: must take two arguments, (scenario, noise)")
    found = PlainEstimator(function)
    for name, value in (given | {"label": _name(function)}).items():
        object.__setattr__(found, name, value)
    return found


def _check_renamed(obj: Any, path: str, names: set[str]) -> None:
    """Raise UserError for a member that has been renamed."""
    for old in sorted(names):
        if hasattr(type(obj), old):
            raise UserError(f"{path}: {_name(obj)}.{old} is called {RENAMED[old]} now; rename it")


def _check_spelling(obj: Any, role: type, path: str) -> None:
    """Warn if a member of a user's class has a name that looks like a misspelt name of a member of
    its role.
    """
    known = {name for name in dir(role) if not name.startswith("_")}
    known |= set(role.__annotations__)
    own = [
        c
        for c in type(obj).__mro__
        if not c.__module__.startswith(("aoabench.", "builtins", "functools"))
    ]
    names = {name for c in own for name in (*vars(c), *inspect.get_annotations(c))}
    names -= {f.name for f in dataclasses.fields(obj)} if dataclasses.is_dataclass(obj) else set()
    for name in sorted(names - known):
        if not name.startswith("_") and (hint := did_you_mean(name, known, 0.7)):
            word = role.__name__.lower()
            text = f"{path}: {_name(obj)}.{name} is not used: no member of the role {word}{hint}"
            warnings.warn(text, stacklevel=2)


def _name(obj: Any) -> str:
    return getattr(obj, "__qualname__", None) or type(obj).__qualname__
