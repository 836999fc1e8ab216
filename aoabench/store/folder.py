"""The records of a run's folder: the cells, estimators and replications that its tables show."""

from __future__ import annotations

import functools
import json
import os
import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from aoabench.cell import Cell
from aoabench.columns import IDENTITY, KINDS
from aoabench.errors import RunError, UserError, near_file
from aoabench.store.documents import FORMAT, read_document, write_document
from aoabench.store.files import provenance, read_table, schema
from aoabench.store.parts import Part, intact_parts

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa

_MOST_NAMED = 8  # runs in a message


def no_results(out: Path) -> UserError:
    """The error for a folder without a run, with a run of a similar name or the runs in it."""
    hint = near_file(str(out))
    try:
        inside = sorted(one.name for one in out.iterdir() if (one / "cells").is_dir())
    except OSError:
        inside = []
    if inside:
        rest = ", ..." if len(inside) > _MOST_NAMED else ""
        hint = f"; it holds the runs {', '.join(inside[:_MOST_NAMED])}{rest};"
    allowed = "allowed: the runner.out folder of a finished run"
    return UserError(f"{out}: no results here{hint or ';'} {allowed}")


def record_cell(
    out: Path,
    cell: Cell,
    keys: Mapping[str, str],
    draws: str,
    timing: Mapping[str, Any],
    reps: Mapping[str, int],
    precision: Mapping[str, Any],
) -> int:
    """Record that the tables of `out` show this cell with the first `reps` replications of these
    estimators; return how many they showed before of those of which they now show fewer, at most.

    `precision` maps each estimator to the precision that it reached under cell.runner.until.

    Estimators recorded earlier stay if they saw the same draws; those of an older simulation are
    dropped, because they must not be paired with the new ones.
    """
    path = out / "cells" / f"{cell.id}.json"
    stored = before = read_record(path) if path.exists() else {}
    if before.get("draws") != draws:
        before = {"experiment": before.get("experiment")}
    entries = dict(before.get("estimators", {}))
    former = [entry["reps"] for n, entry in entries.items() if entry["key"] == keys.get(n)]
    for name, key in keys.items():
        known = {"timing": timing.get(key), "precision": precision.get(name)}
        known |= {} if cell.estimators[name].causal else {"causal": False}
        entries[name] = {"key": key, "reps": reps[name], "steps": cell.steps, **known}
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
    }
    if entries and not (stored and _same(record, stored)):
        write_record(out, {**record, "provenance": provenance()})
    return max((shown for shown in former if shown > max(reps.values())), default=0)


def _same(record: Mapping[str, Any], stored: Mapping[str, Any]) -> bool:
    """Whether a stored record of this format says the same, its provenance apart."""
    content = {k: v for k, v in stored.items() if k != "provenance"}
    return bool(content == json.loads(json.dumps({"format": FORMAT, **record}, default=str)))


def write_record(out: Path, record: Mapping[str, Any]) -> None:
    write_document(out / "cells" / f"{record['cell']}.json", record)


def read_record(path: Path) -> dict[str, Any]:
    """A cell's record. Raises RunError if the file is missing, torn or altered, or names files in
    another folder.
    """
    try:
        record = read_document(path)
        good = record["cell"] == path.stem and _sound(record)
    except FileNotFoundError:
        raise RunError(f"{path} is missing; run the same command again") from None
    except (ValueError, KeyError, TypeError, AttributeError):
        good = False
    if not good:
        raise RunError(
            f"{path} is torn or altered; delete it and run the command of its cell again: finished "
            "parts are kept"
        )
    return record


def _sound(record: Mapping[str, Any]) -> bool:
    """Whether a record has what the tables need, each of its type."""
    entries = record["estimators"].values()
    names = [record[k] for k in ("scenario", "noise")]
    return (
        all(isinstance(name, str) for name in names)
        and isinstance(record["experiment"], str | None)
        and all(isinstance(record[k], dict) for k in ("config", "changed", "provenance"))
        and all(isinstance(name, str) for name in (*record["swept"], *record.get("plugins", ())))
        and "seed" in record
        and all(entry["key"].isalnum() and type(entry["reps"]) is int for entry in entries)
        and all(entry["reps"] > 0 and type(entry["steps"]) is bool for entry in entries)
    )


