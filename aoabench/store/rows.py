"""What the tables show of one cell, made from its parts: rows of replications, steps, the summary
and the failures.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from aoabench.columns import FAILURES, IDENTITY, KINDS
from aoabench.errors import RunError
from aoabench.store import folder
from aoabench.store.accuracy import Errors
from aoabench.store.files import WRITING, provenance, save, schema, write_atomically
from aoabench.store.fixes import facts_of
from aoabench.store.folder import noted_parts, replay_command
from aoabench.store.parts import Part, intact_parts
from aoabench.store.summary import commonest_of_each, summarise
from aoabench.types import SENTENCES, Reason

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa

COLUMNS = (*IDENTITY[:4], "estimators", "plugins", "config")  # of the index, those needed here


class CellRows:
    """The rows of one cell (the COLUMNS of its row of the index).

    replications: an Arrow table of all estimators (columns.REPLICATIONS), in order; summary: a row
    for each of them, without the cell's parameters; failures: rows of the failures table.
    """

    def __init__(self, out: Path, row: Mapping[str, Any]) -> None:
        import pyarrow as pa

        self.out, self.row = out, row
        self.entries = json.loads(row["estimators"])
        self.parts = {n: intact_parts(out, entry["key"]) for n, entry in self.entries.items()}
        origin = {**provenance(), "config": json.loads(row["config"])}
        self._stepped = any(entry["steps"] for entry in self.entries.values())
        kinds = ("rows", "steps") if self._stepped else ("rows",)
        self._schemas = {kind: schema(KINDS[kind], origin) for kind in kinds}
        self.summary: list[dict[str, Any]] = []
        self.failures: list[dict[str, Any]] = []
        tables = []
        for name in self.entries:
            table = pa.concat_tables(self._full(name, part, "rows") for part in self._noted(name))
            self._check_numbers(name, table["replication"].to_numpy())
            self._summarise(name, table)
            tables.append(table)
        self.replications = pa.concat_tables(tables)

    def _noted(self, name: str, kind: str = "rows") -> Any:
        return noted_parts(self.out, self.entries[name], kind, parts=self.parts[name])

    def _full(self, name: str, part: pa.Table, kind: str) -> pa.Table:
        return with_identity(part, self.row, name, self._schemas[kind])

    def _check_numbers(self, name: str, numbers: np.ndarray) -> None:
        """Raise RunError unless the replications are 0 ... reps-1."""
        key, reps = self.entries[name]["key"], self.entries[name]["reps"]
        if not np.array_equal(numbers, np.arange(reps)):
            raise RunError(
                f"{self.out}/parts/{key} does not hold the replications 0 to {reps - 1}; delete it "
                "and run the same command again"
            )

    def write(self) -> None:
        """Write replications.parquet/<cell>.parquet, and steps.parquet/<cell>.parquet if the record
        has steps.
        """
        name = f"{self.row['cell']}.parquet"
        save(self.out / "replications.parquet" / name, self.replications)
        steps = self.out / "steps.parquet" / name
        if self._stepped:
            write_atomically(steps, self._write_steps)
        else:
            steps.unlink(missing_ok=True)

    def _write_steps(self, path: Path) -> None:
        import pyarrow.parquet as pq

        with pq.ParquetWriter(path, self._schemas["steps"], **WRITING) as writer:
            for name, entry in self.entries.items():
                if entry["steps"]:
                    for part in self._noted(name, "steps"):
                        writer.write_table(self._full(name, part, "steps"))

    def _summarise(self, name: str, rows: pa.Table) -> None:
        """Add the estimator's row of the summary and its rows of the failures."""
        import pyarrow as pa

        entry, parts = self.entries[name], self.parts[name]
        columns = {n: rows[n].to_numpy() for n in rows.column_names if n not in IDENTITY}
        not_ok = bool((columns["n_ok"] < columns["n_fixes"]).any())
        reasons: pd.DataFrame | None = None
        if rows["reason"].null_count == 0:
            reasons = folder.reasons(parts if not_ok else [], entry["reps"])
        failed = columns["n_failed"] > 0
        if failed.any():
            mine = rows.filter(pa.array(failed)).to_pandas()
            self.failures += self._failures(name, mine, parts, reasons)
        clusters, errors = facts_of(self.out, entry, parts)
        if errors is None and entry["steps"]:
            errors = self._errors_of_steps(name)
        if errors is not None and np.isnan(columns["rmse_z_m"]).all():
            errors = replace(errors, z=np.full(errors.z.shape, np.nan))  # a position in the plane
        found = summarise(columns, clusters, reasons, errors)
        identity = {**{k: self.row[k] for k in IDENTITY[:4]}, "estimator": name}
        self.summary.append(identity | found | {"causal": entry.get("causal", True)})

    def _errors_of_steps(self, name: str) -> Errors:
        """Every error of an estimator whose steps are stored."""
        names = ("replication", "error_xy_m", "error_z_m", "outcome")
        tables = list(self._noted(name, "steps"))
        number, xy, z, outcome = (
            np.concatenate([table[n].to_numpy() for table in tables]) for n in names
        )
        positions = ~np.isin(outcome, ["failed", "rejected"])
        xy, z = (np.where(positions, e, np.nan) for e in (xy, z))
        counts = np.unique(number, return_counts=True)[1]
        if (counts != counts[0]).any():
            return Errors(xy, z, outcome == "ok", counts=counts)
        return Errors(*(a.reshape(len(counts), -1) for a in (xy, z, outcome == "ok")))

    def _failures(
        self, name: str, failed: pd.DataFrame, parts: Sequence[Part], reasons: pd.DataFrame | None
    ) -> list[dict[str, Any]]:
        """Rows of the failures table: one estimator's replications in which a fix failed. `reasons`
        counts the fixes that are not ok; None where unknown.
        """
        messages = folder.errors(parts, self.entries[name]["reps"])
        why: dict[int, str] = {}
        if reasons is not None:
            why = commonest_of_each(reasons[reasons["outcome"] == "failed"])
        columns = [c for c in FAILURES if c not in ("reason", "sentence", "error", "replay")]
        config, plugins = json.loads(self.row["config"]), json.loads(self.row["plugins"])
        found = []
        for row in failed[columns].to_dict("records"):
            number = row["replication"]
            reason = why.get(number)
            found.append(
                {
                    **{str(k): v for k, v in row.items()},
                    "reason": reason,
                    "sentence": None if reason is None else SENTENCES[Reason[reason.upper()]],
                    "error": messages.get(number),
                    "replay": replay_command(
                        self.out, self.row["cell"], name, number, config, plugins
                    ),
                }
            )
        return found


def with_identity(part: pa.Table, row: Mapping[str, Any], name: str, full: pa.Schema) -> pa.Table:
    """A part's table with the columns of the cell, from its `row` of the index, and the
    estimator.
    """
    import pyarrow as pa

    same = {**{k: row[k] for k in IDENTITY[:4]}, "estimator": name}
    columns = [
        pa.repeat(pa.scalar(same[f.name], f.type), len(part)) if f.name in same else part[f.name]
        for f in full
    ]
    return pa.table(columns, schema=full)
