"""The tables of a run: views made from its parts, and reading them back.

<out>/cells/<cell>.json                    which cells, estimators and replications the tables show
<out>/{replications,steps}.parquet/        one file per cell
<out>/{cells,summary,timing}.parquet
"""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from aoabench import statistics
from aoabench.store import (
    IDENTITY,
    KINDS,
    flatten,
    intact_parts,
    provenance,
    schema,
    write_atomically,
    write_frame,
    write_table,
)
from aoabench.types import Outcome, UserError

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa

TIMING = {
    "cell": "string", "experiment": "string", "scenario": "string", "noise": "string", "estimator": "string",
    "seconds_per_step": "double", "seconds_per_replication": "double", "replications": "int64", "steps": "int64",
}  # fmt: skip


def record_cell(out: Path, cell: Any, keys: Mapping[str, str], draws: str, timing: Mapping[str, Any]) -> None:
    """Note that the tables of `out` shall show this cell with these estimators.

    Estimators noted earlier stay, if they saw the same draws; those of an older simulation are dropped, because nobody
    may pair them.
    """
    path = out / "cells" / f"{cell.id}.json"
    before = _read_record(path)
    if before.get("draws") != draws:
        before = {"experiment": before.get("experiment")}
    entries = dict(before.get("estimators", {}))
    for name, key in keys.items():
        entries[name] = {"key": key, "reps": cell.reps, "steps": cell.runner.steps, "timing": timing.get(key)}
    config = dict(cell.config)
    for group in ("filter", "estimator"):
        config[group] = {**(before.get("config", {}).get(group) or {}), **(cell.config.get(group) or {})}
    record = {
        "cell": cell.id, "experiment": cell.experiment or before.get("experiment"), "scenario": cell.scenario_name,
        "noise": cell.noise_name, "seed": cell.seed, "draws": draws, "changed": dict(cell.changed),
        "swept": list(cell.swept), "config": config, "estimators": entries, "provenance": provenance(),
    }  # fmt: skip
    _write_record(out, record)


def _write_record(out: Path, record: Mapping[str, Any]) -> None:
    text = json.dumps(record, indent=1, default=str)
    write_atomically(out / "cells" / f"{record['cell']}.json", lambda t: t.write_text(text, encoding="utf-8"))


def _read_record(path: Path) -> dict[str, Any]:
    """A cell's record; {} if there is none or it is torn."""
    with contextlib.suppress(OSError, ValueError):
        record = json.loads(path.read_text(encoding="utf-8"))
        if isinstance(record, dict):
            return record
    return {}


def records(out: Path) -> list[dict[str, Any]]:
    """The noted cells, by name."""
    found = [_read_record(path) for path in sorted((out / "cells").glob("*.json"))]
    return [record for record in found if record]


def known_timing(out: Path) -> dict[str, Any]:
    """Timings noted so far, by part key."""
    return {e["key"]: e["timing"] for r in records(out) for e in r["estimators"].values() if e.get("timing")}


def collect(out: Path, only: Iterable[str] | None = None) -> None:
    """Make the tables of `out` from its parts; `only` names the cells whose rows have changed (None: all).

    Raises RuntimeError if a part has vanished, so that no table is silently short.
    """
    import pandas as pd

    noted = records(out)
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
    noted.sort(key=lambda r: (r["experiment"] or "", r["scenario"], r["noise"], _natural(swept[r["cell"]].values())))
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
    write_frame(out / "cells.parquet", cells)
    rows = []
    for record in noted:
        frame = pd.read_parquet(out / "replications.parquet" / f"{record['cell']}.parquet")
        for name, group in frame.groupby("estimator", sort=False):
            clusters = _clusters(out, record["estimators"][name])
            found = statistics.summarise(group, clusters)
            rows.append({**{k: record[k] for k in IDENTITY[:4]}, "estimator": name, **found})
    summary = pd.DataFrame(rows)
    summary["experiment"] = summary["experiment"].astype("string")
    write_frame(out / "summary.parquet", summary)
    write_timing(out)


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
    """The timing table from the noted cells."""
    timed = [
        {**{k: r[k] for k in IDENTITY[:4]}, "estimator": name, **entry["timing"]}
        for r in records(out)
        for name, entry in r["estimators"].items()
        if entry.get("timing")
    ]
    write_table(out / "timing.parquet", {c: [t[c] for t in timed] for c in TIMING}, schema(TIMING, provenance()))


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
                        pa.array([same[f.name]] * len(part), f.type) if f.name in same else part[f.name] for f in outer
                    ]
                    writer.write_table(pa.table(full, schema=outer))

    write_atomically(out / f"{table}.parquet" / f"{record['cell']}.parquet", write)


