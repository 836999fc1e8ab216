"""Parquet in and out: parts that are never computed twice, their keys, their provenance and
integrity.

    <out>/parts/<key>/<start>-<stop>.<kind>.<unique>.parquet
        rows (or steps, or fixes) of one estimator in one cell, provenance as metadata
    <out>/parts/<key>/<start>-<stop>.json
        its seal: file names and checksums; without a matching one the part is computed again
    <out>/parts/<key>/<start>-<stop>.json.damaged
        a seal that did not match its files

A part's key covers everything its numbers depend on (scenario, noise, this estimator's config,
seed, source code, library versions) and nothing else; the tables that people read are made from the
parts by `tables`.
"""

from __future__ import annotations

import ast
import contextlib
import functools
import hashlib
import importlib.util
import json
import os
import platform
import sys
import sysconfig
import uuid
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from types import FunctionType
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa

REPLICATIONS = {
    "cell": "string",
    "experiment": "string",
    "scenario": "string",
    "noise": "string",
    "estimator": "string",
    "replication": "int64",
    "rmse_3d_m": "double",
    "rmse_xy_m": "double",
    "rmse_z_m": "double",
    "outcome": "string",
    "n_fixes": "int64",
    "n_ok": "int64",
    "n_diverged": "int64",
    "n_oscillated": "int64",
    "n_failed": "int64",
    "n_rejected": "int64",
    "iterations": "double",
    "nees": "double",
}
STEPS = {
    "cell": "string",
    "experiment": "string",
    "scenario": "string",
    "noise": "string",
    "estimator": "string",
    "replication": "int64",
    "step": "int64",
    "x_m": "double",
    "y_m": "double",
    "z_m": "double",
    "error_3d_m": "double",
    "error_xy_m": "double",
    "error_z_m": "double",
    "outcome": "string",
}
FIXES = {
    "replication": "int64",
    "error_3d_m": "floats",
    "error_xy_m": "floats",
    "iterations": "floats",
    "score": "floats",
    "anchors_used": "floats",
    "outcome": "bytes",
    "place": "ints",
}
FAILURES = {"replication": "int64", "error": "string", "lost": "bool"}
# what a part may consist of; rows are always there, failures where an estimator raised or gave NaN
KINDS = {"rows": REPLICATIONS, "steps": STEPS, "fixes": FIXES, "failures": FAILURES}
IDENTITY = ("cell", "experiment", "scenario", "noise", "estimator")


def schema(columns: Mapping[str, str], provenance: Mapping[str, Any] | None = None) -> pa.Schema:
    """The fixed Arrow schema of a table, with provenance as metadata."""
    import pyarrow as pa

    types = {"string": pa.string(), "int64": pa.int64(), "double": pa.float64(), "bool": pa.bool_()}
    types |= {
        "floats": pa.list_(pa.float32()),
        "bytes": pa.list_(pa.int8()),
        "ints": pa.list_(pa.int32()),
    }
    meta = {"aoabench": json.dumps(provenance, default=str)} if provenance else None
    return pa.schema([(name, types[kind]) for name, kind in columns.items()], metadata=meta)


# --- keys -----------------------------------------------------------------------------------------


def shipped(folder: str) -> Path:
    """Where `configs` or `experiments` lie: inside the installed package, or beside it in a
    checkout.
    """
    package = Path(__file__).resolve().parent
    inside = package / folder
    return inside if inside.is_dir() else package.parent / folder


def part_key(cell: Any, estimator: str, draws: str | None = None) -> str:
    """Hash of everything that one estimator's rows in one cell depend on; `draws` is the cell's
    draws_key, if known.
    """
    obj = cell.estimators[estimator]
    preset = {**(cell.config.get("filter") or {}), **(cell.config.get("estimator") or {})}.get(
        estimator
    )
    return digest({
        "draws": draws or draws_key(cell),
        "estimator": _described(obj) if preset is None else preset,
        "source": source_hash(_modules([obj]), cell.plugins),
    })  # fmt: skip


