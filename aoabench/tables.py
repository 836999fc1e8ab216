"""The tables of a run: views made from its parts, and reading them back.

<out>/cells/<cell>.json                    which cells, estimators and replications the tables show
<out>/{replications,steps}.parquet/        one file per cell
<out>/{cells,summary,timing,failures,precision}.parquet
<out>/tidy.parquet                         all replications with their cells' swept parameters;
                                           what `load` returns
"""

from __future__ import annotations

import contextlib
import json
import os
import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from aoabench import statistics
from aoabench.store import (
    IDENTITY,
    KINDS,
    REPLICATIONS,
    Part,
    flatten,
    intact_parts,
    provenance,
    schema,
    write_atomically,
    write_frame,
    write_table,
)
from aoabench.types import Outcome, RunError, UserError

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa

TIMING = {
    "cell": "string",
    "experiment": "string",
    "scenario": "string",
    "noise": "string",
    "estimator": "string",
    "seconds_per_step": "double",
    "seconds_per_replication": "double",
    "replications": "int64",
    "steps": "int64",
}


FAILURES = {
    "cell": "string",
    "experiment": "string",
    "scenario": "string",
    "noise": "string",
    "estimator": "string",
    "replication": "int64",
    "outcome": "string",
    "n_failed": "int64",
    "n_fixes": "int64",
    "error": "string",
    "replay": "string",
}
PRECISION = {
    "cell": "string",
    "experiment": "string",
    "scenario": "string",
    "noise": "string",
    "estimator": "string",
    "metric": "string",
    "replications": "int64",
    "mean": "double",
    "se": "double",
    "relative_se": "double",
    "wanted_se": "double",
    "wanted_relative_se": "double",
    "reached": "bool",
}


def record_cell(
    out: Path,
    cell: Any,
    keys: Mapping[str, str],
    draws: str,
    timing: Mapping[str, Any],
    reps: Mapping[str, int],
    precision: Mapping[str, Any],
) -> None:
    """Note that the tables of `out` shall show this cell with the first `reps` replications of
    these estimators.

    `precision` is what each reached of cell.runner.until.

    Estimators noted earlier stay, if they saw the same draws; those of an older simulation are
    dropped, because nobody may pair them.
    """
    path = out / "cells" / f"{cell.id}.json"
    before = _read_record(path)
    if before.get("draws") != draws:
        before = {"experiment": before.get("experiment")}
    entries = dict(before.get("estimators", {}))
    for name, key in keys.items():
        if not reps[name]:
            entries.pop(name, None)
            continue
        entries[name] = {
            "key": key,
            "reps": reps[name],
            "steps": cell.runner.steps,
            "timing": timing.get(key),
        }
        entries[name] |= {"precision": precision.get(name)}
    config = dict(cell.config)
    for group in ("filter", "estimator"):
        config[group] = {
            **(before.get("config", {}).get(group) or {}),
            **(cell.config.get(group) or {}),
        }
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
        _write_record(out, record)


def _write_record(out: Path, record: Mapping[str, Any]) -> None:
    text = json.dumps(record, indent=1, default=str)
    write_atomically(
        out / "cells" / f"{record['cell']}.json", lambda t: t.write_text(text, encoding="utf-8")
    )


def _read_record(path: Path) -> dict[str, Any]:
    """A cell's record; {} if there is none, it is torn, or it names files elsewhere."""
    with contextlib.suppress(OSError, ValueError, TypeError, KeyError, AttributeError):
        record = json.loads(path.read_text(encoding="utf-8"))
        keys = [entry["key"] for entry in record.get("estimators", {}).values()]
        if record["cell"] == path.stem and all(key.isalnum() for key in keys):
            return record
    return {}


def records(out: Path) -> list[dict[str, Any]]:
    """The noted cells, by name."""
    found = [_read_record(path) for path in sorted((out / "cells").glob("*.json"))]
    return [record for record in found if record]


def known_timing(out: Path) -> dict[str, Any]:
    """Timings noted so far, by part key."""
    return {
        e["key"]: e["timing"]
        for r in records(out)
        for e in r["estimators"].values()
        if e.get("timing")
    }


