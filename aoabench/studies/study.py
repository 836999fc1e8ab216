"""One study: its items, and the paths of their tables and figures."""

from __future__ import annotations

import importlib.util
import inspect
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import yaml

from aoabench.resources import shipped
from aoabench.studies import claims
from aoabench.studies.claims import Claim


@dataclass(frozen=True)
class Item:
    """One table or figure: the source of its numbers, and its description."""

    name: str
    title: str
    caption: str
    alt: str = ""
    figure: bool = True
    experiment: str | None = None
    scale: Any = None  # quick and paper: the overrides of an item with an experiment
    # input of its function: replications (a tidy frame), or fixes or steps ((cell, {estimator:
    # store.fixes.Fixes}) each)
    reads: str = "replications"
    judged_at: str = "paper"  # the scale that its claims need: paper, or any
    counts: str = "replications"  # the independent units behind its standard errors
    basis: str = ""  # what the claims on it rest on, shown beside each verdict
    times: bool = False  # it measures times: nothing else is computed meanwhile
    after: str | None = None  # item that has a part of its replications and is computed before it

    @property
    def paper_reps(self) -> float:
        """The replications at paper scale; NaN if they are not stated."""
        given = [] if self.scale is None else self.scale["paper"]
        found = [float(o.removeprefix("reps=")) for o in given if o.startswith("reps=")]
        return found[0] if found else float("nan")


@dataclass(frozen=True)
class Study:
    """The content of a study's folder."""

    name: str
    folder: Path
    title: str
    cite: str
    items: tuple[Item, ...]
    claims: tuple[Claim, ...]
    errata: tuple[dict[str, Any], ...]
    schematic: str = ""
    unclaimed: Mapping[str, str] = field(default_factory=dict)  # see claims.Claims
    findings: tuple[str, ...] = ()  # templates of sentences, see findings.filled
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
    found = claims.load(folder / "claims.yaml", spec["items"])
    return Study(
        name,
        folder,
        spec["title"],
        spec["cite"],
        items,
        found.claims,
        tuple(read("errata.yaml")),
        spec.get("schematic", ""),
        found.unclaimed,
        tuple(spec.get("finding", ())),
        spec.get("named_only", False),
    )


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


def code_of(study: Study, function: Callable[..., Any]) -> str:
    """File and name of a function of a study, e.g. experiments/lu2019/numbers/trials.py:fig4."""
    file = Path(inspect.getfile(function)).relative_to(study.folder).as_posix()
    return f"experiments/{study.name}/{file}:{function.__name__}"


def table_path(results: Path, study: Study, item: Item) -> Path:
    """Path of an item's table."""
    return results / "tables" / f"{study.name}_{item.name}.parquet"


def figure_path(results: Path, study: Study, item: Item) -> Path:
    """Path of an item's figure."""
    return results / "figures" / f"{study.name}_{item.name}.png"
