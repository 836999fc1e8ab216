"""Exceptions for users, and the parameter checks that raise them."""

from __future__ import annotations

import difflib
import math
import os
import sys
import unicodedata
from collections.abc import Callable, Iterable, Sequence
from numbers import Real
from typing import Any, TypeVar, cast

import numpy as np

from aoabench.maths.geometry import Array

Result = TypeVar("Result")


def did_you_mean(word: str, known: Iterable[str], cutoff: float = 0.6, path: str = "") -> str:
    """Return '; did you mean X?' for a misspelt word, else ''; `cutoff` is the least similarity
    (0..1).

    `path` is the text before the proposed name.
    """
    names = {name.lower(): name for name in known}
    close = difflib.get_close_matches(word.lower(), list(names), n=1, cutoff=cutoff)
    return f"; did you mean {path + names[close[0]]!r}?" if close else ""


def near_file(path: str) -> str:
    """Return '; did you mean X?' for a path that does not exist, where the folder that it names
    has a file or folder of a similar name, else ''.
    """
    folder, name = os.path.split(path)
    if os.path.lexists(path):
        return ""
    try:
        return did_you_mean(name, sorted(os.listdir(folder or ".")), path=os.path.join(folder, ""))
    except (OSError, ValueError):
        return ""


def shorten(text: str, most: int = 200) -> str:
    """Return `text`, with ` ... ` in place of its middle if it has more than `most` characters."""
    if len(text) <= most:
        return text
    half = (most - 5) // 2
    return f"{text[:half]} ... {text[-half:]}"


def printable(text: str) -> str:
    """Return `text` with an escape such as \\x1b in place of each character that a terminal obeys
    or does not show; ends of lines stay.
    """
    if text.isprintable():
        return text
    return "".join(map(_visible, text))


def _visible(character: str) -> str:
    hidden = unicodedata.category(character)[0] == "C" or character in "\u2028\u2029"
    plain = not hidden or character == "\n"
    return character if plain else character.encode("unicode_escape").decode()


def listed(names: Sequence[object], most: int = 20) -> str:
    """Return names from a user's file, separated by commas: the first `most`, each of at most 60
    characters.
    """
    some = ", ".join(shorten(printable(str(name)), 60) for name in names[:most])
    return some + (f", ... ({len(names)})" if len(names) > most else "")


class _Line(Exception):
    """An exception whose text is safe to print."""

    def __str__(self) -> str:
        return printable(super().__str__())


class UserError(_Line):
    """A mistake in the input that the user can correct: one clear line, exit status 2."""


class ManyErrors(UserError):
    """Several mistakes in the input: a heading, and one line for `each`."""

    def __init__(self, each: Sequence[UserError]) -> None:
        self.each = tuple(each)
        lines = [" ".join(str(one).split()) for one in self.each]
        super().__init__("\n  ".join([f"{len(lines)} mistakes:", *lines]))

    def __reduce__(self) -> tuple[type, tuple[Sequence[UserError]]]:
        return type(self), (self.each,)


class Mistakes:
    """Collects the UserErrors of independent checks, so that one message shows all of them."""

    def __init__(self) -> None:
        self.found: dict[str, UserError] = {}  # by their text: each mistake once

    def note(self, error: UserError) -> None:
        """Add a mistake, or each of several."""
        for one in error.each if isinstance(error, ManyErrors) else (error,):
            self.found.setdefault(str(one), one)

    def tried(self, function: Callable[..., Result], *args: Any, **kwargs: Any) -> Result | None:
        """The result of a call, or None where it raises UserError, which is noted."""
        try:
            return function(*args, **kwargs)
        except UserError as error:
            self.note(error)
            return None

    def check(self) -> None:
        """Raise the mistake, or ManyErrors for several; nothing without any."""
        each = list(self.found.values())
        if each:
            raise each[0] if len(each) == 1 else ManyErrors(each)


class RunError(_Line):
    """An error that stops a run and that no check of the input can find: one clear line, exit
    status 1.
    """


class WriteError(OSError):
    """A file could not be written: errno, the system's reason, and the file's name."""


class BadValue(UserError, ValueError):
    """A parameter out of range: its `key`, the given `value`, and the `allowed` values in words."""

    def __init__(self, key: str, value: object, allowed: str) -> None:
        self.key, self.value, self.allowed = key, value, allowed
        super().__init__(f"{key}={shorten(repr(value))} is not allowed; allowed: {allowed}")

    def __reduce__(self) -> tuple[type, tuple[str, object, str]]:  # so that a worker can raise it
        return type(self), (self.key, self.value, self.allowed)


class Unfit(UserError):
    """An estimator does not fit; the message names the config `group` to change and the presets
    `allowed`.
    """

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
    """Raise BadValue unless `value` is a finite number in (above, most] and [least, most], or None
    if `optional`.
    """
    allowed = "an integer" if integer else "a number"
    allowed += _limits(above, least, most) + (", or null" if optional else "")
    if value is None and optional:
        return
    kinds = (int, np.integer) if integer else (int, float, np.integer, np.floating)
    if not isinstance(value, kinds) or isinstance(value, bool):
        raise BadValue(key, value, allowed)
    number = value.item() if isinstance(value, np.generic) else cast(float, value)
    if not (abs(number) <= sys.float_info.max and above < number and least <= number <= most):
        raise BadValue(key, value, allowed)


def _limits(above: float, least: float, most: float) -> str:
    """The limits as text, such as ' > 0 and <= 5'; '' without limits."""
    limits = [f"> {above:g}"] if above > -math.inf else []
    limits += [f">= {least:g}"] if least > -math.inf else []
    limits += [f"<= {most:g}"] if most < math.inf else []
    return f" {' and '.join(limits)}" if limits else ""


def check_choice(key: str, value: object, choices: Sequence[str]) -> None:
    """Raise BadValue unless `value` is one of `choices`."""
    if not isinstance(value, str) or value not in choices:
        raise BadValue(key, value, "one of " + ", ".join(choices))


def check_text(key: str, value: object) -> None:
    """Raise BadValue unless `value` is a non-empty string."""
    if not isinstance(value, str) or not value.strip():
        raise BadValue(key, value, "a text that is not empty")


def check_bool(key: str, value: object) -> None:
    """Raise BadValue unless `value` is True or False."""
    if not isinstance(value, bool):
        raise BadValue(key, value, "true or false")


def check_array(
    key: str,
    value: object,
    shape: tuple[int | None, ...],
    *,
    above: float = -math.inf,
    least: float = -math.inf,
    most: float = math.inf,
) -> Array:
    """Return `value` as a float array of `shape` (None: any length >= 1).

    Raises BadValue for another shape, and for a number that is not finite or not in (above, most]
    and [least, most].
    """
    wanted = " x ".join("N" if s is None else str(s) for s in shape) + " finite numbers"
    wanted += _limits(above, least, most)
    try:
        array = np.array(value, dtype=float)
        cells = np.array(value, dtype=object).ravel()
    except (TypeError, ValueError):
        raise BadValue(key, value, wanted) from None
    fits = array.ndim == len(shape) and all(
        a == s if s else a > 0 for a, s in zip(array.shape, shape)
    )
    fits = fits and all(isinstance(c, Real) and not isinstance(c, bool) for c in cells)
    good = np.isfinite(array) & (array > above) & (array >= least) & (array <= most)
    if not fits or not np.all(good):
        raise BadValue(key, value, wanted)
    return array
