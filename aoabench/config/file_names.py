"""Names of files and folders as values of overrides: quoted as Hydra's grammar needs it."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

# a value between commas: in quotes, or up to the next comma
_PIECE = re.compile(r"""\s*("(?:[^"\\]|\\.)*"|'(?:[^'\\]|\\.)*')\s*(?=,|$)|[^,]*""", re.DOTALL)
_UNREADABLE = object()
# a Windows network name, \\SERVER\SHARE, of which Hydra would read one backslash
_SHARE = re.compile(r"(^|,)\s*\\\\")


def quoted_names(parser: Any, value: str, sweep: bool) -> str:
    """The value of a key in PATH_KEYS as Hydra reads it: names that Hydra would not read as text
    are quoted, with `sweep` each one between commas.
    """
    from hydra.core.override_parser.types import ChoiceSweep

    found: Any = _UNREADABLE if _SHARE.search(value) else _parsed_value(parser, value)
    simple_sweep = isinstance(found, ChoiceSweep) and found.simple_form
    if simple_sweep and sweep and all(map(_stays, found.list)):
        return value
    if not simple_sweep and _stays(found):
        return value
    if not sweep or "," not in value:
        return quoted(value.strip())
    return ",".join(quoted_names(parser, piece.strip(), False) for piece in _pieces(value))


def quoted_folder(parser: Any, value: str, sweep: bool) -> str:
    """The value of runner.out as Hydra reads it: the folder of exactly this name, unless the value
    is in quotes, holds an interpolation, or is a sweep, which is refused later.
    """
    from hydra.core.override_parser.types import QuotedString, Sweep

    found = _parsed_value(parser, value)
    kept = isinstance(found, QuotedString) or "${" in value
    if not kept and sweep and (isinstance(found, Sweep) or "," in value):
        return quoted_names(parser, value, sweep)
    return value if kept else quoted(value)


def _stays(found: Any) -> bool:
    """Whether a value that Hydra has parsed needs no quotes: it is a text, or cannot be a file name
    (null, a list, a mapping, a sweep by a function).
    """
    return found is not _UNREADABLE and not isinstance(found, bool | int | float)


def _parsed_value(parser: Any, value: str) -> Any:
    """The value as Hydra's grammar reads it, or _UNREADABLE."""
    from hydra.errors import HydraException

    try:
        return parser.parse_rule(f"key={value}", "override")._value
    except (HydraException, RecursionError):
        return _UNREADABLE


def _pieces(value: str) -> Iterator[str]:
    """The values between the commas of a text; commas in quotes do not separate."""
    position = 0
    while position <= len(value):
        match = _PIECE.match(value, position)
        assert match  # the second alternative fits everything
        yield match[0]
        position = match.end() + 1


def quoted(text: str) -> str:
    """`text` in quotes, as Hydra's grammar wants it."""
    from hydra.core.override_parser.types import Quote, QuotedString

    return str(QuotedString(text, Quote.single).with_quotes())
