"""The index of a run's folder: what the records of its cells hold, one row per cell.

With it, a run reads only the records that have changed since the tables were made.
"""

from __future__ import annotations

import json
import os
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from aoabench.columns import SCHEMA
from aoabench.errors import RunError
from aoabench.maths.digest import digest, flatten
from aoabench.store.files import checksum_of
from aoabench.store.folder import read_record, record_files, write_record
from aoabench.store.manifest import INDEX, Entry, Generation, current, torn
from aoabench.store.parts import checksum_files

if TYPE_CHECKING:
    import pyarrow as pa

LEAF = "="  # before the dotted name of a parameter: a column of its values as JSON
# status: size, time and number of the record's file; state: digest of the record and of the
# checksum files of its parts, "" where it is not known yet; rows: replications times estimators;
# the others as in the record, in JSON where they are not text
COLUMNS = (
    *("cell", "experiment", "scenario", "noise", "seed", "status", "state", "rows"),
    *("estimators", "named", "plugins", "config"),
)

_BATCH = 256  # rows that are decoded together: one by one, each takes ten times as long


@dataclass(frozen=True)
class Index:
    """`table`: a row per cell; `fresh`: the cells whose record was read again; `before`: the
    generation that the other rows are from, None if there is none that can be used; `earlier`: the
    state and the number of rows of each of its cells.
    """

    table: pa.Table
    fresh: frozenset[str]
    before: Generation | None
    earlier: Mapping[str, tuple[str, int]]

    def column(self, name: str) -> list[Any]:
        """A column as a list; values in JSON are decoded."""
        values: list[Any] = self.table[name].to_pylist()
        decoded = ("seed", "estimators", "named", "plugins")
        return [json.loads(text) for text in values] if name in decoded else values

    def timing(self) -> dict[str, Any]:
        """Timings recorded so far, by part key."""
        entries = (e for cell in self.column("estimators") for e in cell.values())
        return {entry["key"]: entry["timing"] for entry in entries if entry.get("timing")}

    def with_states(self, out: Path, cells: Iterable[str]) -> tuple[Index, set[str]]:
        """The index with the present states of some cells and of the fresh ones, and the cells
        whose states differ from those that the tables show.
        """
        asked = {*cells, *self.fresh}
        states = {row["cell"]: state_of(out, row) for row in self.rows(asked)}
        changed = {c for c, state in states.items() if state != self.earlier.get(c, ("", 0))[0]}
        return self._with(states), changed

    def rows(self, cells: Collection[str]) -> Iterator[dict[str, Any]]:
        """The rows of some cells, those that the index has."""
        import pyarrow as pa

        asked = pa.array([cell in cells for cell in self.column("cell")], pa.bool_())
        for batch in self.table.filter(asked).to_batches(_BATCH):
            yield from batch.to_pylist()

    def with_states_kept(self) -> Index:
        """The index with the states of the tables made last, also for the fresh cells."""
        return self._with({cell: state for cell, (state, _) in self.earlier.items()})

    def _with(self, states: Mapping[str, str]) -> Index:
        import pyarrow as pa

        known = zip(self.column("cell"), self.column("state"))
        column = pa.array([states.get(cell, state) for cell, state in known], pa.string())
        at = self.table.column_names.index("state")
        return replace(self, table=self.table.set_column(at, "state", column))


def read(out: Path, own: Collection[str] = (), anew: bool = False) -> Index:
    """The index of the folder, brought up to date with the records; with `anew`, made from the
    records alone. Records of an earlier version get their checksum. The caller holds the folder's
    lock.

    Raises RunError if a record is torn or altered, or if the record of a cell is missing that the
    tables show, unless it is one of the cells `own`, whose records are going to be written.
    """
    import pyarrow as pa
    import pyarrow.compute as pc

    before, table = _stored(out)
    files = {cell: _status(file) for cell, file in record_files(out).items()}
    earlier, known = {}, {}
    if table is not None:
        columns = (table[name].to_pylist() for name in ("cell", "status", "state", "rows"))
        for cell, status, state, count in zip(*columns):
            earlier[cell], known[cell] = (state, count), status
    for cell in known.keys() - files.keys() - set(own):
        raise RunError(
            f"{out}/cells/{cell}.json is missing, though the tables show its cell; run the command "
            f"of that cell again, or delete {out}/tables.json to leave the cell out"
        )
    fresh = [cell for cell, status in files.items() if anew or known.get(cell) != status]
    rows = table_of_records(_signed(out, cell) for cell in fresh)
    if table is not None and not anew:
        keep = [cell in files and known[cell] == files[cell] for cell in known]
        rows = pa.concat_tables(
            [table.filter(pa.array(keep, pa.bool_())), rows], promote_options="default"
        )
    rows = rows.take(pc.sort_indices(rows, [("cell", "ascending")]))
    return Index(rows, frozenset(fresh), before, earlier)


