"""The columns of users' files in CSV or Parquet: their names, and what their cells are."""

from __future__ import annotations

import csv
import json
import os
import re
from collections.abc import Sequence
from io import BytesIO, TextIOWrapper
from pathlib import Path
from typing import TYPE_CHECKING

from aoabench import loaded
from aoabench.errors import BadValue, listed

if TYPE_CHECKING:
    import pyarrow as pa

KINDS = "CSV file in UTF-8 (.csv) or Parquet file (.parquet)"
EXISTING = f"existing {KINDS}"


def header(key: str, path: object) -> list[str]:
    """The names of the file's columns, and in Parquet those of pandas' index."""
    parquet = is_parquet(key, path)
    try:
        if parquet:
            import pyarrow.parquet as pq

            stored = pq.read_schema(BytesIO(content_of(path)))
            return [*stored.names, *ranges_of(stored)]
        with TextIOWrapper(BytesIO(content_of(path)), encoding="utf-8-sig", newline="") as file:
            found = [name.strip() for name in next(csv.reader(file), [])]
    except (OSError, ValueError, csv.Error) as error:
        raise BadValue(key, path, f"a readable {KINDS}; {reason_of(error)}") from None
    if not any(found):
        raise BadValue(key, path, f"a {KINDS} whose first line names its columns; line 1 is empty")
    return found


def content_of(path: object) -> bytes:
    """The bytes of a file, read once."""
    return loaded.read(Path(str(path)))[0]


def ranges_of(found: pa.Schema) -> dict[str, range]:
    """The indices that pandas stores as ranges, not as columns, by their names."""
    try:
        stored = json.loads((found.metadata or {}).get(b"pandas", b"{}"))["index_columns"]
        ranges = [one for one in stored if isinstance(one, dict) and one.get("name") is not None]
        return {str(r["name"]): range(r["start"], r["stop"], r["step"]) for r in ranges}
    except (ValueError, KeyError, TypeError):  # written by others
        return {}


def shown_columns(columns: Sequence[str]) -> str:
    """The names of a file's columns for a message, after 'which has'; of a file that is no table,
    such as a list of passwords, nothing is quoted.
    """
    plain = all(re.fullmatch(r"[^\W\d][\w .()\[\]/%°#-]{0,59}", name) for name in columns if name)
    if len(columns) < 2 or not plain:
        return "no names of columns, separated by commas, in line 1"
    return listed(columns)


def is_parquet(key: str, path: object) -> bool:
    if not isinstance(path, str) or not os.path.isfile(path):
        folder = "; this is a folder" if isinstance(path, str) and os.path.isdir(path) else ""
        raise BadValue(key, path, f"an {EXISTING}{folder}")
    kind = os.path.splitext(path)[1].lower()
    if kind not in (".csv", ".parquet"):
        raise BadValue(key, path, f"a {KINDS}")
    return kind == ".parquet"


def reason_of(error: Exception) -> str:
    if isinstance(error, UnicodeDecodeError):
        return f"byte {error.start} is not UTF-8"
    lines = str(getattr(error, "strerror", None) or error).strip().splitlines()
    return lines[0] if lines else type(error).__name__


def is_plain(kind: pa.DataType) -> bool:
    """Whether the cells of a column are single texts, numbers or times."""
    import pyarrow as pa

    kinds = pa.types
    if kinds.is_dictionary(kind) or kinds.is_run_end_encoded(kind):
        kind = kind.value_type
    plain = (kinds.is_string, kinds.is_large_string, kinds.is_string_view, kinds.is_integer,
             kinds.is_floating, kinds.is_decimal, kinds.is_boolean, kinds.is_timestamp,
             kinds.is_date, kinds.is_null)  # fmt: skip
    return any(one(kind) for one in plain)
