"""The table of fixes as a file: CSV, Parquet or GeoJSON."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from aoabench.devices.geodesy import Origin
from aoabench.errors import BadValue
from aoabench.store.files import provenance, write_atomically, write_frame

if TYPE_CHECKING:
    import pandas as pd

KINDS = (".csv", ".parquet", ".geojson")
DECIMALS = 6  # of numbers in texts: micrometres and microseconds
_ROUNDED = ("_s", "_m", "_deg", "_m2", "score")
_DEGREES = 9  # decimals of longitudes and latitudes: a tenth of a millimetre


def check_out(out: Path, read: Sequence[str | None]) -> None:
    """Raise BadValue unless `out` has one of the KINDS and is none of the files that are `read`."""
    if out.suffix.lower() not in KINDS:
        raise BadValue("-o", str(out), f"a file that ends in {', '.join(KINDS)}")
    for name in read:
        if name is not None and os.path.realpath(out) == os.path.realpath(name):
            raise BadValue("-o", str(out), "another file than those that are read")


def check_stream_out(out: Path | None, read: Sequence[str | None]) -> None:
    """Raise BadValue unless `out` is a CSV file that is not `read`, or None."""
    if out is not None:
        check_out(out, read)
        if out.suffix.lower() != ".csv":
            raise BadValue("-o", str(out), "a file that ends in .csv, for a stream")


@contextmanager
def opened(out: Path | None) -> Iterator[Callable[[Mapping[str, np.ndarray]], None]]:
    """Yield a function that appends rows, given by their columns, to the CSV file `out`, None for
    standard output; the first call also writes the header.
    """
    with ExitStack() as stack:
        file = sys.stdout.buffer if out is None else stack.enter_context(out.open("wb"))
        first = True

        def write(columns: Mapping[str, np.ndarray]) -> None:
            nonlocal first
            file.write(csv_text(columns, header=first))
            file.flush()
            first = False

        yield write


def write(frame: pd.DataFrame, out: Path, config: Any = None, origin: Origin | None = None) -> None:
    """Write the table of fixes to `out`, whose suffix is one of the KINDS.

    config: the settings, for the provenance of a Parquet file. origin: that of the positions, which
    become longitudes and latitudes in GeoJSON; None: they stay local coordinates in m.
    """
    kind = out.suffix.lower()
    if kind == ".parquet":
        write_frame(out, frame, provenance(config))
    elif kind == ".csv":
        write_atomically(out, lambda path: path.write_bytes(csv_text(_columns(frame))))
    else:
        write_atomically(out, lambda path: _write_lines(path, geojson(frame, origin)))


def csv_text(table: Mapping[str, np.ndarray], header: bool = True) -> bytes:
    """The columns of a table as CSV in UTF-8; a cell is empty where nothing is known."""
    import pandas as pd
    import pyarrow as pa
    from pyarrow import csv

    columns = rounded(table)
    sink = pa.BufferOutputStream()
    how = csv.WriteOptions(include_header=False, quoting_style="none")
    try:
        arrays = {name: pa.array(column, from_pandas=True) for name, column in columns.items()}
        csv.write_csv(pa.table(arrays), sink, how)
    except pa.ArrowInvalid:  # a cell needs quotes
        quoted = pd.DataFrame(columns).to_csv(index=False, header=header, lineterminator="\n")
        return bytes(quoted.encode())
    names = ",".join(columns) + "\n"
    rows: bytes = sink.getvalue().to_pybytes()
    return names.encode() * header + rows


def _columns(frame: pd.DataFrame) -> dict[str, np.ndarray]:
    return {str(name): frame[name].to_numpy() for name in frame.columns}


def rounded(columns: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The columns of a table, with times, lengths, angles and scores at DECIMALS."""
    numbers = {name for name in columns if name.endswith(_ROUNDED)}
    return {n: np.round(c, DECIMALS) + 0.0 if n in numbers else c for n, c in columns.items()}


def geojson(frame: pd.DataFrame, origin: Origin | None) -> Iterator[str]:
    """The lines of a GeoJSON file with a Point for each fix, without a geometry where it has no
    position; of local coordinates, `units` is m.
    """
    points = frame[["x_m", "y_m", "z_m"]].to_numpy(dtype=float)
    flat, given = np.isnan(points[:, 2]), np.isfinite(points[:, :2]).all(axis=1)
    if origin is not None:
        lifted = np.where(np.isnan(points), 0.0, points)
        points = np.where(given[:, None], origin.geodetic(lifted)[:, [1, 0, 2]], np.nan)
    points = np.round(points, DECIMALS if origin is None else _DEGREES)
    yield '{"type": "FeatureCollection", '
    yield '"units": "m", ' if origin is None else ""
    yield '"features": ['
    columns = rounded(_columns(frame))
    form = ", ".join(f"{_text(name)}: %s" for name in columns)
    form = f'{{"type": "Feature", "properties": {{{form}}}, "geometry": %s}}'
    x, y, z = (_texts(points[:, i]) for i in range(3))
    at = [f"{a}, {b}" if plane else f"{a}, {b}, {c}" for a, b, c, plane in zip(x, y, z, flat)]
    where = [
        f'{{"type": "Point", "coordinates": [{a}]}}' if known else "null"
        for a, known in zip(at, given)
    ]
    comma = "\n"
    for row in zip(*(_texts(column) for column in columns.values()), where):
        yield comma + form % row
        comma = ",\n"
    yield "\n]}\n"


def _texts(column: np.ndarray) -> Iterator[str]:
    """The values of a column in JSON; null where nothing is known."""
    if column.dtype.kind == "f":
        known = np.isfinite(column).tolist()
        return (repr(v) if k else "null" for v, k in zip(column.tolist(), known))
    if column.dtype.kind in "iu":
        return map(str, column.tolist())
    done: dict[Any, str] = {}
    return (done.get(v) or done.setdefault(v, _text(v)) for v in column.tolist())


def _text(value: Any) -> str:
    """A text or null in JSON."""
    missing = value is None or value != value
    return json.dumps(None if missing else value, allow_nan=False)


def _write_lines(path: Path, lines: Iterator[str]) -> None:
    with path.open("w", encoding="utf-8") as file:
        file.writelines(lines)