def draws_key(cell: Any) -> str:
    """Hash of all that the simulated truth, measurements and scores of one cell depend on."""
    return digest(
        {
            "scenario": cell.config["scenario"],
            "noise": cell.config["noise"],
            "seed": cell.seed,
            "files": [
                _checksum(path)
                for o in (cell.scenario, cell.noise)
                for path in getattr(o, "files", ())
            ],
            "source": source_hash(
                {"aoabench.montecarlo", *_modules([cell.scenario, cell.noise])}, cell.plugins
            ),
            "versions": _versions(),
        }
    )


def code_key(cell: Any) -> str:
    """Hash of the source and libraries that a cell's numbers depend on, as they are where this is
    called.
    """
    modules = _modules([cell.scenario, cell.noise, *cell.estimators.values()]) - {"__main__"}
    source = source_hash({"aoabench.montecarlo", *modules}, cell.plugins)
    return digest([source, _versions()])


def _versions() -> dict[str, str | None]:
    return {name: version(name) for name in ("numpy", "scipy", "numba", "shapely")}


def digest(content: Any) -> str:
    """Hash of plain values; equal for equal content, and 5 and 5.0 are one number."""
    text = json.dumps(_canonical(content), sort_keys=True, separators=(",", ":"), default=str)
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


def _canonical(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(k): _canonical(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_canonical(v) for v in value]
    return int(value) if isinstance(value, float) and value.is_integer() else value


def _modules(values: Iterable[Any]) -> set[str]:
    """Modules that define the classes of some values and of the dataclasses nested in them."""
    found = set()
    for value in values:
        if isinstance(value, list | tuple):
            found |= _modules(value)
        elif is_dataclass(value) or callable(value):
            found.add(
                type(value).__module__ if not isinstance(value, FunctionType) else value.__module__
            )
            found |= (
                _modules(getattr(value, f.name) for f in fields(value))
                if is_dataclass(value)
                else set()
            )
    return found


def _described(value: Any) -> Any:
    """The content of an object as plain values; something unique, so that nothing is reused, where
    it is unknown.
    """
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, np.ndarray) and value.dtype != object:
        return [
            str(value.dtype),
            value.shape,
            hashlib.blake2b(np.ascontiguousarray(value).tobytes()).hexdigest(),
        ]
    if isinstance(value, list | tuple):
        return [_described(v) for v in value]
    if isinstance(value, dict):
        return {str(k): _described(v) for k, v in value.items()}
    if is_dataclass(value) and not isinstance(value, type):
        name = f"{type(value).__module__}.{type(value).__qualname__}"
        return [name, {f.name: _described(getattr(value, f.name)) for f in fields(value)}]
    return uuid.uuid4().hex


def source_hash(roots: Iterable[str], plugins: Sequence[str] = ()) -> str:
    """Hash of the syntax trees, docstrings left out, of the modules `roots` and of all they import,
    as far as that is not an installed library. A class typed into a session has no file: its hash
    is unique, so it is never reused.
    """
    ours = ("aoabench", *plugins)
    seen: dict[str, str] = {}
    todo = sorted(roots)
    while todo:
        name = todo.pop()
        if name in seen:
            continue
        file = _file_of(name)
        if file is None:
            if name == "__main__":
                seen[name] = uuid.uuid4().hex
            continue
        if not _is_ours(name, file, ours):
            continue
        stat = file.stat()
        seen[name], imports = _parsed(file, stat.st_mtime_ns, stat.st_size)
        for level, base, names in imports:
            full = (
                importlib.util.resolve_name("." * level + base, _package(name, file))
                if level
                else base
            )
            inner = [f"{full}.{n}" for n in names]
            todo += [n if _file_of(n) else full for n in inner] or [full]
    return digest(sorted(seen.items()))


def _is_ours(name: str, file: Path, ours: Sequence[str]) -> bool:
    if name == "__main__" or any(name == p or name.startswith(p + ".") for p in ours):
        return True
    return not _is_library(file)


@functools.cache
def _is_library(file: Path) -> bool:
    standard = (sysconfig.get_path("stdlib"), sysconfig.get_path("platstdlib"))
    return bool({"site-packages", "dist-packages"} & set(file.parts)) or any(
        file.is_relative_to(p) for p in standard if p
    )