def _noted_parts(out: Path, entry: Mapping[str, Any], kind: str) -> Iterator[pa.Table]:
    """The parts of one noted estimator as tables, cut to its replications 0 ... reps-1 and in their order."""
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
        raise RuntimeError(f"{out}: {gap}; run the same command again")


@dataclass(frozen=True)
class Fixes:
    """Every fix of one estimator in one cell whose replications share their true positions; arrays (R, T).

    error_3d_m, error_xy_m in m (NaN: no position), iterations, score and anchors_used of types.Estimates (NaN: none
    told), outcome of types.Outcome.
    """

    error_3d_m: np.ndarray
    error_xy_m: np.ndarray
    iterations: np.ndarray
    score: np.ndarray
    anchors_used: np.ndarray
    outcome: np.ndarray


def fixes(out: str | os.PathLike[str], cell: str, estimator: str) -> Fixes:
    """The fixes of one estimator in one cell of the run in `out`; UserError where there are none."""
    entry = _read_record(Path(out) / "cells" / f"{cell}.json").get("estimators", {}).get(estimator)
    found = [] if entry is None else [_fixes(part) for part in _noted_parts(Path(out), entry, "fixes")]
    if not found:
        raise UserError(f"{out}: no fixes of {estimator!r} in cell {cell!r}")
    return Fixes(**{f.name: np.concatenate([getattr(one, f.name) for one in found]) for f in fields(Fixes)})


def _fixes(part: pa.Table) -> Fixes:
    arrays = {}
    for f in fields(Fixes):
        column = part[f.name].combine_chunks()
        arrays[f.name] = column.flatten().to_numpy(zero_copy_only=False).reshape(len(part), -1)
    return Fixes(**arrays)


def _clusters(out: Path, entry: Mapping[str, Any]) -> statistics.Clusters | None:
    """Sums per true position where the replications share them, part by part; None where they do not."""
    if not any(intact_parts(out, entry["key"], "fixes")):
        return None
    total: statistics.Clusters | None = None
    for part in _noted_parts(out, entry, "fixes"):
        one = _fixes(part)
        accepted = ~np.isin(one.outcome, [Outcome.FAILED, Outcome.REJECTED])
        found = statistics.clusters(one.error_3d_m, one.error_xy_m, one.iterations, accepted)
        total = found if total is None else total + found
    return total


def swept_parameters(noted: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """Per cell, the dotted parameters that differ between the cells or that a command line or experiment set."""
    full = {r["cell"]: dict(flatten(r["config"])) | r["changed"] for r in noted}
    names = {name for leaves in full.values() for name in leaves if name.startswith(("scenario.", "noise."))}
    varied = {name for name in names if len({json.dumps(leaves.get(name)) for leaves in full.values()}) > 1}
    varied |= {name for r in noted for name in (*r["changed"], *r["swept"]) if name in full[r["cell"]]}
    keep = sorted(name for name in varied if not name.endswith("_target_") and name != "seed")
    found = {cell: {name: _scalar(leaves.get(name)) for name in keep} for cell, leaves in full.items()}
    for name in keep:
        if len({_kind(values[name]) for values in found.values()} - {None}) > 1:  # a number here, a list there: texts
            for values in found.values():
                values[name] = None if values[name] is None else str(values[name])
    return found


def _kind(value: Any) -> str | None:
    return None if value is None else "number" if type(value) in (int, float) else type(value).__name__


def _natural(values: Iterable[Any]) -> list[tuple[bool, float, str]]:
    """Sort key: numbers by value, everything else by its text."""
    return [(not isinstance(v, int | float), float(v) if isinstance(v, int | float) else 0.0, str(v)) for v in values]


def _scalar(value: Any) -> Any:
    return value if value is None or isinstance(value, bool | int | float | str) else json.dumps(value)


def load(out: str | os.PathLike[str]) -> pd.DataFrame:
    """One tidy frame: a row per cell x estimator x replication, with a column per swept parameter.

    Raises UserError if `out` holds no run.
    """
    import pandas as pd

    root = Path(out)
    if not (root / "cells.parquet").exists() or not (root / "replications.parquet").is_dir():
        raise UserError(f"{root}: no results here; allowed: the runner.out folder of a finished run")
    cells = pd.read_parquet(root / "cells.parquet").drop(columns=["config", "estimators"])
    rows = pd.concat([pd.read_parquet(f) for f in sorted((root / "replications.parquet").glob("*.parquet"))])
    extra = [c for c in cells.columns if c == "cell" or c not in rows.columns]
    return rows.merge(cells[extra], on="cell", how="left", validate="many_to_one").reset_index(drop=True)
