"""Parquet in and out: parts that are never computed twice, and the tables made from them.

    <out>/parts/<key>/<start>-<stop>.parquet   rows of one estimator in one cell, with provenance in the file's metadata
    <out>/parts/<key>/<start>-<stop>.json      its checksum; a part without a matching one is computed again
    <out>/cells/<cell>.json                    which cells, estimators and replications the tables show
    <out>/{replications,steps}.parquet/        one file per cell     <out>/{cells,summary,timing}.parquet

A part's key covers everything its numbers depend on (scenario, noise, this estimator's config, seed, source code,
library versions) and nothing else; the tables are views, made anew from the parts after each run.
"""

from __future__ import annotations

import ast
import functools
import hashlib
import importlib.util
import inspect
import json
import os
import sys
import uuid
from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from aoabench import statistics
from aoabench.types import UserError

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa

REPLICATIONS = {
    "cell": "string", "experiment": "string", "scenario": "string", "noise": "string", "estimator": "string",
    "replication": "int64", "rmse_3d_m": "double", "rmse_xy_m": "double", "rmse_z_m": "double", "outcome": "string",
    "n_fixes": "int64", "n_ok": "int64", "n_diverged": "int64", "n_oscillated": "int64", "n_failed": "int64",
    "n_rejected": "int64", "iterations": "double", "nees": "double",
}  # fmt: skip
STEPS = {
    "cell": "string", "experiment": "string", "scenario": "string", "noise": "string", "estimator": "string",
    "replication": "int64", "step": "int64", "x_m": "double", "y_m": "double", "z_m": "double",
    "error_3d_m": "double", "error_xy_m": "double", "error_z_m": "double", "outcome": "string",
}  # fmt: skip
TIMING = {
    "cell": "string", "experiment": "string", "scenario": "string", "noise": "string", "estimator": "string",
    "seconds_per_step": "double", "seconds_per_replication": "double", "replications": "int64", "steps": "int64",
}  # fmt: skip
_IDENTITY = ("cell", "experiment", "scenario", "noise", "estimator")


def schema(columns: Mapping[str, str], provenance: Mapping[str, Any] | None = None) -> pa.Schema:
    """The fixed Arrow schema of a table, with provenance as metadata."""
    import pyarrow as pa

    types = {"string": pa.string(), "int64": pa.int64(), "double": pa.float64(), "bool": pa.bool_()}
    meta = {"aoabench": json.dumps(provenance, default=str)} if provenance else None
    return pa.schema([(name, types[kind]) for name, kind in columns.items()], metadata=meta)


# --- keys -------------------------------------------------------------------------------------------------------------


def part_key(cell: Any, estimator: str) -> str:
    """Hash of everything that one estimator's rows in one cell depend on."""
    obj = cell.estimators[estimator]
    for group in ("filter", "estimator"):
        if estimator in (cell.config.get(group) or {}):
            described: Any = cell.config[group][estimator]
            break
    else:
        described = repr(obj)
    roots = {"aoabench.montecarlo"} | {type(o).__module__ for o in _objects([cell.scenario, cell.noise, obj])}
    content = {
        "scenario": cell.config["scenario"],
        "noise": cell.config["noise"],
        "estimator": described,
        "seed": cell.seed,
        "source": source_hash(frozenset(roots), cell.plugins) + _loose_source(obj),
        "versions": {name: metadata.version(name) for name in ("numpy", "scipy")} | {"numba": _version("numba")},
    }
    text = json.dumps(content, sort_keys=True, default=str)
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


def _objects(values: Iterable[Any]) -> Iterable[Any]:
    """The dataclass objects nested in some values."""
    for value in values:
        if hasattr(value, "__dataclass_fields__"):
            yield value
            yield from _objects(getattr(value, name) for name in value.__dataclass_fields__)
        elif isinstance(value, list | tuple):
            yield from _objects(value)


def _loose_source(obj: Any) -> str:
    """Source of a class that was typed into a session (no module to hash); unique, so never reused, if unknown."""
    if type(obj).__module__ != "__main__":
        return ""
    try:
        return hashlib.blake2b(inspect.getsource(type(obj)).encode(), digest_size=16).hexdigest()
    except (OSError, TypeError):
        return uuid.uuid4().hex


