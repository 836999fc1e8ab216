"""Parameters of plug-ins: each states its default, meaning and limits where it is declared.

    @dataclass(frozen=True)
    class Mean(Estimator):
        horizon_deg: float = param(1.0, "least angle between ray and plane", above=0, most=89)

`Mean(horizon_deg=90)` raises BadValue, from Python as from YAML.
"""

from __future__ import annotations

import inspect
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import MISSING, Field, dataclass, field, fields
from functools import partial
from pathlib import Path
from typing import Any, cast

from aoabench.errors import (
    BadValue,
    check_array,
    check_bool,
    check_choice,
    check_number,
    check_text,
)
from aoabench.loaded import DataFile

Check = Callable[[str, object], object]  # of a key and a value; raises BadValue

_LISTS = {"str": "texts", "int": "integers", "float": "numbers", "bool": "true and false"}


@dataclass(frozen=True)
class Param:
    """The meaning of a parameter and its limits within its type annotation; see `param`."""

    help: str
    unit: str = ""
    above: float = -math.inf
    least: float = -math.inf
    most: float = math.inf
    choices: tuple[str, ...] = ()
    shape: tuple[int | None, ...] = ()
    kind: type | None = None
    also: tuple[object, ...] = ()
    allowed: str = ""
    key: str = ""

    def check(self, key: str, value: object, annotation: str) -> None:
        """Raise BadValue unless `value` fits; `annotation` is the field's, such as int | None."""
        optional = "None" in annotation.split(" | ") and annotation != "None"
        if value is None and optional:
            return
        if any(isinstance(value, type(one)) and value == one for one in self.also):
            return
        listed = annotation.startswith(("Sequence[", "tuple["))
        if isinstance(value, str) and listed and "str" in annotation.split(" | "):
            return check_text(key, value)
        try:
            self.check_of(annotation)(key, value)
        except BadValue as error:
            more = [*map(str, self.also), *(["null"] if optional else [])]
            words = self.allowed or "".join([error.allowed, *(f", or {one}" for one in more)])
            raise BadValue(key, error.value, words) from None

    def check_of(self, annotation: str) -> Check:
        """The check for values other than null; raises TypeError for an unknown annotation."""
        kinds = [kind for kind in annotation.split(" | ") if kind != "None"] or ["None"]
        first = kinds[0]
        limits: dict[str, Any] = {"above": self.above, "least": self.least, "most": self.most}
        if self.kind is not None and self.kind.__name__ in kinds:
            return partial(self._check_object, text="str" in kinds)
        if first in ("float", "int"):
            return partial(check_number, integer=first == "int", **limits)
        if first == "bool":
            return check_bool
        if first == "str":
            return partial(check_choice, choices=self.choices) if self.choices else check_text
        if first == "None":
            return _check_null
        if self.shape and re.fullmatch(r"(Sequence|tuple)\[.*float\]+", first):
            return partial(check_array, shape=self.shape, **limits)
        if found := re.fullmatch(r"Sequence\[(str|int|float|bool|Any)\]", first):
            return partial(self._check_list, of=found[1])
        raise TypeError(f"a parameter of the type {annotation} has no check")

    def _check_list(self, key: str, value: object, of: str) -> None:
        if isinstance(value, str) or not isinstance(value, Sequence):
            words = ", ".join(self.choices) or _LISTS.get(of, "values")
            raise BadValue(key, value, f"a list of {words}")
        if of != "Any":
            for one in value:
                self.check_of(of)(key, one)

    def _check_object(self, key: str, value: object, text: bool) -> None:
        assert self.kind is not None
        if not isinstance(value, self.kind) and not (text and isinstance(value, str) and value):
            name, module = self.kind.__name__, self.kind.__module__
            path = f"aoabench.{name}" if module == "aoabench.roles" else f"{module}.{name}"
            raise BadValue(key, value, f"a {name}: its class must derive from {path}")


def _check_null(key: str, value: object) -> None:
    if value is not None:
        raise BadValue(key, value, "null")


def param(  # noqa: PLR0913 - one argument per limit
    default: Any = MISSING,
    help: str = "",
    *,
    unit: str = "",
    above: float = -math.inf,
    least: float = -math.inf,
    most: float = math.inf,
    choices: Sequence[str] = (),
    shape: tuple[int | None, ...] = (),
    kind: type | None = None,
    also: tuple[object, ...] = (),
    allowed: str = "",
    key: str = "",
) -> Any:
    """Return a dataclass field with its meaning and limits; required without `default`. A class
    with such fields derives from CheckedParams, as the roles do.

    help, unit: the meaning. above, least, most: a number, or each number of an array or a list,
    lies in (above, most] and [least, most]. choices: the strings that are allowed, alone or in a
    list. shape: the shape of an array of numbers, None for any length >= 1. kind: the class of an
    object. also: further values that are allowed without these checks. allowed: the text of error
    messages, in place of the one made from these fields. key: the name in a config, if it is not
    the field's own.
    """
    some = tuple(choices)
    known = Param(help, unit, above, least, most, some, shape, kind, also, allowed, key)
    return field(default=default, metadata={"param": known})


def key_of(f: Field[Any]) -> str:
    """The name of a dataclass's field in a config."""
    known = f.metadata.get("param")
    return (known.key if known else "") or f.name


def allowed(f: Field[Any]) -> str:
    """The allowed values of a field made by `param` in words, as in its error message."""
    try:
        f.metadata["param"].check(key_of(f), object(), _annotation(f.type))
    except BadValue as error:
        return error.allowed
    return ""


class CheckedParams:
    """Check the fields made by `param`.

    Raises BadValue when an object is built with a value that does not fit, and TypeError when a
    class is defined with an annotation that has no check. A class with checks of its own calls
    super().__post_init__() first.

    files: the data files that the numbers depend on, as paths or as read; their content is part of
    the key of results.
    """

    @property
    def files(self) -> Sequence[Path | DataFile]:
        return ()

    def cache_key(self) -> Any:
        """A plain value that stands for everything that the numbers depend on, apart from
        parameters, files and source code; None: nothing else. Results are reused if it is the same.
        """
        return None

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        types = inspect.get_annotations(cls)
        for name, value in vars(cls).items():
            if isinstance(value, Field) and "param" in value.metadata:
                value.metadata["param"].check_of(_annotation(types[name]))

    def __post_init__(self) -> None:
        for f in fields(cast(Any, self)):
            check_field(f, getattr(self, f.name))


def check_field(f: Field[Any], value: object) -> None:
    """Raise BadValue unless `value` fits the field `f`; a field that `param` did not make takes any
    value.
    """
    if "param" in f.metadata:
        f.metadata["param"].check(key_of(f), value, _annotation(f.type))


def _annotation(kind: object) -> str:
    """The annotation as written in the source, such as Sequence[float] | None."""
    text = kind if isinstance(kind, str) else inspect.formatannotation(kind)
    return re.sub(r"[\w.]+\.", "", text)
