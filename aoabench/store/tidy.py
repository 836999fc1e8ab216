"""The table tidy.parquet: the replications of all cells with the parameters of their cells."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from aoabench.columns import REPLICATIONS
from aoabench.store.files import WRITING, provenance, schema

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa

_BATCH = 2**17  # rows that are written together, so that the file has few groups of rows
_HELD = 16  # groups of rows of an earlier table that are held in memory

RowsOf = Callable[[str], "pa.Table"]


class Earlier:
    """The replications of a tidy table of which each cell's number of rows is known, in order;
    columns that an earlier version did not write are null.
    """

    def __init__(self, data: bytes, rows: Mapping[str, int]) -> None:
        import pyarrow as pa
        import pyarrow.parquet as pq

        self._file = pq.ParquetFile(pa.BufferReader(data), page_checksum_verification=True)
        groups = [self._file.metadata.row_group(i) for i in range(self._file.num_row_groups)]
        self._ends = np.cumsum([group.num_rows for group in groups])
        self._group = lru_cache(_HELD)(self._read)
        ends = np.cumsum(list(rows.values()), dtype=int).tolist()
        self.spans = dict(zip(rows, zip([0, *ends], ends)))

    def _read(self, group: int) -> pa.Table:
        import pyarrow as pa

        written = set(self._file.schema_arrow.names)
        table = self._file.read_row_group(group, [n for n in REPLICATIONS if n in written])
        columns = [
            table[f.name] if f.name in written else pa.nulls(len(table), f.type)
            for f in schema(REPLICATIONS)
        ]
        return pa.table(columns, names=list(REPLICATIONS))

    def rows(self, start: int, stop: int) -> Iterator[pa.Table]:
        """The rows start ... stop-1."""
        for group in range(*np.searchsorted(self._ends, [start, stop - 1], "right") + [0, 1]):
            table = self._group(group)
            first = self._ends[group] - len(table)
            yield table.slice(max(start - first, 0), stop - max(start, first))


def write(
    path: Path, cells: pd.DataFrame, counts: Sequence[int], rows_of: RowsOf, earlier: Earlier | None
) -> None:
    """Write the table of these cells (a row each, as in the cell table), which have `counts` rows
    each: those that `earlier` has as they are, and the others from `rows_of(cell)`.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    beside = _beside(cells)
    outer = _outer(beside)
    # a dictionary saves nothing for doubles
    repeated = [name for name in outer.names if REPLICATIONS.get(name) != "double"]
    names, counted = cells["cell"].tolist(), np.asarray(counts, dtype=int)
    with pq.ParquetWriter(path, outer, use_dictionary=repeated, **WRITING) as writer:
        for first, last in _batches(counted):
            rows = pa.concat_tables(_joined(names[first:last], rows_of, earlier))
            which = np.repeat(np.arange(first, last), counted[first:last])
            writer.write_table(_together(rows, beside, which, outer))


def table(cells: pd.DataFrame, rows: Mapping[str, pa.Table]) -> pa.Table:
    """The table of those of the cells (as for `write`) of which `rows` has the replications."""
    import pyarrow as pa

    beside = _beside(cells)  # of all cells, which decide the columns' types
    numbers = [i for i, cell in enumerate(cells["cell"]) if cell in rows]
    mine = [rows[cell].replace_schema_metadata(None) for cell in cells["cell"].iloc[numbers]]
    which = np.repeat(numbers, [len(one) for one in mine])
    return _together(pa.concat_tables(mine), beside, which, _outer(beside))


def _beside(cells: pd.DataFrame) -> pa.Table:
    """The columns of the cells that are repeated beside the replications of each."""
    import pyarrow as pa

    dropped = ("config", "estimators")
    extra = [c for c in cells.columns if c not in REPLICATIONS and c not in dropped]
    return pa.Table.from_pandas(cells[extra], preserve_index=False)


def _outer(beside: pa.Table) -> pa.Schema:
    import pyarrow as pa

    outer = pa.schema([*schema(REPLICATIONS), *beside.schema.remove_metadata()])
    return outer.with_metadata(schema(REPLICATIONS, provenance()).metadata)


def _together(rows: pa.Table, beside: pa.Table, which: np.ndarray, outer: pa.Schema) -> pa.Table:
    """Replications, and beside each the row of its cell, whose number is in `which` (N,)."""
    import pyarrow as pa

    same = beside.take(pa.array(which, pa.int64()))
    columns = [rows[name] for name in REPLICATIONS] + same.columns
    return pa.table(columns, schema=outer)


def _batches(counts: np.ndarray) -> Iterator[tuple[int, int]]:
    """Ranges of cells with at most _BATCH rows together, or of one cell."""
    first, total = 0, 0
    for i, count in enumerate(counts):
        if i > first and total + count > _BATCH:
            yield first, i
            first, total = i, 0
        total += count
    if len(counts):
        yield first, len(counts)


def _joined(cells: Sequence[str], rows_of: RowsOf, earlier: Earlier | None) -> Iterator[pa.Table]:
    """The rows of some cells; those of neighbours in the earlier table are read at once."""
    spans = {} if earlier is None else earlier.spans
    start = stop = 0
    for cell in cells:
        span = spans.get(cell)
        if span is not None and span[0] == stop > start:
            stop = span[1]
            continue
        if earlier is not None and stop > start:
            yield from earlier.rows(start, stop)
        start, stop = span or (0, 0)
        if span is None:
            yield rows_of(cell).replace_schema_metadata(None)
    if earlier is not None and stop > start:
        yield from earlier.rows(start, stop)
