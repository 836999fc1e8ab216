"""One study: its items, and the paths of their tables and figures."""

from __future__ import annotations

import importlib.util
import sys
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import yaml

from aoabench.resources import shipped


@dataclass(frozen=True)
class Item:
    """One table or figure: the source of its numbers, and its description."""

    name: str
    title: str
    caption: str
    alt: str = ""
    figure: bool = True
    experiment: str | None = None
    scale: Any = None  # quick, medium and paper: the overrides of an item with an experiment
    # input of its function: replications (a tidy frame) or fixes ((cell, {estimator: fixes}) each)
    reads: str = "replications"


@dataclass(frozen=True)
class Study:
    """The content of a study's folder."""

    name: str
    folder: Path
    title: str
    cite: str
    items: tuple[Item, ...]
    printed: tuple[dict[str, Any], ...]
    errata: tuple[dict[str, Any], ...]
    schematic: str = ""
    named_only: bool = False  # computed only by a command that names the study

    @property
    def numbers(self) -> ModuleType:
        """The module or package `numbers`: a function per item that computes its table."""
        return _module(self.folder, "numbers")

    @property
    def figures(self) -> ModuleType:
        """The module or package `figures`: per item, the function ITEM draws the figure from a
        table, and ITEM_values reads our numbers from it.
        """
        return _module(self.folder, "figures")


def names() -> list[str]:
    """Names of the shipped studies, sorted."""
    return sorted(p.parent.name for p in shipped("experiments").glob("*/study.yaml"))


@cache
def load(name: str) -> Study:
    """Read a study's YAML files."""
    folder = shipped("experiments") / name

    def read(file: str) -> Any:
        return yaml.safe_load((folder / file).read_text(encoding="utf-8"))

    spec = read("study.yaml")
    items = tuple(Item(name=key, **fields) for key, fields in spec["items"].items())
    printed, errata = tuple(read("claims.yaml")), tuple(read("errata.yaml"))
    rest = {key: spec[key] for key in ("schematic", "named_only") if key in spec}
    return Study(name, folder, spec["title"], spec["cite"], items, printed, errata, **rest)


@cache
def _module(folder: Path, name: str) -> ModuleType:
    """NAME.py in a study's folder, or NAME/__init__.py, whose relative imports stay inside it."""
    package = folder / name / "__init__.py"
    file = package if package.exists() else folder / f"{name}.py"
    full = f"aoabench_experiments_{folder.name}_{name}"
    spec = importlib.util.spec_from_file_location(full, file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[full] = module
    spec.loader.exec_module(module)
    return module


def table_path(results: Path, study: Study, item: Item) -> Path:
    """Path of an item's table."""
    return results / "tables" / f"{study.name}_{item.name}.parquet"


def figure_path(results: Path, study: Study, item: Item) -> Path:
    """Path of an item's figure."""
    return results / "figures" / f"{study.name}_{item.name}.png"