@functools.lru_cache(maxsize=512)
def source_hash(roots: frozenset[str], plugins: tuple[str, ...] = ()) -> str:
    """Hash of the syntax trees, docstrings left out, of the modules `roots` and all that they import from us.

    "Us" are the package itself, the plug-in packages, and the roots.
    """
    ours = {"aoabench", *plugins, *(root.partition(".")[0] for root in roots)} - {"__main__"}
    seen: dict[str, str] = {}
    todo = sorted(roots - {"__main__"})
    while todo:
        name = todo.pop()
        if name in seen or name.partition(".")[0] not in ours:
            continue
        file = _file_of(name)
        if file is None:
            continue
        tree = ast.parse(file.read_bytes())
        seen[name] = ""
        for node in ast.walk(tree):
            if isinstance(node, ast.Import):
                todo += [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                base = importlib.util.resolve_name("." * node.level + (node.module or ""), _package(name, file))
                inner = [f"{base}.{alias.name}" for alias in node.names]
                todo += [name if _file_of(name) else base for name in inner]
            body = getattr(node, "body", None)
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef) and body:
                first = body[0]
                if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant):
                    node.body = body[1:]  # type: ignore[assignment]
        seen[name] = ast.dump(tree)
    return hashlib.blake2b(json.dumps(sorted(seen.items())).encode(), digest_size=16).hexdigest()


def _file_of(module: str) -> Path | None:
    try:
        spec = importlib.util.find_spec(module)
    except (ImportError, AttributeError, ValueError):
        return None
    return Path(spec.origin) if spec and spec.origin and spec.origin.endswith(".py") else None


def _package(module: str, file: Path) -> str:
    return module if file.name == "__init__.py" else module.rpartition(".")[0]


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def provenance(config: Any = None) -> dict[str, Any]:
    """Where numbers come from: config, versions, processor, time."""
    return {
        "config": config,
        "aoabench": _version("aoabench"),
        "python": sys.version.split()[0],
        "libraries": {n: _version(n) for n in ("numpy", "scipy", "pandas", "pyarrow", "hydra-core", "joblib", "numba")},
        "cpu_features": _cpu_features(),
        "time": datetime.now(UTC).isoformat(timespec="seconds"),
    }


@functools.cache
def _cpu_features() -> list[str]:
    found = np.show_config(mode="dicts").get("SIMD Extensions", {})  # type: ignore[union-attr]
    return sorted([*found.get("baseline", []), *found.get("found", [])])


# --- parts ------------------------------------------------------------------------------------------------------------


def write_atomically(path: Path, write: Any) -> None:
    """Call `write(temporary path)` and move the result to `path`, so that a reader never sees half a file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.{uuid.uuid4().hex[:8]}")
    try:
        write(temporary)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def write_table(path: Path, columns: Mapping[str, Any], schema_: pa.Schema) -> None:
    """Columns of equal length to a Parquet file of this schema, atomically."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = pa.table([pa.array(columns[f.name], type=f.type, from_pandas=f.name in _IDENTITY) for f in schema_], schema=schema_)
    write_atomically(path, lambda temporary: pq.write_table(table, temporary, compression="zstd"))


def part_path(out: Path, key: str, start: int, stop: int, steps: bool = False) -> Path:
    """Where the rows of replications start..stop-1 lie."""
    return out / "parts" / key / f"{start:09d}-{stop:09d}{'.steps' if steps else ''}.parquet"


def write_part(out: Path, key: str, start: int, stop: int, rows: Any, steps: Any, origin: Mapping[str, Any]) -> None:
    """One estimator's rows (and steps, if any) of a block; the checksum goes last and makes the part count."""
    written = {}
    for content, columns, detailed in ((rows, REPLICATIONS, False), (steps, STEPS, True)):
        if content is None:
            continue
        path = part_path(out, key, start, stop, detailed)
        inner = {name: kind for name, kind in columns.items() if name not in _IDENTITY}
        write_table(path, content, schema(inner, origin))
        written[path.name] = _checksum(path)
    seal = part_path(out, key, start, stop).with_suffix(".json")
    write_atomically(seal, lambda temporary: temporary.write_text(json.dumps(written), encoding="utf-8"))


