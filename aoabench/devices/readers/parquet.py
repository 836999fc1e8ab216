"""Parquet files as the content of a table."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import unquote

from aoabench.devices.readers.foreign import is_plain, ranges_of
from aoabench.devices.readers.reading import Content, Part
from aoabench.errors import BadValue

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class Parquet(Content):
    """A Parquet file; `fixed` are the columns that its folder states, as in tag=T1/part.parquet."""

    key: str = ""
    path: str = ""
    content: bytes = b""
    fixed: tuple[tuple[str, str], ...] = ()

    def cells(self, names: Mapping[str, str]) -> pd.DataFrame:
        """The chosen columns; raises BadValue for cells that are not texts, numbers or times."""
        import pandas as pd
        import pyarrow.parquet as pq

        whole = pq.ParquetFile(BytesIO(self.content))
        ranges, fixed = ranges_of(whole.schema_arrow), dict(self.fixed)
        stored = [n for n in dict.fromkeys(names.values()) if n not in ranges and n not in fixed]
        table = whole.read(stored)
        for field in table.schema:
            if not is_plain(field.type):
                allowed = "columns of texts, numbers or times"
                reason = f"{allowed}; {field.name!r} has the type {field.type}"
                raise BadValue(self.key, self.path, reason)
        found = table.replace_schema_metadata(None).to_pandas()
        found = found if len(found.columns) else pd.DataFrame(index=range(whole.metadata.num_rows))
        found = found.assign(**ranges, **fixed)
        columns = {ours: found[theirs] for ours, theirs in names.items()}
        return pd.DataFrame(columns).reset_index(drop=True)


def parquet(content: bytes, key: str, path: str, folder: str = "") -> Parquet:
    """The content of a file, and the columns that the folders between `folder` and it state."""
    import pyarrow.parquet as pq

    schema = pq.read_schema(BytesIO(content))
    names = [*schema.names, *ranges_of(schema)]
    fixed = []
    for part in Path(path).relative_to(folder).parts[:-1] if folder else ():
        name, equals, value = part.partition("=")
        if equals and name not in names:
            fixed.append((name, unquote(value)))
    columns = [*names, *(name for name, _ in fixed)]
    return Parquet(columns, (Part(0, "row", 1),), (), {}, key, path, content, tuple(fixed))
