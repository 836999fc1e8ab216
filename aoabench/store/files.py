"""Writing files atomically, with provenance and checksums."""

from __future__ import annotations

import contextlib
import errno
import functools
import hashlib
import json
import os
import sys
import time
import uuid
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa
from aoabench.columns import IDENTITY, SCHEMA
from aoabench.errors import RunError, UserError, WriteError
from aoabench.resources import version

_SCHEMA = b"aoabench_schema"
STALE_S = 3600.0  # age of a file that no process is writing any more
_LARGE = 2**20  # bytes of a table that threads read faster
_SMALL = 2**14  # bytes of a table that compression does not make smaller, as its pages are tiny
_READ_S = 5.0  # longer than it takes to read a table
WRITING: dict[str, Any] = {"compression": "zstd", "write_page_checksum": True}


def schema(columns: Mapping[str, str], provenance: Mapping[str, Any] | None = None) -> pa.Schema:
    """The fixed Arrow schema of a table, with its version and provenance as metadata."""
    meta = {_SCHEMA: str(SCHEMA).encode()}
    if provenance:
        meta[b"aoabench"] = json.dumps(provenance, default=str).encode()
    return _types(tuple(columns.items())).with_metadata(meta)


@functools.lru_cache(64)
def _types(columns: tuple[tuple[str, str], ...]) -> pa.Schema:
    """The Arrow schema of names and kinds."""
    import pyarrow as pa

    types = {"string": pa.string(), "int64": pa.int64(), "double": pa.float64(), "bool": pa.bool_()}
    types |= {
        "floats": pa.list_(pa.float32()),
        "bytes": pa.list_(pa.int8()),
        "ints": pa.list_(pa.int32()),
    }
    return pa.schema([(name, types[kind]) for name, kind in columns])


def provenance(config: Any = None) -> dict[str, Any]:
    """Origin of numbers: config, versions, processor, time."""
    return {
        "config": config,
        "aoabench": version("aoabench"),
        "python": sys.version.split()[0],
        "libraries": {
            n: version(n)
            for n in ("numpy", "scipy", "pandas", "pyarrow", "hydra-core", "joblib", "numba")
        },
        "cpu_features": _cpu_features(),
        "time": datetime.now(UTC).isoformat(timespec="seconds"),
    }


@functools.cache
def _cpu_features() -> list[str]:
    found = np.show_config(mode="dicts").get("SIMD Extensions", {})
    return sorted([*found.get("baseline", []), *found.get("found", [])])


def write_atomically(path: Path, write: Any) -> None:
    """Call `write(temporary path)` and move the result to `path`, so that a reader never sees half
    a file.

    Raises WriteError for an error of the file system about this file.
    """
    # absolute, because Arrow takes a relative path with a colon for a URI
    unique = f".{path.name}.{os.getpid()}.{uuid.uuid4().hex[:8]}"
    temporary = path.absolute().with_name(unique)
    try:
        _make(path.parent)
        write(temporary)
        _put(temporary, path)
    except OSError as error:
        if not error.errno or _names_another(error, temporary, path):
            raise
        raise WriteError(error.errno, os.strerror(error.errno), str(path)) from error
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


def _put(temporary: Path, path: Path) -> None:
    """Move a file to its place. Windows refuses while another process reads the file there: try
    again for _READ_S, as our readers close each file once they have read it.
    """
    end = time.monotonic() + _READ_S
    while True:
        try:
            return os.replace(temporary, path)
        except PermissionError:
            if sys.platform != "win32" or path.is_dir() or time.monotonic() > end:
                raise
            time.sleep(0.05)


_RUNS: set[Path] = set()


def never_make(run: Path) -> None:
    """From now on, writing into the folder `run` of a run is an error if the folder does not exist
    (any more).
    """
    _RUNS.add(run)


def _make(folder: Path) -> None:
    """Create a folder and its parents; FileNotFoundError for the folder of a run."""
    if folder.is_dir():
        return
    if folder in _RUNS:
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(folder))
    _make(folder.parent)
    folder.mkdir(exist_ok=True)


def _names_another(error: OSError, temporary: Path, path: Path) -> bool:
    """Whether an error names a file that is read, not the file that is written or its folders."""
    if error.filename is None:  # Arrow's
        text = str(error)
        return temporary.name not in text and ("reading" in text or "open local file" in text)
    return not temporary.is_relative_to(str(error.filename)) and str(error.filename) != str(path)


