"""The tables of a run: views made from its parts, and reading them back.

<out>/cells/<cell>.json                    the estimators and replications that the tables show
<out>/{replications,steps}.parquet/        one file per cell
<out>/{cells,summary,timing,failures,precision}.parquet
<out>/tidy.parquet                         all replications with their cells' swept parameters;
                                           the frame that `load` returns
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from aoabench.columns import IDENTITY, KINDS, REPLICATIONS
from aoabench.errors import UserError
from aoabench.maths.digest import flatten
from aoabench.store.files import provenance, schema, write_atomically, write_frame, write_table
from aoabench.store.parts import intact_parts
from aoabench.store.summary import summarise

if TYPE_CHECKING:
    import pandas as pd
from aoabench.columns import FAILURES, PRECISION, TIMING
from aoabench.store.fixes import clusters
from aoabench.store.folder import errors, noted_parts, records, replay_command, write_record


def collect(out: Path, only: Iterable[str] | None = None) -> None:
    """Make the tables of `out` from its parts; `only` names the cells whose rows have changed
    (None: all).

    Raises UserError if `out` holds no run, and RunError if a part is missing, so that no table is
    silently incomplete.
    """
    noted = records(out)
    if not noted:
        raise UserError(f"{out}: no results here; allowed: the runner.out folder of a run")
    changed = None if only is None else set(only)
    for record in noted:
        path = out / "replications.parquet" / f"{record['cell']}.parquet"
        if changed is None or record["cell"] in changed or not path.exists():
            _collect_rows(out, record, "rows")
            if any(entry["steps"] for entry in record["estimators"].values()):
                _collect_rows(out, record, "steps")
            else:
                (out / "steps.parquet" / f"{record['cell']}.parquet").unlink(missing_ok=True)
    swept = swept_parameters(noted)

    def order(record: Mapping[str, Any]) -> tuple[Any, ...]:
        names = record["experiment"] or "", record["scenario"], record["noise"]
        return (*names, _natural(swept[record["cell"]].values()))

    noted.sort(key=order)
    cells = _cell_table(noted, swept)
    write_frame(out / "cells.parquet", cells)
    _write_tidy(out, cells)
    _write_summary(out, noted)
    write_timing(out)


def _cell_table(
    noted: Sequence[Mapping[str, Any]], swept: Mapping[str, Mapping[str, Any]]
) -> pd.DataFrame:
    """A row per cell, with a column per swept parameter and the resolved config."""
    import pandas as pd

    rows = [
        {
            **{k: r[k] for k in ("cell", "experiment", "scenario", "noise", "seed")},
            **swept[r["cell"]],
            "estimators": ", ".join(r["estimators"]),
            "config": json.dumps(r["config"], sort_keys=True),
        }
        for r in noted
    ]
    cells = pd.DataFrame(rows)
    cells["experiment"] = cells["experiment"].astype("string")
    for parameter in next(iter(swept.values())):
        cells[parameter] = one_kind(cells[parameter])
    return cells


def _write_summary(out: Path, noted: Sequence[Mapping[str, Any]]) -> None:
    """Write the summary and the failures of every estimator in every cell."""
    import pandas as pd

    rows, failed = [], []
    for record in noted:
        frame = pd.read_parquet(out / "replications.parquet" / f"{record['cell']}.parquet")
        for name, group in frame.groupby("estimator", sort=False):
            failed += _failures(out, record, str(name), group)
            found = summarise(group, clusters(out, record["cell"], str(name)))
            rows.append({**{k: record[k] for k in IDENTITY[:4]}, "estimator": name, **found})
    summary = pd.DataFrame(rows)
    summary["experiment"] = summary["experiment"].astype("string")
    write_frame(out / "summary.parquet", summary)
    _write_rows(out / "failures.parquet", failed, FAILURES)


def one_kind(values: pd.Series) -> pd.Series:
    """The column as Parquet can store it: unchanged if its values are all numbers, all text or all
    bool, else as text.
    """
    given = values.dropna()
    kinds = {bool if isinstance(v, bool) else str if isinstance(v, str) else float for v in given}
    text = given.map(lambda v: v if isinstance(v, str) else json.dumps(v))
    return values if len(kinds) < 2 else text.reindex(values.index)


def _write_tidy(out: Path, cells: pd.DataFrame) -> None:
    """Write the replications of all cells, with the cell table's columns that they lack, cell by
    cell into one file.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    extra = [
        c for c in cells.columns if c not in REPLICATIONS and c not in ("config", "estimators")
    ]
    beside = pa.Table.from_pandas(cells[extra], preserve_index=False)
    outer = pa.schema([*schema(REPLICATIONS), *beside.schema.remove_metadata()])
    outer = outer.with_metadata({"aoabench": json.dumps(provenance())})

    repeated = [
        name for name in outer.names if REPLICATIONS.get(name) != "double"
    ]  # a dictionary saves nothing for doubles

    def write(temporary: Path) -> None:
        with pq.ParquetWriter(
            temporary, outer, compression="zstd", use_dictionary=repeated
        ) as writer:
            for i, cell in enumerate(cells["cell"]):
                rows = pq.read_table(out / "replications.parquet" / f"{cell}.parquet")
                same = [pa.repeat(column[i], len(rows)) for column in beside.columns]
                writer.write_table(
                    pa.table([rows[name] for name in REPLICATIONS] + same, schema=outer)
                )

    write_atomically(out / "tidy.parquet", write)