def collect(out: Path, only: Iterable[str] | None = None) -> None:
    """Make the tables of `out` from its parts; `only` names the cells whose rows have changed
    (None: all).

    Raises UserError if `out` holds no run, and RunError if a part has vanished, so that no table is
    silently short.
    """
    import pandas as pd

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
    noted.sort(
        key=lambda r: (
            r["experiment"] or "",
            r["scenario"],
            r["noise"],
            _natural(swept[r["cell"]].values()),
        )
    )
    cells = pd.DataFrame(
        [
            {
                **{k: r[k] for k in ("cell", "experiment", "scenario", "noise", "seed")},
                **swept[r["cell"]],
                "estimators": ", ".join(r["estimators"]),
                "config": json.dumps(r["config"], sort_keys=True),
            }
            for r in noted
        ]
    )
    cells["experiment"] = cells["experiment"].astype("string")
    for parameter in next(iter(swept.values())):
        cells[parameter] = one_kind(cells[parameter])
    write_frame(out / "cells.parquet", cells)
    _write_tidy(out, cells)
    rows, failed = [], []
    for record in noted:
        frame = pd.read_parquet(out / "replications.parquet" / f"{record['cell']}.parquet")
        for name, group in frame.groupby("estimator", sort=False):
            failed += _failures(out, record, str(name), group)
            found = statistics.summarise(group, clusters(out, record["cell"], str(name)))
            rows.append({**{k: record[k] for k in IDENTITY[:4]}, "estimator": name, **found})
    summary = pd.DataFrame(rows)
    summary["experiment"] = summary["experiment"].astype("string")
    write_frame(out / "summary.parquet", summary)
    _write_rows(out / "failures.parquet", failed, FAILURES)
    write_timing(out)


def one_kind(values: pd.Series) -> pd.Series:
    """A column that Parquet can hold: as it is if all values are numbers, all text or all true or
    false, else text.
    """
    there = values.dropna()
    kinds = {bool if isinstance(v, bool) else str if isinstance(v, str) else float for v in there}
    text = there.map(lambda v: v if isinstance(v, str) else json.dumps(v))
    return values if len(kinds) < 2 else text.reindex(values.index)