@functools.lru_cache(maxsize=512)
def _parsed(file: Path, mtime: int, size: int) -> tuple[str, list[tuple[int, str, list[str]]]]:
    """Syntax tree as text, and the imports (level, module, names) of a file."""
    tree = ast.parse(file.read_bytes())
    imports: list[tuple[int, str, list[str]]] = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            imports += [(0, alias.name, []) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            imports.append((node.level, node.module or "", [alias.name for alias in node.names]))
        if (
            isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef)
            and node.body
        ):
            first = node.body[0]
            if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant):
                node.body = node.body[1:]
    return hashlib.blake2b(ast.dump(tree).encode(), digest_size=16).hexdigest(), imports


def _file_of(module: str) -> Path | None:
    if module == "__main__":
        name = getattr(sys.modules["__main__"], "__file__", None)
        return Path(name).resolve() if name and Path(name).is_file() else None
    try:
        spec = importlib.util.find_spec(module)
    except (ImportError, AttributeError, ValueError):
        return None
    return Path(spec.origin) if spec and spec.origin and spec.origin.endswith(".py") else None


def _package(module: str, file: Path) -> str:
    return module if file.name == "__init__.py" else module.rpartition(".")[0]


@functools.cache
def version(name: str) -> str | None:
    """Version of an installed library; None if it is not there."""
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def provenance(config: Any = None) -> dict[str, Any]:
    """Where numbers come from: config, versions, processor, time."""
    return {
        "config": config,
        "aoabench": version("aoabench"),
        "python": sys.version.split()[0],
        "libraries": {
            n: version(n)
            for n in ("numpy", "scipy", "pandas", "pyarrow", "hydra-core", "joblib", "numba")
        },
        "cpu_features": _cpu_features(),
        "time": datetime.now(UTC).isoformat(timespec="seconds"),
    }


@functools.cache
def _cpu_features() -> list[str]:
    found = np.show_config(mode="dicts").get("SIMD Extensions", {})
    return sorted([*found.get("baseline", []), *found.get("found", [])])


# --- parts ----------------------------------------------------------------------------------------


@contextlib.contextmanager
def locked(out: Path, say: Callable[[str], None]) -> Iterator[None]:
    """Hold the folder's lock: one run at a time writes into it; `say` gets a line if another one
    has to end first.

    The system lets go of the lock whatever ends the process. Where file systems have no locks, runs
    that overlap compute some parts twice and the tables show the cells of the one that ended last.
    """
    try:
        import fcntl
    except ImportError:
        (out / ".lock").touch()
        yield
        return
    with (out / ".lock").open("a+") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            file.seek(0)
            say(
                f"another run{file.readline().rstrip()} is writing into {out}: "
                "waiting until it has ended ..."
            )
            fcntl.flock(file, fcntl.LOCK_EX)
        except OSError as error:
            say(
                f"{out}: no file locks here ({error.strerror}); "
                "do not start two runs into it at once"
            )
        file.truncate(0)
        file.write(f" (process {os.getpid()} on {platform.node()})\n")
        file.flush()
        yield
        file.truncate(0)


def write_atomically(path: Path, write: Any) -> None:
    """Call `write(temporary path)` and move the result to `path`, so that a reader never sees half
    a file.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.{uuid.uuid4().hex[:8]}")
    try:
        write(temporary)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def write_table(path: Path, columns: Mapping[str, Any], schema_: pa.Schema) -> str:
    """Columns of equal length to a Parquet file of this schema, atomically; returns the checksum of
    its content.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    def column(field: pa.Field) -> pa.Array:
        values = columns[field.name]
        if pa.types.is_list(field.type):  # a row of an array (N, T) each
            offsets = np.arange(len(values) + 1, dtype=np.int32) * np.shape(values)[1]
            return pa.ListArray.from_arrays(
                offsets, pa.array(np.ravel(values), type=field.type.value_type)
            )
        return pa.array(values, type=field.type, from_pandas=field.name in IDENTITY)

    table = pa.table([column(field) for field in schema_], schema=schema_)
    checksum = ""

    def write(temporary: Path) -> None:
        nonlocal checksum
        pq.write_table(table, temporary, compression="zstd")
        checksum = _checksum(temporary)

    write_atomically(path, write)
    return checksum


