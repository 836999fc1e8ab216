"""The names of the columns of users' files."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

from aoabench.devices.readers.formats import opened
from aoabench.devices.readers.reading import AUTO, Reading
from aoabench.devices.readers.sources import EXISTING, KINDS
from aoabench.errors import listed

__all__ = ["EXISTING", "KINDS", "found_column", "header", "shown_columns"]


def header(key: str, path: Any, reading: Reading = AUTO) -> list[str]:
    """The names of a file's columns; in Parquet with those of pandas' index, in a wide table with
    those of the long table that it makes.
    """
    return list(opened(key, path, reading).columns)


def found_column(names: Sequence[str], columns: Sequence[str]) -> str | None:
    """The first of the `names` among a file's columns, else the only column that is one of them in
    other case or with other marks, else None.
    """
    exact = next((one for one in names if one in columns), None)
    alike = [one for one in columns if _plain(one) in names]
    return alike[0] if exact is None and len(alike) == 1 else exact


def _plain(name: str) -> str:
    """A name in lower case with _ for all marks."""
    return re.sub(r"[\W_]+", "_", name.lower().replace("°", "deg")).strip("_")


def shown_columns(columns: Sequence[str]) -> str:
    """The names of a file's columns for a message, after 'which has'; of a file that is no table,
    such as a list of passwords, nothing is quoted.
    """
    plain = all(re.fullmatch(r"[^\W\d][\w .()\[\]{}/%°#-]{0,59}", name) for name in columns if name)
    if len(columns) < 2 or not plain:
        return "no names of columns in its first line (scenario.header=[...] names those of a log)"
    return listed(columns)