def _stored(out: Path) -> tuple[Generation | None, pa.Table | None]:
    """The current generation and its index; None, None if they cannot be used."""
    try:
        before = current(out)
        table = None if before is None else before.read(INDEX)
    except (RunError, FileNotFoundError, KeyError):
        return None, None
    if table is None or not set(COLUMNS) <= set(table.column_names):
        return None, None
    return before, table


def _signed(out: Path, cell: str) -> tuple[dict[str, Any], str]:
    """The record of a cell and the status of its file; a record of an earlier version is written
    again, with a checksum.
    """
    path = out / "cells" / f"{cell}.json"
    record = read_record(path)
    if "format" not in record:
        write_record(out, record)
    return record, _status(path.stat())


def _status(file: os.stat_result) -> str:
    return f"{file.st_size} {file.st_mtime_ns} {file.st_ino}"


def table_of_records(records: Iterable[tuple[Mapping[str, Any], str]]) -> pa.Table:
    """The rows of the index for records with the statuses of their files; states are ""."""
    import pyarrow as pa

    rows = [_row(record) | {"status": status, "state": ""} for record, status in records]
    leaves = dict.fromkeys(name for row in rows for name in row if name.startswith(LEAF))
    types = {name: pa.string() for name in (*COLUMNS, *leaves)} | {"rows": pa.int64()}
    return pa.table({name: pa.array([r.get(name) for r in rows], t) for name, t in types.items()})


def _row(record: Mapping[str, Any]) -> dict[str, Any]:
    entries = record["estimators"]
    leaves = dict(flatten(record["config"])) | record["changed"]
    return {
        **{name: record[name] for name in ("cell", "experiment", "scenario", "noise")},
        "seed": json.dumps(record["seed"]),
        "rows": sum(entry["reps"] for entry in entries.values()),
        "estimators": json.dumps(entries),
        "named": json.dumps(sorted({*record["changed"], *record["swept"]})),
        "plugins": json.dumps(record.get("plugins", [])),
        "config": json.dumps(record["config"], sort_keys=True),
        **{LEAF + name: json.dumps(value) for name, value in leaves.items()},
    }


def state_of(out: Path, row: Mapping[str, Any]) -> str:
    """Digest of a cell's row of the index and of the checksum files of its parts; of what its rows
    of the tables are made from.
    """
    measured = ("timing", "precision")
    entries = {
        name: {k: v for k, v in entry.items() if k not in measured}
        for name, entry in json.loads(row["estimators"]).items()
    }
    files = [file for e in entries.values() for file in checksum_files(out, e["key"])]
    parts = [[file.parent.name, file.name, checksum_of(file.read_bytes())] for file in files]
    same = {k: v for k, v in row.items() if k not in ("status", "state", "estimators")}
    return digest([SCHEMA, list(entries.items()), parts, {k: v for k, v in same.items() if v}])


def entry_of(out: Path, cell: str, estimator: str) -> dict[str, Any] | None:
    """The entry of an estimator in the record of a cell, as the current tables show it; None if
    there is none. Raises RunError if the record or the index is torn or altered.
    """
    generation = current(out)
    while generation is not None:
        try:
            text = _entries(out, generation.tables[INDEX]).get(cell)
            return None if text is None else json.loads(text).get(estimator)
        except FileNotFoundError:
            latest = current(out)
            if latest == generation:
                raise torn(generation.file(INDEX), out, "is missing") from None
            generation = latest
    path = out / "cells" / f"{cell}.json"
    return read_record(path)["estimators"].get(estimator) if path.exists() else None


@lru_cache(4)
def _entries(out: Path, index: Entry) -> dict[str, str]:
    """The estimators of each cell, in JSON."""
    table = Generation(out, "", {INDEX: index}).read(INDEX, ["cell", "estimators"])
    return dict(zip(table["cell"].to_pylist(), table["estimators"].to_pylist()))
