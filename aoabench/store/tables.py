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

from aoabench.columns import (
    FAILURES,
    IDENTITY,
    KINDS,
    PRECISION,
    REPLICATIONS,
    SCHEMA,
    SUMMARY,
    TIMING,
)
from aoabench.errors import UserError
from aoabench.store import folder
from aoabench.store.files import (
    provenance,
    schema,
    schema_version,
    write_atomically,
    write_frame,
    write_table,
)
from aoabench.store.fixes import clusters
from aoabench.store.folder import noted_parts, records, replay_command, write_record
from aoabench.store.parts import Part, intact_parts
from aoabench.store.summary import commonest, summarise
from aoabench.store.swept import natural, one_kind, swept_parameters
from aoabench.types import SENTENCES, Reason

if TYPE_CHECKING:
    import pandas as pd


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
        stale = not path.exists() or schema_version(path) < SCHEMA
        if changed is None or record["cell"] in changed or stale:
            _collect_rows(out, record, "rows")
            if any(entry["steps"] for entry in record["estimators"].values()):
                _collect_rows(out, record, "steps")
            else:
                (out / "steps.parquet" / f"{record['cell']}.parquet").unlink(missing_ok=True)
    swept = swept_parameters(noted)

    def order(record: Mapping[str, Any]) -> tuple[Any, ...]:
        names = record["experiment"] or "", record["scenario"], record["noise"]
        return (*names, natural(swept[record["cell"]].values()))

    noted.sort(key=order)
    cells = _cell_table(noted, swept)
    write_frame(out / "cells.parquet", cells, columns={})
    _write_tidy(out, cells)
    _write_summary(out, noted, swept)
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


def _write_summary(
    out: Path, noted: Sequence[Mapping[str, Any]], swept: Mapping[str, Mapping[str, Any]]
) -> None:
    """Write the summary and the failures of every estimator in every cell."""
    import pandas as pd

    rows, failed = [], []
    for record in noted:
        cell = record["cell"]
        frame = pd.read_parquet(out / "replications.parquet" / f"{cell}.parquet")
        for name, group in frame.groupby("estimator", sort=False):
            entry = record["estimators"][name]
            parts = intact_parts(out, entry["key"]) if _any_not_ok(group) else []
            reasons = folder.reasons(parts, entry["reps"])
            known = not group["reason"].isna().any()
            failed += _failures(out, record, str(name), group, parts, reasons if known else None)
            found = summarise(group, clusters(out, cell, str(name)), reasons if known else None)
            identity = {**{k: record[k] for k in IDENTITY[:4]}, "estimator": name}
            rows.append({**identity, **swept[cell], **found})
    summary = pd.DataFrame(rows)
    parameters = list(next(iter(swept.values())))
    for parameter in parameters:
        summary[parameter] = one_kind(summary[parameter])
    rest = [c for c in SUMMARY if c not in IDENTITY]
    write_frame(out / "summary.parquet", summary[[*IDENTITY, *parameters, *rest]], columns=SUMMARY)
    _write_rows(out / "failures.parquet", failed, FAILURES)


def _any_not_ok(rows: pd.DataFrame) -> bool:
    return bool((rows["n_ok"] < rows["n_fixes"]).any())


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
    outer = outer.with_metadata(schema(REPLICATIONS, provenance()).metadata)

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
    out: Path,
    record: Mapping[str, Any],
    name: str,
    rows: pd.DataFrame,
    parts: Sequence[Part],
    reasons: pd.DataFrame | None,
) -> list[dict[str, Any]]:
    """Rows of the failures table: one estimator's replications in which a fix failed. `reasons`
    counts the fixes that are not ok; None where unknown.
    """
    failed = rows[rows["n_failed"] > 0]
    if failed.empty:
        return []
    messages = folder.errors(parts, record["estimators"][name]["reps"])
    why: dict[int, str] = {}
    if reasons is not None:
        of_failed = reasons[reasons["outcome"] == "failed"]
        groups = of_failed.groupby("replication")
        why = {some["replication"].iloc[0]: commonest(some)[0] for _, some in groups}
    columns = [c for c in FAILURES if c not in ("reason", "sentence", "error", "replay")]
    found = []
    for row in failed[columns].to_dict("records"):
        replication = row["replication"]
        reason = why.get(replication)
        again = replay_command(
            out, record["cell"], name, replication, record["config"], record.get("plugins", ())
        )
        found.append(
            {
                **{str(k): v for k, v in row.items()},
                "reason": reason,
                "sentence": None if reason is None else SENTENCES[Reason[reason.upper()]],
                "error": messages.get(replication),
                "replay": again,
            }
        )
    return found


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


def load(out: str | os.PathLike[str]) -> pd.DataFrame:
    """One tidy frame: a row per cell x estimator x replication, with a column per swept parameter.

    Columns that tables of an earlier schema lack are NaN or None. Raises UserError if `out` holds
    no run, or tables of an unknown schema.
    """
    import pandas as pd

    root = Path(out)
    if not (root / "cells.parquet").exists() or not (root / "replications.parquet").is_dir():
        raise UserError(
            f"{root}: no results here; allowed: the runner.out folder of a finished run"
        )
    cells = pd.read_parquet(root / "cells.parquet").drop(columns=["config", "estimators"])
    rows = pd.concat(
        [_replications(f) for f in sorted((root / "replications.parquet").glob("*.parquet"))]
    )
    extra = [c for c in cells.columns if c == "cell" or c not in rows.columns]
    return rows.merge(cells[extra], on="cell", how="left", validate="many_to_one").reset_index(
        drop=True
    )


def _replications(path: Path) -> pd.DataFrame:
    """A file of replications; columns that an earlier schema lacks are NaN or None."""
    import pandas as pd

    if schema_version(path) == SCHEMA:
        return pd.read_parquet(path)
    import pyarrow.parquet as pq

    rows: pd.DataFrame = pq.read_table(path, schema=schema(REPLICATIONS)).to_pandas()
    return rows