def _checksum(path: Path) -> str:
    return hashlib.blake2b(path.read_bytes(), digest_size=16).hexdigest()


def intact_parts(out: Path, key: str, steps: bool = False) -> list[tuple[int, int]]:
    """Ranges (start, stop) of the parts whose checksum fits, in order; a torn or altered one is not listed."""
    found = []
    for seal in sorted((out / "parts" / key).glob("*.json")):
        try:
            sums = json.loads(seal.read_text(encoding="utf-8"))
            good = all(_checksum(seal.parent / name) == checksum for name, checksum in sums.items())
        except (OSError, ValueError, AttributeError):
            continue
        start, stop = (int(n) for n in seal.stem.split("-"))
        if good and (not steps or part_path(out, key, start, stop, True).name in sums):
            found.append((start, stop))
    return found


def missing_ranges(done: Sequence[tuple[int, int]], reps: int) -> list[tuple[int, int]]:
    """What is left of 0..reps-1 after the ranges `done`."""
    gaps, position = [], 0
    for start, stop in sorted(done):
        if start > position:
            gaps.append((position, min(start, reps)))
        position = max(position, stop)
        if position >= reps:
            break
    if position < reps:
        gaps.append((position, reps))
    return [(a, b) for a, b in gaps if a < b]


# --- tables -----------------------------------------------------------------------------------------------------------


def record_cell(out: Path, cell: Any, keys: Mapping[str, str], timing: Mapping[str, Any]) -> None:
    """Note that the tables of `out` shall show this cell with these estimators (those noted earlier stay)."""
    path = out / "cells" / f"{cell.id}.json"
    record: dict[str, Any] = {"estimators": {}}
    if path.exists():
        try:
            record = json.loads(path.read_text(encoding="utf-8"))
        except ValueError:
            pass
    config = dict(cell.config)
    for group in ("filter", "estimator"):
        config[group] = {**(record.get("config", {}).get(group) or {}), **(cell.config.get(group) or {})}
    entries = record["estimators"]
    for name, key in keys.items():
        entries[name] = {"key": key, "reps": cell.reps, "steps": cell.runner.steps, "timing": timing.get(name)}
    record = {
        "cell": cell.id, "experiment": cell.experiment, "scenario": cell.scenario_name, "noise": cell.noise_name,
        "seed": cell.seed, "changed": dict(cell.changed), "swept": list(cell.swept), "config": config, "estimators": entries,
        "provenance": provenance(),
    }  # fmt: skip
    write_atomically(path, lambda t: t.write_text(json.dumps(record, indent=1, default=str), encoding="utf-8"))


def records(out: Path) -> list[dict[str, Any]]:
    """The noted cells, by name."""
    return [json.loads(p.read_text(encoding="utf-8")) for p in sorted((out / "cells").glob("*.json"))]


def known_timing(out: Path, cell_id: str, keys: Mapping[str, str]) -> dict[str, Any]:
    """Timings noted earlier for estimators whose keys have not changed."""
    path = out / "cells" / f"{cell_id}.json"
    if not path.exists():
        return {}
    entries = json.loads(path.read_text(encoding="utf-8"))["estimators"]
    return {n: e["timing"] for n, e in entries.items() if keys.get(n) == e["key"] and e.get("timing")}