def record_files(out: Path) -> dict[str, os.stat_result]:
    """The files of the cells' records: cell -> status of its file, in the order of the cells'
    names.
    """
    try:
        with os.scandir(out / "cells") as found:
            files = {e.name: e.stat() for e in found if e.name.endswith(".json")}
    except FileNotFoundError:
        return {}
    return {name.removesuffix(".json"): files[name] for name in sorted(files) if name[0] != "."}


def records(out: Path) -> list[dict[str, Any]]:
    """The records of all cells, in the order of the cells' names; RunError as in `read_record`."""
    return [read_record(out / "cells" / f"{cell}.json") for cell in record_files(out)]


def errors(parts: Iterable[Part], reps: int, lost: bool = False) -> dict[int, str]:
    """Error messages of the first `reps` replications of some parts, by number; with `lost`, only
    of replications without any position.
    """
    found: dict[int, str] = {}
    for file in (part.files["failures"] for part in parts if "failures" in part.files):
        for row in read_table(file, schema(KINDS["failures"])).to_pylist():
            if row["replication"] < reps and (row["lost"] or not lost):
                found[row["replication"]] = row["error"]
    return found


def reasons(parts: Sequence[Part], reps: int) -> pd.DataFrame:
    """Number `n` of the fixes that are not ok in the first `reps` replications of some parts, by
    replication, outcome and reason.
    """
    import pyarrow as pa

    files = [part.files["reasons"] for part in parts if "reasons" in part.files]
    if not files:
        return _no_reasons()
    columns = schema(KINDS["reasons"])
    table: pd.DataFrame = pa.concat_tables(read_table(f, columns) for f in files).to_pandas()
    table = table.drop_duplicates(["replication", "outcome", "reason"])
    return table[table["replication"] < reps]


@functools.cache
def _no_reasons() -> pd.DataFrame:
    frame: pd.DataFrame = schema(KINDS["reasons"]).empty_table().to_pandas()
    return frame


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


def values(
    out: Path, key: str, column: str, reps: int, known: np.ndarray | None = None
) -> np.ndarray:
    """One column (reps,) of the first `reps` replications of a part key, of which the first are
    `known`.
    """
    before = np.empty(0) if known is None else known[:reps]
    entry = {"key": key, "reps": reps}
    parts = noted_parts(out, entry, "rows", ["replication", column], first=len(before))
    return np.concatenate([before, *(part[column].to_numpy() for part in parts)])


def value(out: Path, key: str, column: str, replication: int) -> float:
    """One replication's value in a column of a part key; RunError if it is missing."""
    for part in intact_parts(out, key):
        if part.start <= replication < part.stop:
            rows = read_table(part.files["rows"], schema(KINDS["rows"]), ["replication", column])
            at = rows["replication"].to_pylist().index(replication)
            return float(rows[column][at].as_py())
    raise RunError(
        f"{out}: replication {replication} of part {key} is missing; run the same command again"
    )


def noted_parts(
    out: Path,
    entry: Mapping[str, Any],
    kind: str,
    columns: list[str] | None = None,
    parts: Sequence[Part] | None = None,
    first: int = 0,
) -> Iterator[pa.Table]:
    """The parts of one recorded estimator as tables, cut to its replications first ... reps-1, in
    order; `columns`, which include `replication`, are all if None. `parts` are its intact parts,
    where they are known.

    Columns that parts of an earlier schema lack are null. Raises RunError if replications are
    missing, and UserError for parts of an unknown schema.
    """
    import pyarrow as pa

    inner = schema({n: type_ for n, type_ in KINDS[kind].items() if n not in IDENTITY})
    position = first
    for found in intact_parts(out, entry["key"]) if parts is None else parts:
        if kind not in found.files or found.stop <= position or found.start >= entry["reps"]:
            continue
        if found.start > position:
            break
        part = read_table(found.files[kind], inner, columns)
        number = part["replication"].to_numpy()
        keep = (number >= position) & (number < entry["reps"])
        position = found.stop
        yield part if keep.all() else part.filter(pa.array(keep))
    if position < entry["reps"]:
        raise missing(out, entry, position)


def missing(out: Path, entry: Mapping[str, Any], first: int) -> RunError:
    """The error for a recorded estimator whose replications from `first` on have no part."""
    gap = f"replications from {first} on of part {entry['key']} are missing"
    return RunError(f"{out}: {gap}; run the same command again")
