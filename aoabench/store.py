"""Parquet in and out: parts that are never computed twice, their keys, their provenance and integrity.

    <out>/parts/<key>/<start>-<stop>.parquet   rows of one estimator in one cell, with provenance in the file's metadata
    <out>/parts/<key>/<start>-<stop>.json      its checksum; a part without a matching one is computed again

A part's key covers everything its numbers depend on (scenario, noise, this estimator's config, seed, source code,
library versions) and nothing else; the tables that people read are made from the parts by `tables`.
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
IDENTITY = ("cell", "experiment", "scenario", "noise", "estimator")


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
                    node.body = body[1:]
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
    found = np.show_config(mode="dicts").get("SIMD Extensions", {})
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

    table = pa.table(
        [pa.array(columns[f.name], type=f.type, from_pandas=f.name in IDENTITY) for f in schema_], schema=schema_
    )
    write_atomically(path, lambda temporary: pq.write_table(table, temporary, compression="zstd"))


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
        inner = {name: kind for name, kind in columns.items() if name not in IDENTITY}
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


def flatten(node: Any, prefix: str = "") -> Iterable[tuple[str, Any]]:
    """Dotted keys and leaves of nested mappings; lists are leaves."""
    if isinstance(node, dict) and node:
        for key, value in node.items():
            yield from flatten(value, f"{prefix}.{key}" if prefix else str(key))
    else:
        yield prefix, node
