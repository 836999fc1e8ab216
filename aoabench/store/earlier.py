"""Reading the tables of a folder that an earlier version wrote, which has no manifest."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from aoabench.columns import REPLICATIONS
from aoabench.errors import RunError
from aoabench.store.files import read_table, schema
from aoabench.store.folder import no_results, read_record, record_files
from aoabench.store.index import table_of_records
from aoabench.store.manifest import INDEX, torn

if TYPE_CHECKING:
    import pandas as pd


def shown(out: Path, names: Iterable[str]) -> dict[str, pd.DataFrame]:
    """The named tables as frames; `tidy` is made from the cells' files. Raises UserError if the
    folder holds no results or tables of an unknown schema, and RunError if a table is torn,
    missing, or not complete.
    """
    if not (out / "cells.parquet").exists() or not (out / "replications.parquet").is_dir():
        if record_files(out):
            raise torn(out / "cells.parquet", out, "or replications.parquet is missing")
        raise no_results(out)
    made = {"tidy": _tidy, INDEX: _index}
    return {n: made[n](out) if n in made else _frame(out / f"{n}.parquet", out) for n in names}


def _frame(path: Path, out: Path, columns: dict[str, str] | None = None) -> pd.DataFrame:
    """A table as a frame; with `columns`, those that it lacks are NaN or None."""
    try:
        table = read_table(path, None if columns is None else schema(columns))
        frame: pd.DataFrame = table.to_pandas()
    except FileNotFoundError:
        raise torn(path, out, "is missing") from None
    except (RunError, KeyError, TypeError, ValueError):
        raise torn(path, out) from None
    return frame


def _index(out: Path) -> pd.DataFrame:
    """The index of the cells' records."""
    found = ((read_record(out / "cells" / f"{cell}.json"), "") for cell in record_files(out))
    frame: pd.DataFrame = table_of_records(found).to_pandas()
    return frame


def _tidy(out: Path) -> pd.DataFrame:
    """The replications of all cells with the parameters of their cells."""
    import pandas as pd

    cells = _frame(out / "cells.parquet", out).drop(columns=["config", "estimators"])
    stored = {file.stem for file in (out / "replications.parquet").glob("*.parquet")}
    if stored != set(cells["cell"]) or stored != record_files(out).keys():
        raise torn(
            out, out, "has not the same cells in cells, cells.parquet and replications.parquet"
        )
    rows = pd.concat([_replications(out, cell) for cell in sorted(stored)])
    extra = [c for c in cells.columns if c == "cell" or c not in rows.columns]
    merged = rows.merge(cells[extra], on="cell", how="left", validate="many_to_one")
    return merged.reset_index(drop=True)


def _replications(out: Path, cell: str) -> pd.DataFrame:
    """The rows of one cell; RunError unless they are those that its record names."""
    path = out / "replications.parquet" / f"{cell}.parquet"
    rows = _frame(path, out, REPLICATIONS)
    entries = read_record(out / "cells" / f"{cell}.json")["estimators"]
    numbers = {str(name): group for name, group in rows.groupby("estimator")["replication"]}
    if set(rows["cell"]) != {cell} or numbers.keys() != entries.keys():
        raise torn(path, out, "has not the rows that its record names")
    for name, entry in entries.items():
        if numbers[name].tolist() != list(range(entry["reps"])):
            raise torn(path, out, f"has not the replications 0 to {entry['reps'] - 1} of {name}")
    return rows
