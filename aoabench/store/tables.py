"""The tables of a run: views made from its parts, and reading them back.

<out>/cells/<cell>.json                    the estimators and replications that the tables show
<out>/{replications,steps}.parquet/        one file per cell
<out>/{cells,summary,timing,failures,precision}.parquet
<out>/tidy.parquet                         all replications with swept parameters, as in `load`

A reader takes the tables that the manifest names (see store.manifest), so that it never sees half
of a collect.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from aoabench.columns import FAILURES, IDENTITY, PRECISION, SCHEMA, SUMMARY, TIMING
from aoabench.errors import RunError
from aoabench.store import earlier, manifest, tidy
from aoabench.store import index as index_module
from aoabench.store.files import (
    provenance,
    save,
    schema,
    version_in,
    write_atomically,
    write_frame,
)
from aoabench.store.folder import no_results, read_record, replay_command, write_record
from aoabench.store.index import Index
from aoabench.store.rows import COLUMNS, CellRows
from aoabench.store.swept import cell_table, natural, one_kind, swept_parameters

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa


@dataclass(frozen=True)
class _Before:
    """What the tables made last show of the cells that have not changed."""

    tables: Mapping[str, pa.Table]
    tidy: tidy.Earlier


def collect(out: Path, only: Iterable[str] | None = None) -> None:
    """Make the tables of `out`: the rows of the cells `only`, and of those whose records have
    changed, from their parts, and the others from the tables made last (None: all from the parts).
    The caller holds the folder's lock.

    Raises UserError if `out` holds no run, and RunError if a record or part is missing or torn, so
    that no table is silently incomplete.
    """
    anew = only is None
    index = index_module.read(out, anew=anew)
    cells = index.column("cell")
    if not cells:
        raise no_results(out)
    index, changed = index.with_states(out, cells if only is None else only)
    if not anew:
        changed |= _without_rows(out, index)
    before = None if anew else _before(index, changed)
    if before is None:
        changed = set(cells)
    if changed or set(cells) != index.earlier.keys():
        _Collect(out, index, changed, before).publish()
    elif index.fresh:
        manifest.publish(out, _of_records(out, index), index.before)
    elif index.before is not None:
        manifest.link(index.before)


def _without_rows(out: Path, index: Index) -> set[str]:
    """The cells without their file of replications or steps."""
    stems = {
        name: {file.stem for file in (out / f"{name}.parquet").glob("*.parquet")}
        for name in ("replications", "steps")
    }
    texts = index.table["estimators"].to_pylist()
    stepped = {c for c, text in zip(index.column("cell"), texts) if '"steps": true' in text}
    return (set(index.column("cell")) - stems["replications"]) | (stepped - stems["steps"])


def _before(index: Index, changed: Collection[str]) -> _Before | None:
    """The tables made last; None if there are none, or one of them cannot be used."""
    generation = index.before
    if generation is None:
        return None
    try:
        kept = {name: generation.read(name) for name in ("summary", "failures")}
        for name in ("timing", "precision"):  # they are made from the index
            generation.data(name)
        order = generation.read("cells", ["cell"])["cell"].to_pylist()
        counts = {cell: index.earlier[cell][1] for cell in order}
        rows = tidy.Earlier(generation.data("tidy"), counts)
        lacking = set(SUMMARY).difference(kept["summary"].column_names)
        lacking |= set(FAILURES).difference(kept["failures"].column_names)
        old = [t for t in kept.values() if version_in(t.schema.metadata, generation.out) < SCHEMA]
        if lacking or old:
            return None
    except (RunError, FileNotFoundError, KeyError):
        return None
    for cell in changed:
        rows.spans.pop(cell, None)
    return _Before(kept, rows)


class _Collect:
    """The tables of one generation, made in the order of the cells' parameters."""

    def __init__(self, out: Path, index: Index, changed: set[str], before: _Before | None) -> None:
        self.out, self.before, self.changed = out, before, changed
        swept = swept_parameters(index)
        rows = zip(*(index.column(c) for c in ("experiment", "scenario", "noise")))
        names = [(e or "", *rest) for e, *rest in rows]
        values = zip(*swept.values()) if swept else [()] * len(names)
        keys = [(*name, natural(value)) for name, value in zip(names, values)]
        order = sorted(range(len(keys)), key=keys.__getitem__)
        self.swept = {name: [column[i] for i in order] for name, column in swept.items()}
        self.index = Index(index.table.take(order), index.fresh, index.before, index.earlier)
        self.shown = self.index.table.select(COLUMNS)
        self.place = {cell: i for i, cell in enumerate(self.index.column("cell"))}
        self.summary: list[dict[str, Any]] = []
        self.failures: list[dict[str, Any]] = []

    def publish(self) -> None:
        """Write all tables and make them the current generation."""
        cells = cell_table(self.index, self.swept)
        files = {n: manifest.new_file(self.out, n) for n in ("cells", "tidy", "summary")}
        write_frame(files["cells"], cells, columns={})
        counts = self.index.column("rows")
        earlier = None if self.before is None else self.before.tidy
        write_atomically(
            files["tidy"], lambda t: tidy.write(t, cells, counts, self._rows_of, earlier)
        )
        write_frame(files["summary"], self._summary_table(), columns=SUMMARY)
        files["failures"] = _write(self.out, "failures", self._failures_table())
        files |= _of_records(self.out, self.index)
        manifest.publish(self.out, files, self.index.before)

    def _rows_of(self, cell: str) -> pa.Table:
        """The replications of a changed cell; its summary and failures are noted."""
        row = self.shown.slice(self.place[cell], 1).to_pylist()[0]
        made = CellRows(self.out, row)
        made.write()
        self.summary += made.summary
        self.failures += made.failures
        return made.replications

    def _summary_table(self) -> pd.DataFrame:
        """The summary of every estimator in every cell."""
        table = self._joined("summary", self.summary, SUMMARY)
        frame: pd.DataFrame = table.to_pandas()
        if self.swept:
            import pandas as pd

            at = [self.place[cell] for cell in table["cell"].to_pylist()]
            each = {n: one_kind(pd.Series([v[i] for i in at])) for n, v in self.swept.items()}
            frame = pd.concat([frame, pd.DataFrame(each, index=frame.index)], axis=1)
        rest = [c for c in SUMMARY if c not in IDENTITY]
        return frame[[*IDENTITY, *self.swept, *rest]]

    def _failures_table(self) -> pa.Table:
        table, before = self._joined("failures", self.failures, FAILURES), self.index.before
        if self.before is None or before is None or before.path == str(self.out):
            return table
        rows = table.to_pylist()  # the folder has another name now
        plugins = dict(zip(self.index.column("cell"), self.index.column("plugins")))
        for row in rows:
            if row["replay"] is not None:
                cell, name = row["cell"], row["estimator"]
                known = self.out, cell, name, row["replication"], {"filter": {name: None}}
                row["replay"] = replay_command(*known, plugins[cell])
        return _table(rows, FAILURES)

    def _joined(
        self, name: str, new: Sequence[Mapping[str, Any]], columns: Mapping[str, str]
    ) -> pa.Table:
        """The earlier table's rows of the cells that have not changed and the new rows, in the
        order of the cells.
        """
        import pyarrow as pa

        table = _table(new, columns)
        if self.before is not None:
            kept = self.before.tables[name]
            stays = [c in self.place and c not in self.changed for c in kept["cell"].to_pylist()]
            table = pa.concat_tables(
                [kept.select(list(columns)).filter(pa.array(stays, pa.bool_())), table]
            )
        places = np.array([self.place[cell] for cell in table["cell"].to_pylist()], dtype=int)
        return table.take(pa.array(np.argsort(places, kind="stable")))


