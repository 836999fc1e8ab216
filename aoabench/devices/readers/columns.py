"""The names of the columns of users' files."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

from aoabench.devices.readers.formats import opened
from aoabench.devices.readers.reading import AUTO, Reading
from aoabench.devices.readers.sources import EXISTING, KINDS
from aoabench.errors import listed

__all__ = ["EXISTING", "KINDS", "header", "shown_columns"]


def header(key: str, path: Any, reading: Reading = AUTO) -> list[str]:
    """The names of a file's columns; in Parquet with those of pandas' index, in a wide table with
    those of the long table that it makes.
    """
    return list(opened(key, path, reading).columns)


def shown_columns(columns: Sequence[str]) -> str:
    """The names of a file's columns for a message, after 'which has'; of a file that is no table,
    such as a list of passwords, nothing is quoted.
    """
    plain = all(re.fullmatch(r"[^\W\d][\w .()\[\]{}/%°#-]{0,59}", name) for name in columns if name)
    if len(columns) < 2 or not plain:
        return "no names of columns in its first line (scenario.header=[...] names those of a log)"
    return listed(columns)