def note_timing(out: Path, timing: Mapping[str, Any]) -> None:
    """Enter timings by part key into the records, and write the timing table."""
    for record in records(out):
        entries = record["estimators"].values()
        if any(entry["key"] in timing for entry in entries):
            for entry in entries:
                entry["timing"] = timing.get(entry["key"], entry.get("timing"))
            write_record(out, record)
    write_timing(out)


def write_timing(out: Path) -> None:
    """Write the timing table and the table of the precision reached, from the recorded cells."""
    noted = records(out)
    for kind, columns in (("timing", TIMING), ("precision", PRECISION)):
        found = [
            {**{k: r[k] for k in IDENTITY[:4]}, "estimator": name, **entry[kind]}
            for r in noted
            for name, entry in r["estimators"].items()
            if entry.get(kind)
        ]
        _write_rows(out / f"{kind}.parquet", found, columns)


def _write_rows(path: Path, rows: Sequence[Mapping[str, Any]], columns: Mapping[str, str]) -> None:
    write_table(path, {c: [row[c] for row in rows] for c in columns}, schema(columns, provenance()))


def _failures(
    out: Path, record: Mapping[str, Any], name: str, rows: pd.DataFrame
) -> list[dict[str, Any]]:
    """Rows of the failures table: one estimator's replications in which a fix failed."""
    failed = rows[rows["n_failed"] > 0]
    if failed.empty:
        return []
    entry = record["estimators"][name]
    messages = errors(intact_parts(out, entry["key"]), entry["reps"])
    columns = [c for c in FAILURES if c not in ("error", "replay")]
    return [
        {
            **{str(k): v for k, v in row.items()},
            "error": messages.get(row["replication"]),
            "replay": replay_command(
                out,
                record["cell"],
                name,
                row["replication"],
                record["config"],
                record.get("plugins", ()),
            ),
        }
        for row in failed[columns].to_dict("records")
    ]


def _collect_rows(out: Path, record: Mapping[str, Any], kind: str) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    columns = KINDS[kind]
    table = {"rows": "replications"}.get(kind, kind)
    outer = schema(columns, {**record["provenance"], "config": record["config"]})

    def write(temporary: Path) -> None:
        with pq.ParquetWriter(temporary, outer, compression="zstd") as writer:
            for name, entry in record["estimators"].items():
                if kind == "steps" and not entry["steps"]:
                    continue
                for part in noted_parts(out, entry, kind):
                    same = {**{k: record[k] for k in IDENTITY[:4]}, "estimator": name}
                    full = [
                        pa.array([same[f.name]] * len(part), f.type)
                        if f.name in same
                        else part[f.name]
                        for f in outer
                    ]
                    writer.write_table(pa.table(full, schema=outer))

    write_atomically(out / f"{table}.parquet" / f"{record['cell']}.parquet", write)


def swept_parameters(noted: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """Per cell, the dotted parameters that differ between the cells or that a command line or
    experiment set.
    """
    full = {r["cell"]: dict(flatten(r["config"])) | r["changed"] for r in noted}
    names = {
        name
        for leaves in full.values()
        for name in leaves
        if name.startswith(("scenario.", "noise."))
    }
    varied = {
        name
        for name in names
        if len({json.dumps(leaves.get(name)) for leaves in full.values()}) > 1
    }
    varied |= {
        name for r in noted for name in (*r["changed"], *r["swept"]) if name in full[r["cell"]]
    }
    keep = sorted(name for name in varied if not name.endswith("_target_") and name != "seed")
    found = {
        cell: {name: _scalar(leaves.get(name)) for name in keep} for cell, leaves in full.items()
    }
    for name in keep:
        if (
            len({_kind(values[name]) for values in found.values()} - {None}) > 1
        ):  # mixed types are stored as text
            for values in found.values():
                values[name] = None if values[name] is None else str(values[name])
    return found


def _kind(value: Any) -> str | None:
    return (
        None if value is None else "number" if type(value) in (int, float) else type(value).__name__
    )


def _natural(values: Iterable[Any]) -> list[tuple[bool, float, str]]:
    """Sort key: numbers by value, everything else by its text."""
    return [
        (not isinstance(v, int | float), float(v) if isinstance(v, int | float) else 0.0, str(v))
        for v in values
    ]


def _scalar(value: Any) -> Any:
    return (
        value if value is None or isinstance(value, bool | int | float | str) else json.dumps(value)
    )


def load(out: str | os.PathLike[str]) -> pd.DataFrame:
    """One tidy frame: a row per cell x estimator x replication, with a column per swept parameter.

    Raises UserError if `out` holds no run.
    """
    import pandas as pd

    root = Path(out)
    if not (root / "cells.parquet").exists() or not (root / "replications.parquet").is_dir():
        raise UserError(
            f"{root}: no results here; allowed: the runner.out folder of a finished run"
        )
    cells = pd.read_parquet(root / "cells.parquet").drop(columns=["config", "estimators"])
    rows = pd.concat(
        [pd.read_parquet(f) for f in sorted((root / "replications.parquet").glob("*.parquet"))]
    )
    extra = [c for c in cells.columns if c == "cell" or c not in rows.columns]
    return rows.merge(cells[extra], on="cell", how="left", validate="many_to_one").reset_index(
        drop=True
    )
