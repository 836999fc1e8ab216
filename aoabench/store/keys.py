"""Keys of parts: hashes of everything that the numbers of a part depend on.

A part's key covers scenario, noise, this estimator's config, seed, data files, source code and
library versions, and nothing else.
"""

from __future__ import annotations

import ast
import functools
import hashlib
import importlib.util
import sys
import sysconfig
import uuid
from collections.abc import Iterable, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from types import FunctionType
from typing import Any

from aoabench.cell import Cell
from aoabench.maths.digest import described, digest
from aoabench.resources import version
from aoabench.store.files import file_checksum


def part_key(cell: Cell, estimator: str, draws: str | None = None) -> str:
    """Hash of everything that one estimator's rows in one cell depend on; `draws` is the cell's
    draws_key, if known.
    """
    obj = cell.estimators[estimator]
    preset = {**(cell.config.get("filter") or {}), **(cell.config.get("estimator") or {})}.get(
        estimator
    )
    return digest({
        "draws": draws or draws_key(cell),
        "estimator": described(obj) if preset is None else preset,
        "source": source_hash(_modules([obj]), cell.plugins),
    })  # fmt: skip


def draws_key(cell: Cell) -> str:
    """Hash of everything that the simulated truth and measurements of one cell, and the metrics
    computed from them, depend on: scenario, noise, seed, data files, source, library versions.
    """
    return digest(
        {
            "scenario": cell.config["scenario"],
            "noise": cell.config["noise"],
            "seed": cell.seed,
            "files": [file_checksum(path) for o in (cell.scenario, cell.noise) for path in o.files],
            "source": source_hash(
                {"aoabench.engine.block", *_modules([cell.scenario, cell.noise])}, cell.plugins
            ),
            "versions": _versions(),
        }
    )


def code_key(cell: Cell) -> str:
    """Hash of the source and libraries that a cell's numbers depend on, as installed on this
    machine.
    """
    modules = _modules([cell.scenario, cell.noise, *cell.estimators.values()]) - {"__main__"}
    source = source_hash({"aoabench.engine.block", *modules}, cell.plugins)
    return digest([source, _versions()])


def _versions() -> dict[str, str | None]:
    return {name: version(name) for name in ("numpy", "scipy", "numba", "shapely")}


def _modules(values: Iterable[Any]) -> set[str]:
    """Modules that define the classes of some values and of the dataclasses nested in them."""
    found = set()
    for value in values:
        if isinstance(value, list | tuple):
            found |= _modules(value)
        elif is_dataclass(value) or callable(value):
            owner = value if isinstance(value, FunctionType) else type(value)
            found.add(owner.__module__)
            inner = fields(value) if is_dataclass(value) else ()
            found |= _modules(getattr(value, f.name) for f in inner)
    return found


def source_hash(roots: Iterable[str], plugins: Sequence[str] = ()) -> str:
    """Hash of the syntax trees, without docstrings, of the modules `roots` and of all modules they
    import, except installed libraries.

    A class defined interactively has no file; its hash is unique, so that it is never reused.
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