def write_frame(path: Path, frame: pd.DataFrame, origin: Mapping[str, Any] | None = None) -> None:
    """A pandas frame to Parquet, atomically, with provenance."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = pa.Table.from_pandas(frame, preserve_index=False)
    meta = {
        **(table.schema.metadata or {}),
        b"aoabench": json.dumps(origin or provenance(), default=str).encode(),
    }
    table = table.replace_schema_metadata(meta)
    write_atomically(path, lambda temporary: pq.write_table(table, temporary, compression="zstd"))


def read_provenance(path: Path) -> dict[str, Any]:
    """The provenance that a Parquet file of ours carries; {} if none."""
    import pyarrow.parquet as pq

    text = (pq.read_schema(path).metadata or {}).get(b"aoabench")
    return json.loads(text) if text else {}


@dataclass(frozen=True)
class Part:
    """Replications start..stop-1 of one estimator, and the file of each kind (see KINDS) that it
    consists of.
    """

    start: int
    stop: int
    files: Mapping[str, Path]


def write_part(
    out: Path,
    key: str,
    start: int,
    stop: int,
    block: Mapping[str, Mapping[str, Any]],
    origin: Mapping[str, Any],
) -> None:
    """What a block found for one estimator, a table for each kind.

    Files get names of their own; the seal <start>-<stop>.json, written last, names them with their
    checksums and makes the part count. So two processes that write the same part do not mix.
    """
    folder, span = out / "parts" / key, f"{start:09d}-{stop:09d}"
    written = {}
    for kind, content in block.items():
        path = folder / f"{span}.{kind}.{uuid.uuid4().hex[:8]}.parquet"
        inner = {name: type_ for name, type_ in KINDS[kind].items() if name not in IDENTITY}
        written[kind] = [path.name, write_table(path, content, schema(inner, origin))]
    seal = json.dumps(written)
    write_atomically(
        folder / f"{span}.json", lambda temporary: temporary.write_text(seal, encoding="utf-8")
    )


def _checksum(path: Path) -> str:
    return hashlib.blake2b(path.read_bytes(), digest_size=16).hexdigest()


def _unsealed(seal: Path) -> Part | None:
    """The part of a seal; None if it is torn or altered or does not fit its files."""
    try:
        named = json.loads(seal.read_text(encoding="utf-8"))
        files = {kind: seal.parent / Path(name).name for kind, (name, _) in named.items()}
        good = all(_checksum(files[kind]) == checksum for kind, (_, checksum) in named.items())
        start, stop = (int(n) for n in seal.stem.split("-"))
    except (OSError, ValueError, AttributeError, KeyError, TypeError):
        return None
    return Part(start, stop, files) if good else None


def intact_parts(out: Path, key: str, kind: str = "rows") -> list[Part]:
    """The parts whose checksums fit and that have this kind, in order; a torn or altered one is not
    listed.
    """
    parts = (_unsealed(seal) for seal in sorted((out / "parts" / key).glob("*.json")))
    return [part for part in parts if part is not None and kind in part.files]


def has_part(out: Path, key: str, start: int, stop: int, kind: str = "rows") -> bool:
    """Whether exactly this part is there and intact."""
    seal = out / "parts" / key / f"{start:09d}-{stop:09d}.json"
    part = _unsealed(seal) if seal.exists() else None
    return part is not None and kind in part.files


def examined(out: Path, key: str) -> tuple[list[Part], list[Path]]:
    """All intact parts, in order, and the seals that do not fit their files, renamed so that they
    are told of once.
    """
    parts, damaged = [], []
    for seal in sorted((out / "parts" / key).glob("*.json")):
        part = _unsealed(seal)
        if part is None:
            damaged.append(seal.rename(f"{seal}.damaged"))
        else:
            parts.append(part)
    return parts, damaged


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