def collect(out: Path, only: Iterable[str] | None = None) -> None:
    """Make the tables of `out` from its parts; `only` names the cells whose rows have changed (None: all)."""
    import pandas as pd

    noted = records(out)
    changed = None if only is None else set(only)
    for record in noted:
        if changed is None or record["cell"] in changed:
            _collect_rows(out, record, REPLICATIONS, "replications", steps=False)
            if any(entry["steps"] for entry in record["estimators"].values()):
                _collect_rows(out, record, STEPS, "steps", steps=True)
    swept = swept_parameters(noted)
    noted.sort(key=lambda r: (r["experiment"] or "", r["scenario"], r["noise"], _natural(swept[r["cell"]].values())))
    cells = pd.DataFrame(
        [
            {
                **{k: r[k] for k in ("cell", "experiment", "scenario", "noise", "seed")},
                **{k: v for k, v in swept[r["cell"]].items()},
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
            rows.append({**{k: record[k] for k in _IDENTITY[:4]}, "estimator": name, **statistics.summarise(group)})
    summary = pd.DataFrame(rows)
    summary["experiment"] = summary["experiment"].astype("string")
    write_frame(out / "summary.parquet", summary)
    timed = [
        {**{k: r[k] for k in _IDENTITY[:4]}, "estimator": name, **entry["timing"]}
        for r in noted
        for name, entry in r["estimators"].items()
        if entry.get("timing")
    ]
    write_table(out / "timing.parquet", {c: [t[c] for t in timed] for c in TIMING}, schema(TIMING, provenance()))


def _collect_rows(out: Path, record: Mapping[str, Any], columns: Mapping[str, str], table: str, steps: bool) -> None:
    import pyarrow as pa
    import pyarrow.compute as pc
    import pyarrow.parquet as pq

    inner = schema({n: k for n, k in columns.items() if n not in _IDENTITY})
    outer = schema(columns, {**record["provenance"], "config": record["config"]})

    def write(temporary: Path) -> None:
        with pq.ParquetWriter(temporary, outer, compression="zstd") as writer:
            for name, entry in record["estimators"].items():
                if steps and not entry["steps"]:
                    continue
                position = 0
                for start, stop in intact_parts(out, entry["key"], steps):
                    if stop <= position or start >= entry["reps"]:
                        continue
                    part = pq.read_table(part_path(out, entry["key"], start, stop, steps), schema=inner)
                    number = part["replication"]
                    keep = pc.and_(pc.greater_equal(number, position), pc.less(number, entry["reps"]))
                    part = part.filter(keep)
                    position = stop
                    same = {**{k: record[k] for k in _IDENTITY[:4]}, "estimator": name}
                    full = [
                        pa.array([same[f.name]] * len(part), f.type) if f.name in same else part[f.name] for f in outer
                    ]
                    writer.write_table(pa.table(full, schema=outer))

    write_atomically(out / f"{table}.parquet" / f"{record['cell']}.parquet", write)


def swept_parameters(noted: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """Per cell, the dotted parameters whose values differ between the cells (estimators' own where changed)."""
    flat = {r["cell"]: dict(flatten({k: r["config"][k] for k in ("scenario", "noise")})) | r["changed"] for r in noted}
    names = sorted({name for leaves in flat.values() for name in leaves if not name.endswith("_target_")})
    keep = []
    for name in names:
        values = [json.dumps(leaves.get(name)) for leaves in flat.values()]
        if len(set(values)) > 1 or any(name in r["changed"] or name in r["swept"] for r in noted):
            keep.append(name)
    return {cell: {name: _scalar(leaves.get(name)) for name in keep} for cell, leaves in flat.items()}


def flatten(node: Any, prefix: str = "") -> Iterable[tuple[str, Any]]:
    """Dotted keys and leaves of nested mappings; lists are leaves."""
    if isinstance(node, dict) and node:
        for key, value in node.items():
            yield from flatten(value, f"{prefix}.{key}" if prefix else str(key))
    else:
        yield prefix, node


def _natural(values: Iterable[Any]) -> list[tuple[bool, float, str]]:
    """Sort key: numbers by value, everything else by its text."""
    return [(not isinstance(v, int | float), float(v) if isinstance(v, int | float) else 0.0, str(v)) for v in values]


def _scalar(value: Any) -> Any:
    return value if value is None or isinstance(value, bool | int | float | str) else json.dumps(value)


def write_frame(path: Path, frame: pd.DataFrame, origin: Mapping[str, Any] | None = None) -> None:
    """A pandas frame to Parquet, atomically, with provenance."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = pa.Table.from_pandas(frame, preserve_index=False)
    meta = {**(table.schema.metadata or {}), b"aoabench": json.dumps(origin or provenance(), default=str).encode()}
    table = table.replace_schema_metadata(meta)
    write_atomically(path, lambda temporary: pq.write_table(table, temporary, compression="zstd"))


def read_provenance(path: Path) -> dict[str, Any]:
    """The provenance that a Parquet file of ours carries; {} if none."""
    import pyarrow.parquet as pq

    text = (pq.read_schema(path).metadata or {}).get(b"aoabench")
    return json.loads(text) if text else {}


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
