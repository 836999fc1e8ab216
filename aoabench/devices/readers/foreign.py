"""What libraries say about users' files: errors, types of cells, and indices of pandas."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pyarrow as pa


def ranges_of(found: pa.Schema) -> dict[str, range]:
    """The indices that pandas stores as ranges, not as columns, by their names."""
    try:
        stored = json.loads((found.metadata or {}).get(b"pandas", b"{}"))["index_columns"]
        ranges = [one for one in stored if isinstance(one, dict) and one.get("name") is not None]
        return {str(r["name"]): range(r["start"], r["stop"], r["step"]) for r in ranges}
    except (ValueError, KeyError, TypeError):  # written by others
        return {}


def reason_of(error: Exception) -> str:
    """The reason that an exception of a library states, in one line."""
    if isinstance(error, UnicodeDecodeError):
        return f"byte {error.start} is not UTF-8: save the file in UTF-8"
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