def _table(rows: Sequence[Mapping[str, Any]], columns: Mapping[str, str]) -> pa.Table:
    """A table of these columns from a mapping for each row."""
    import pyarrow as pa

    def column(field: pa.Field) -> pa.Array:
        return pa.array([row[field.name] for row in rows], field.type, from_pandas=True)

    known = schema(columns)
    return pa.table([column(field) for field in known], schema=known)


def _write(out: Path, name: str, table: pa.Table) -> Path:
    """Write a table of the next generation; return its file."""
    file, meta = manifest.new_file(out, name), schema({}, provenance()).metadata
    save(file, table.replace_schema_metadata(meta))
    return file


def _of_records(out: Path, index: Index) -> dict[str, Path]:
    """Write the tables that need the records alone: index, timing and the precision reached."""
    rows = sorted(
        zip(*(index.column(name) for name in (*IDENTITY[:4], "estimators"))), key=itemgetter(0)
    )
    made = {manifest.INDEX: _write(out, manifest.INDEX, index.table)}
    for kind, columns in (("timing", TIMING), ("precision", PRECISION)):
        found = [
            {**dict(zip(IDENTITY[:4], identity)), "estimator": name, **entry[kind]}
            for *identity, entries in rows
            for name, entry in entries.items()
            if entry.get(kind)
        ]
        made[kind] = _write(out, kind, _table(found, columns))
    return made


def note_timing(out: Path, timing: Mapping[str, Any]) -> None:
    """Enter timings by part key into the records, and make the timing table. The caller holds the
    folder's lock, and the tables show the recorded cells.
    """
    if not timing:
        return
    index = index_module.read(out)
    for cell, entries in zip(index.column("cell"), index.column("estimators")):
        if any(entry["key"] in timing for entry in entries.values()):
            record = read_record(out / "cells" / f"{cell}.json")
            for entry in record["estimators"].values():
                entry["timing"] = timing.get(entry["key"], entry.get("timing"))
            write_record(out, record)
    index = index_module.read(out).with_states_kept()
    manifest.publish(out, _of_records(out, index), index.before)


def load(out: str | os.PathLike[str], cells: Sequence[str] | None = None) -> pd.DataFrame:
    """One tidy frame: a row per cell x estimator x replication, with a column per swept parameter;
    with `cells`, of the cells with these ids alone.

    Columns that tables of an earlier schema lack are NaN or None. Raises UserError if `out` holds
    no run, or tables of an unknown schema, and RunError if they are torn or altered.
    """
    return shown(out, "tidy", cells=cells)["tidy"]


def shown(
    out: str | os.PathLike[str], *names: str, cells: Sequence[str] | None = None
) -> dict[str, pd.DataFrame]:
    """The named tables of a run as frames that belong together, of all cells or of those with the
    ids `cells`; `tidy` is that of `load`. Raises as `load` does.
    """
    root = Path(out)
    found = manifest.read_together(root, dict.fromkeys(names))
    if found is None:
        whole = earlier.shown(root, names)
        return {n: f if cells is None else f[f["cell"].isin(cells)] for n, f in whole.items()}
    frames = {name: _of_cells(table, cells).to_pandas() for name, table in found[0].items()}
    if "tidy" in frames:
        frames["tidy"] = frames["tidy"].sort_values("cell", kind="stable", ignore_index=True)
    return frames


def _of_cells(table: pa.Table, cells: Sequence[str] | None) -> pa.Table:
    """The rows of the cells with some ids, before they become a frame; all without ids."""
    from pyarrow.compute import field

    # a list without any text has no type
    return table if cells is None else table.filter(field("cell").isin([*cells, ""]))
