"""The exceptions that users see, and checks of parameters that raise them."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Sequence
from dataclasses import MISSING, dataclass, field, fields
from typing import Any, cast

import numpy as np

from aoabench.maths.geometry import Array


def did_you_mean(word: str, known: Iterable[str], cutoff: float = 0.6) -> str:
    """'; did you mean X?' for a misspelt word, or nothing; `cutoff`: how alike they must be."""
    close = difflib.get_close_matches(word, list(known), n=1, cutoff=cutoff)
    return f"; did you mean {close[0]!r}?" if close else ""


def shorten(text: str, most: int = 200) -> str:
    """`text`, with ` ... ` for its middle where it has more than `most` characters."""
    if len(text) <= most:
        return text
    half = (most - 5) // 2
    return f"{text[:half]} ... {text[-half:]}"


class UserError(Exception):
    """A mistake that only the user can mend: one clear line, exit status 2."""


class RunError(Exception):
    """What stopped a run and no check of its input could foresee: one clear line, exit status 1."""


class BadValue(UserError, ValueError):
    """A parameter out of range: `key`, the `value` given and what is `allowed`."""

    def __init__(self, key: str, value: object, allowed: str) -> None:
        self.key, self.value, self.allowed = key, value, allowed
        super().__init__(f"{key}={shorten(repr(value))} is not allowed; allowed: {allowed}")

    def __reduce__(self) -> tuple[type, tuple[str, object, str]]:  # so that a worker can raise it
        return type(self), (self.key, self.value, self.allowed)


class Unfit(UserError):
    """An estimator does not fit: the `group` to choose another preset of, and what is `allowed`."""

    def __init__(self, group: str, allowed: str) -> None:
        self.group, self.allowed = group, allowed
        super().__init__(f"needs another {group}: {allowed}")

    def __reduce__(self) -> tuple[type, tuple[str, str]]:
        return type(self), (self.group, self.allowed)


def check_number(
    key: str,
    value: object,
    *,
    above: float = -math.inf,
    least: float = -math.inf,
    most: float = math.inf,
    integer: bool = False,
    optional: bool = False,
) -> None:
    """Raise BadValue unless `value` is a finite number in (above, most] and [least, most] (or None
    if optional).
    """
    kind = "an integer" if integer else "a number"
    bounds = (
        [f"> {above:g}"] if above > -math.inf else [f">= {least:g}"] if least > -math.inf else []
    )
    bounds += [f"<= {most:g}"] if most < math.inf else []
    allowed = " ".join([kind, " and ".join(bounds)]).strip() + (", or null" if optional else "")
    if value is None and optional:
        return
    good = isinstance(
        value, (int, np.integer) if integer else (int, float, np.integer, np.floating)
    )
    if (
        not good
        or isinstance(value, bool)
        or (isinstance(value, float) and not math.isfinite(value))
    ):
        raise BadValue(key, value, allowed)
    if not (above < value and least <= value <= most):  # type: ignore[operator]
        raise BadValue(key, value, allowed)


def check_choice(key: str, value: object, choices: Sequence[str]) -> None:
    """Raise BadValue unless `value` is one of `choices`."""
    if value not in choices:
        raise BadValue(key, value, "one of " + ", ".join(choices))


def check_array(key: str, value: object, shape: tuple[int | None, ...]) -> Array:
    """`value` as a finite float array of `shape` (None: any length >= 1); else raise BadValue."""
    wanted = " x ".join("N" if s is None else str(s) for s in shape) + " finite numbers"
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError):
        raise BadValue(key, value, wanted) from None
    fits = array.ndim == len(shape) and all(
        a == s if s else a > 0 for a, s in zip(array.shape, shape)
    )
    if not fits or not np.all(np.isfinite(array)):
        raise BadValue(key, value, wanted)
    return array


@dataclass(frozen=True)
class Param:
    """What a parameter means and may be; `check` says what a value must fulfil.

    A number lies in (above, most] or [least, most]; a text is one of `choices`, a list of texts
    holds only these; an array has `shape` (None: any length). `also`: further values that are
    allowed whatever the rest says.
    """

    help: str
    unit: str = ""
    above: float = -math.inf
    least: float = -math.inf
    most: float = math.inf
    choices: tuple[str, ...] = ()
    shape: tuple[int | None, ...] = ()
    also: tuple[object, ...] = ()

    def check(self, key: str, value: object, kind: str) -> None:
        """Raise BadValue unless `value` fits; `kind` is the annotation: float, int | None, ..."""
        base, optional = kind.removesuffix(" | None"), kind.endswith(" | None")
        if (value is None and optional) or any(value is one or value == one for one in self.also):
            return
        if base == "bool" and not isinstance(value, bool):
            raise BadValue(key, value, "true or false" + (", or null" if optional else ""))
        if base.split(" | ")[0] in ("float", "int"):
            self._check_number(key, value, base.startswith("int"), optional)
        elif self.shape:
            check_array(key, value, self.shape)
        elif base == "Sequence[str]":
            if isinstance(value, str) or not isinstance(value, Sequence):
                raise BadValue(key, value, f"a list of {', '.join(self.choices)}")
            for one in value:
                check_choice(key, one, self.choices)
        elif base == "str":
            check_choice(key, value, self.choices) if self.choices else check_text(key, value)

    def _check_number(self, key: str, value: object, integer: bool, optional: bool) -> None:
        limits = {"above": self.above, "least": self.least, "most": self.most}
        try:
            check_number(key, value, **limits, integer=integer, optional=optional)
        except BadValue as error:
            more = "".join(f", or {one}" for one in self.also)
            raise BadValue(key, value, error.allowed + more) from None


def check_text(key: str, value: object) -> None:
    """Raise BadValue unless `value` is a text that is not empty."""
    if not isinstance(value, str) or not value.strip():
        raise BadValue(key, value, "a text")


def param(
    default: Any = MISSING,
    help: str = "",
    *,
    unit: str = "",
    above: float = -math.inf,
    least: float = -math.inf,
    most: float = math.inf,
    choices: Sequence[str] = (),
    shape: tuple[int | None, ...] = (),
    also: tuple[object, ...] = (),
) -> Any:
    """A dataclass field with its meaning and its limits; without `default` it must be given.

    `CheckedParams` checks the value by the field's annotation and these limits.
    """
    known = Param(help, unit, above, least, most, tuple(choices), shape, also)
    return field(default=default, metadata={"param": known})


class CheckedParams:
    """Checks the fields made by `param` when a dataclass is built; BadValue for what does not fit.

    A class with checks of its own calls super().__post_init__() first.
    """

    def __post_init__(self) -> None:
        for f in fields(cast(Any, self)):
            if "param" in f.metadata:
                f.metadata["param"].check(f.name, getattr(self, f.name), str(f.type))