def _write_tidy(out: Path, cells: pd.DataFrame) -> None:
    """The replications of all cells with the columns of the cell table that they lack, cell by cell
    into one file.
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
    ]  # others gain nothing by a dictionary

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
    """Enter timings by part key into the records, and make the timing table."""
    for record in records(out):
        entries = record["estimators"].values()
        if any(entry["key"] in timing for entry in entries):
            for entry in entries:
                entry["timing"] = timing.get(entry["key"], entry.get("timing"))
            _write_record(out, record)
    write_timing(out)


def write_timing(out: Path) -> None:
    """The timing table, and that of the precision reached, from the noted cells."""
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


def errors(parts: Iterable[Part], reps: int, lost: bool = False) -> dict[int, str]:
    """What went wrong in the first `reps` replications of some parts, by number; `lost`: where no
    position was left.
    """
    import pyarrow.parquet as pq

    found: dict[int, str] = {}
    for file in (part.files["failures"] for part in parts if "failures" in part.files):
        for row in pq.read_table(file, schema=schema(KINDS["failures"])).to_pylist():
            if row["replication"] < reps and (row["lost"] or not lost):
                found[row["replication"]] = row["error"]
    return found


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


def _failures(
    out: Path, record: Mapping[str, Any], name: str, rows: pd.DataFrame
) -> list[dict[str, Any]]:
    """Rows of the failures table: one estimator's replications in which a fix failed."""
    failed = rows[rows["n_failed"] > 0]
    if failed.empty:
        return []
    entry = record["estimators"][name]
    said = errors(intact_parts(out, entry["key"]), entry["reps"])
    columns = [c for c in FAILURES if c not in ("error", "replay")]
    return [
        {
            **{str(k): v for k, v in row.items()},
            "error": said.get(row["replication"]),
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


def values(out: Path, key: str, column: str, reps: int) -> np.ndarray:
    """One column (reps,) of the first `reps` replications of a part key."""
    parts = _noted_parts(out, {"key": key, "reps": reps}, "rows")
    return np.concatenate([part[column].to_numpy() for part in parts])


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
                for part in _noted_parts(out, entry, kind):
                    same = {**{k: record[k] for k in IDENTITY[:4]}, "estimator": name}
                    full = [
                        pa.array([same[f.name]] * len(part), f.type)
                        if f.name in same
                        else part[f.name]
                        for f in outer
                    ]
                    writer.write_table(pa.table(full, schema=outer))

    write_atomically(out / f"{table}.parquet" / f"{record['cell']}.parquet", write)


def _noted_parts(out: Path, entry: Mapping[str, Any], kind: str) -> Iterator[pa.Table]:
    """The parts of one noted estimator as tables, cut to its replications 0 ... reps-1 and in their
    order.
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
        part = pq.read_table(found.files[kind], schema=inner)
        number = part["replication"]
        keep = pc.and_(pc.greater_equal(number, position), pc.less(number, entry["reps"]))
        position = found.stop
        yield part.filter(keep)
    if position < entry["reps"]:
        gap = f"replications from {position} on of part {entry['key']} are not there any more"
        raise RunError(f"{out}: {gap}; run the same command again")


@dataclass(frozen=True)
class Fixes:
    """Every fix of one estimator in one cell whose replications share their true positions; arrays
    (R, T).

    error_3d_m, error_xy_m in m (NaN: no position), iterations, score and anchors_used of
    types.Estimates (NaN: none told), outcome of types.Outcome, place the number of the true
    position, which several fixes may share.
    """

    error_3d_m: np.ndarray
    error_xy_m: np.ndarray
    iterations: np.ndarray
    score: np.ndarray
    anchors_used: np.ndarray
    outcome: np.ndarray
    place: np.ndarray | None = None


def fixes(out: str | os.PathLike[str], cell: str, estimator: str) -> Fixes:
    """Fixes of one estimator in one cell of the run in `out`; UserError where there are none."""
    entry = _read_record(Path(out) / "cells" / f"{cell}.json").get("estimators", {}).get(estimator)
    found = (
        [] if entry is None else [_fixes(part) for part in _noted_parts(Path(out), entry, "fixes")]
    )
    if not found:
        raise UserError(f"{out}: no fixes of {estimator!r} in cell {cell!r}")
    return Fixes(
        **{f.name: np.concatenate([getattr(one, f.name) for one in found]) for f in fields(Fixes)}
    )


def _fixes(part: pa.Table) -> Fixes:
    arrays = {}
    for f in fields(Fixes):
        column = part[f.name].combine_chunks()
        arrays[f.name] = column.flatten().to_numpy(zero_copy_only=False).reshape(len(part), -1)
    return Fixes(**arrays)


def clusters(
    out: str | os.PathLike[str],
    cell: str,
    estimator: str,
    replications: Iterable[int] | None = None,
) -> statistics.Clusters | None:
    """Sums per true position over all, or some, replications of one estimator in one cell, read
    part by part.

    None where the replications do not share their positions.
    """
    import pyarrow as pa

    root = Path(out)
    entry = _read_record(root / "cells" / f"{cell}.json").get("estimators", {}).get(estimator)
    if entry is None or not intact_parts(root, entry["key"], "fixes"):
        return None
    wanted = None if replications is None else np.fromiter(replications, dtype=np.int64)
    total: statistics.Clusters | None = None
    place: np.ndarray | None = None
    for part in _noted_parts(root, entry, "fixes"):
        if wanted is not None:
            part = part.filter(pa.array(np.isin(part["replication"].to_numpy(), wanted)))
            if len(part) == 0:
                continue
        one = _fixes(part)
        accepted = ~np.isin(one.outcome, [Outcome.FAILED, Outcome.REJECTED]) & np.isfinite(
            one.error_xy_m
        )
        found = statistics.clusters(one.error_3d_m, one.error_xy_m, one.iterations, accepted)
        total, place = found if total is None else total + found, one.place
    return None if total is None or place is None else total.grouped(place[0])


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
        ):  # a number here, a list there: texts
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