def write_table(path: Path, columns: Mapping[str, Any], schema_: pa.Schema) -> str:
    """Write columns of equal length to a Parquet file of this schema, atomically; return the
    checksum of its content.
    """
    import pyarrow as pa

    def column(field: pa.Field) -> pa.Array:
        values = columns[field.name]
        if pa.types.is_list(field.type):  # a row of an array (N, T) each
            offsets = np.arange(len(values) + 1, dtype=np.int32) * np.shape(values)[1]
            return pa.ListArray.from_arrays(
                offsets, pa.array(np.ravel(values), type=field.type.value_type)
            )
        return pa.array(values, type=field.type, from_pandas=field.name in IDENTITY)

    return save(path, pa.table([column(field) for field in schema_], schema=schema_))


def save(path: Path, table: pa.Table) -> str:
    """Write a table to a Parquet file, atomically; return the checksum of its content."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    how = WRITING | ({"compression": "none"} if table.nbytes < _SMALL else {})
    buffer = pa.BufferOutputStream()
    pq.write_table(table, buffer, **how)
    data = buffer.getvalue()
    write_atomically(path, lambda temporary: temporary.write_bytes(data))
    return checksum_of(data)


def write_frame(
    path: Path,
    frame: pd.DataFrame,
    origin: Mapping[str, Any] | None = None,
    columns: Mapping[str, str] | None = None,
) -> None:
    """Write a pandas frame to Parquet, atomically, with provenance.

    `columns` gives the types of a run's own columns, {} if none is fixed, and adds the version of
    the schema; None for a table that belongs to no run.
    """
    import pyarrow as pa

    table = pa.Table.from_pandas(frame, preserve_index=False)
    meta = {
        **(table.schema.metadata or {}),
        b"aoabench": json.dumps(origin or provenance(), default=str).encode(),
    }
    if columns is not None:
        meta[_SCHEMA] = str(SCHEMA).encode()
        fixed = {field.name: field for field in schema(columns)}
        table = table.cast(pa.schema([fixed.get(field.name, field) for field in table.schema]))
    save(path, table.replace_schema_metadata(meta))


def read_provenance(path: Path) -> dict[str, Any]:
    """The provenance that a Parquet file written here carries; {} if none."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    with _torn_reported(path):
        data = pa.BufferReader(path.read_bytes())
        text = (pq.read_schema(data).metadata or {}).get(b"aoabench")
    return json.loads(text) if text else {}


def version_in(metadata: Mapping[bytes, bytes] | None, path: Path) -> int:
    """The version of the schema in a table's metadata: columns.SCHEMA or an earlier one.

    Raises UserError for a version that this aoabench does not know.
    """
    text = (metadata or {}).get(_SCHEMA, b"1").decode(errors="replace")
    if text.isdecimal() and 1 <= int(text) <= SCHEMA:
        return int(text)
    raise UserError(
        f"{path}: the table has schema {text}; allowed: 1 to {SCHEMA}; read it with the aoabench "
        "that wrote it, or repeat the run with another runner.out"
    )


def read_table(
    path: Path, schema: pa.Schema | None = None, columns: list[str] | None = None
) -> pa.Table:
    """The table in a Parquet file; with `schema`, that of a run's table, whose columns of another
    version that the file lacks are null. Raises as `table_of` does.
    """
    return table_of(path.read_bytes(), path, schema, columns)


def table_of(
    data: bytes, path: Path, schema: pa.Schema | None = None, columns: list[str] | None = None
) -> pa.Table:
    """The table in the bytes of a Parquet file (see `read_table`), its pages' checksums verified.

    Raises RunError if they are torn or altered, and UserError for an unknown schema.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    with _torn_reported(path):
        file = pq.ParquetFile(pa.BufferReader(data), page_checksum_verification=True)
        names = file.schema_arrow.names
        wanted = columns or (names if schema is None else schema.names)
        known = [name for name in wanted if name in names]
        table = file.read(known, use_threads=len(data) > _LARGE)
        version_in(table.schema.metadata, path)
        if schema is None:
            return table
        fields = [schema.field(name) for name in wanted]
        found = [
            table[f.name].cast(f.type) if f.name in known else pa.nulls(len(table), f.type)
            for f in fields
        ]
        return pa.table(found, schema=pa.schema(fields, metadata=schema.metadata))


@contextlib.contextmanager
def _torn_reported(source: Any) -> Iterator[None]:
    """Turn an error of Arrow in what is not a whole Parquet file into a RunError."""
    import pyarrow as pa

    try:
        yield
    except MemoryError:  # one of Arrow's, too
        raise
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        if isinstance(error, OSError) and error.errno is not None:
            raise
        raise RunError(f"{source} is torn or altered, or no Parquet file") from None


def rows_of(data: bytes) -> int:
    """The number of rows in the bytes of a Parquet file."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    return int(pq.read_metadata(pa.BufferReader(data)).num_rows)


def checksum_of(data: bytes | pa.Buffer) -> str:
    return hashlib.blake2b(data, digest_size=16).hexdigest()


def file_checksum(path: Path) -> str:
    return checksum_of(path.read_bytes())
