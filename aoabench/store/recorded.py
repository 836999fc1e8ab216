"""What a run has recorded, read from its parts before, or without, its tables are made."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from aoabench.columns import KINDS
from aoabench.store import index as index_module
from aoabench.store import tidy
from aoabench.store.files import schema
from aoabench.store.fixes import Fixes, fixes_of, steps_of
from aoabench.store.folder import noted_parts, read_record
from aoabench.store.rows import with_identity
from aoabench.store.swept import cell_table, swept_parameters

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa


def fixes(out: Path, cell: str, estimator: str, count: int) -> Fixes:
    """The fixes of the first `count` replications; UserError if none are stored."""
    return fixes_of(out, cell, estimator, _entry(out, cell, estimator, count))


def steps(out: Path, cell: str, estimator: str, count: int) -> Fixes:
    """The same from stored steps (see store.fixes.steps)."""
    return steps_of(out, cell, estimator, _entry(out, cell, estimator, count))


def _entry(out: Path, cell: str, estimator: str, count: int) -> dict[str, Any] | None:
    """The entry of an estimator in the record of a cell, for its first `count` replications;
    None if there is none. Raises RunError if the record is missing, torn or altered.
    """
    entries = read_record(out / "cells" / f"{cell}.json")["estimators"]
    return _first(entries[estimator], count) if estimator in entries else None


def _first(known: Mapping[str, Any], count: int) -> dict[str, Any]:
    """The entry of an estimator for its first `count` replications, however many the last run that
    recorded it asked for.
    """
    return {**known, "reps": count}


def replications(out: Path, wanted: Mapping[str, Mapping[str, int]]) -> pd.DataFrame:
    """The frame of `tables.load` with the first wanted[cell][estimator] replications of some
    recorded estimators alone. The columns of swept parameters are those of the whole folder.

    Raises RunError if a record or a part is missing, torn or altered.
    """
    index = index_module.read(out)
    rows = {
        row["cell"]: _rows_of(out, row, wanted[row["cell"]]) for row in index.rows(wanted.keys())
    }
    cells = cell_table(index, swept_parameters(index))
    frame: pd.DataFrame = tidy.table(cells, rows).to_pandas()
    return frame


def _rows_of(out: Path, row: Mapping[str, Any], wanted: Mapping[str, int]) -> pa.Table:
    """The replications of some estimators of a cell, which is a row of the index."""
    import pyarrow as pa

    full = schema(KINDS["rows"])
    found = [
        with_identity(part, row, name, full)
        for name, known in json.loads(row["estimators"]).items()
        if name in wanted
        for part in noted_parts(out, _first(known, wanted[name]), "rows")
    ]
    return pa.concat_tables(found)
