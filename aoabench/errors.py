"""The exceptions that users see, and checks of parameters that raise them."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Sequence

import numpy as np

from aoabench.maths.geometry import Array


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """'; did you mean X?' for a misspelt word, or nothing."""
    close = difflib.get_close_matches(word, list(known), n=1, cutoff=0.6)
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
