"""The records of a run's folder: the cells, estimators and replications that its tables show."""

from __future__ import annotations

import contextlib
import json
import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from aoabench.cell import Cell
from aoabench.columns import IDENTITY, KINDS
from aoabench.errors import RunError
from aoabench.store.files import provenance, schema, schema_version, write_atomically
from aoabench.store.parts import Part, intact_parts

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa


def record_cell(
    out: Path,
    cell: Cell,
    keys: Mapping[str, str],
    draws: str,
    timing: Mapping[str, Any],
    reps: Mapping[str, int],
    precision: Mapping[str, Any],
) -> None:
    """Record that the tables of `out` show this cell with the first `reps` replications of these
    estimators.

    `precision` maps each estimator to the precision that it reached under cell.runner.until.

    Estimators recorded earlier stay if they saw the same draws; those of an older simulation are
    dropped, because they must not be paired with the new ones.
    """
    before = read_record(out / "cells" / f"{cell.id}.json")
    if before.get("draws") != draws:
        before = {"experiment": before.get("experiment")}
    entries = dict(before.get("estimators", {}))
    for name, key in keys.items():
        known = {"timing": timing.get(key), "precision": precision.get(name)}
        entries[name] = {"key": key, "reps": reps[name], "steps": cell.runner.steps, **known}
    entries = {name: entry for name, entry in entries.items() if entry["reps"]}
    config = dict(cell.config)
    for group in ("filter", "estimator"):
        earlier = before.get("config", {}).get(group) or {}
        config[group] = {**earlier, **(cell.config.get(group) or {})}
    record = {
        "cell": cell.id,
        "experiment": cell.experiment or before.get("experiment"),
        "scenario": cell.scenario_name,
        "noise": cell.noise_name,
        "seed": cell.seed,
        "draws": draws,
        "changed": dict(cell.changed),
        "swept": list(cell.swept),
        "config": config,
        "estimators": entries,
        "plugins": list(cell.plugins),
        "provenance": provenance(),
    }
    if entries:
        write_record(out, record)


def write_record(out: Path, record: Mapping[str, Any]) -> None:
    text = json.dumps(record, indent=1, default=str)
    write_atomically(
        out / "cells" / f"{record['cell']}.json", lambda t: t.write_text(text, encoding="utf-8")
    )


def read_record(path: Path) -> dict[str, Any]:
    """A cell's record; {} if the file is missing, torn or names files in another folder."""
    with contextlib.suppress(OSError, ValueError, TypeError, KeyError, AttributeError):
        record: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        keys = [entry["key"] for entry in record.get("estimators", {}).values()]
        if record["cell"] == path.stem and all(key.isalnum() for key in keys):
            return record
    return {}


def records(out: Path) -> list[dict[str, Any]]:
    """The records of all cells, in the order of the cells' names."""
    found = [read_record(path) for path in sorted((out / "cells").glob("*.json"))]
    return [record for record in found if record]


def known_timing(out: Path) -> dict[str, Any]:
    """Timings recorded so far, by part key."""
    return {
        e["key"]: e["timing"]
        for r in records(out)
        for e in r["estimators"].values()
        if e.get("timing")
    }


def errors(parts: Iterable[Part], reps: int, lost: bool = False) -> dict[int, str]:
    """Error messages of the first `reps` replications of some parts, by number; with `lost`, only
    of replications without any position.
    """
    import pyarrow.parquet as pq

    found: dict[int, str] = {}
    for file in (part.files["failures"] for part in parts if "failures" in part.files):
        schema_version(file)
        for row in pq.read_table(file, schema=schema(KINDS["failures"])).to_pylist():
            if row["replication"] < reps and (row["lost"] or not lost):
                found[row["replication"]] = row["error"]
    return found


def reasons(parts: Iterable[Part], reps: int) -> pd.DataFrame:
    """Number `n` of the fixes that are not ok in the first `reps` replications of some parts, by
    replication, outcome and reason.
    """
    import pandas as pd
    import pyarrow.parquet as pq

    columns = schema(KINDS["reasons"])
    found = [columns.empty_table().to_pandas()]
    for file in (part.files["reasons"] for part in parts if "reasons" in part.files):
        schema_version(file)
        found.append(pq.read_table(file, schema=columns).to_pandas())
    table: pd.DataFrame = pd.concat(found, ignore_index=True)
    table = table.drop_duplicates(["replication", "outcome", "reason"])
    return table[table["replication"] < reps]


def replay_command(
    out: Path | str,
    cell: str,
    estimator: str,
    replication: int,
    config: Mapping[str, Any],
    plugins: Sequence[str] = (),
) -> str | None:
    """The command that repeats one replication with its trace; None for an estimator that no preset
    describes.
    """
    if estimator not in {**(config.get("filter") or {}), **(config.get("estimator") or {})}:
        return None
    words = [
        "aoabench",
        "replay",
        str(out),
        "--cell",
        cell,
        "--estimator",
        estimator,
        "--replication",
        str(replication),
    ]
    return shlex.join([*words, "--plugins", ",".join(plugins)] if plugins else words)


def values(out: Path, key: str, column: str, reps: int) -> np.ndarray:
    """One column (reps,) of the first `reps` replications of a part key."""
    parts = noted_parts(out, {"key": key, "reps": reps}, "rows")
    return np.concatenate([part[column].to_numpy() for part in parts])


def noted_parts(
    out: Path, entry: Mapping[str, Any], kind: str, columns: list[str] | None = None
) -> Iterator[pa.Table]:
    """The parts of one recorded estimator as tables, cut to its replications 0 ... reps-1, in
    order; `columns`, which include `replication`, are all if None.

    Columns that parts of an earlier schema lack are null. Raises RunError if replications are
    missing, and UserError for parts of an unknown schema.
    """
    import pyarrow.compute as pc
    import pyarrow.parquet as pq

    inner = schema({n: type_ for n, type_ in KINDS[kind].items() if n not in IDENTITY})
    position = 0
    for found in intact_parts(out, entry["key"], kind):
        if found.stop <= position or found.start >= entry["reps"]:
            continue
        if found.start > position:
            break
        schema_version(found.files[kind])
        part = pq.read_table(found.files[kind], schema=inner, columns=columns)
        number = part["replication"]
        keep = pc.and_(pc.greater_equal(number, position), pc.less(number, entry["reps"]))
        position = found.stop
        yield part.filter(keep)
    if position < entry["reps"]:
        gap = f"replications from {position} on of part {entry['key']} are missing"
        raise RunError(f"{out}: {gap}; run the same command again")
