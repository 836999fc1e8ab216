"""One study: its items, its stored tables, its figures and its verdicts. Reads Parquet only."""

from __future__ import annotations

import importlib.util
import sys
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import yaml

from aoabench import statistics, store
from aoabench.statistics import Estimate
from aoabench.types import UserError

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class Item:
    """One table or figure: where its numbers come from and how it is described."""

    name: str
    title: str
    caption: str
    alt: str = ""
    figure: bool = True
    experiment: str | None = None
    scale: Any = None  # quick, medium and paper: the overrides of an item with an experiment
    # what its function gets: their tidy frame, or (cell, {estimator: fixes}) of each cell
    reads: str = "replications"


@dataclass(frozen=True)
class Study:
    """A study's folder, read."""

    name: str
    folder: Path
    title: str
    cite: str
    items: tuple[Item, ...]
    printed: tuple[dict[str, Any], ...]
    errata: tuple[dict[str, Any], ...]
    schematic: str = ""

    @property
    def numbers(self) -> ModuleType:
        """numbers.py: a function per item that computes its table."""
        return _module(self.folder / "numbers.py")

    @property
    def figures(self) -> ModuleType:
        """figures.py: per item a function of its table that draws it, and one, NAME_values, that
        reads its numbers.
        """
        return _module(self.folder / "figures.py")


def names() -> list[str]:
    """Studies that ship."""
    return sorted(p.parent.name for p in store.shipped("experiments").glob("*/study.yaml"))


@cache
def load(name: str) -> Study:
    """Read a study's YAML files."""
    folder = store.shipped("experiments") / name

    def read(file: str) -> Any:
        return yaml.safe_load((folder / file).read_text(encoding="utf-8"))

    spec = read("study.yaml")
    items = tuple(Item(name=key, **fields) for key, fields in spec["items"].items())
    printed, errata = tuple(read("printed.yaml")), tuple(read("errata.yaml"))
    return Study(
        name, folder, spec["title"], spec["cite"], items, printed, errata, spec.get("schematic", "")
    )


@cache
def _module(file: Path) -> ModuleType:
    name = f"aoabench_experiments_{file.parent.name}_{file.stem}"
    spec = importlib.util.spec_from_file_location(name, file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


def table_path(results: Path, study: Study, item: Item) -> Path:
    """Where an item's table lies."""
    return results / "tables" / f"{study.name}_{item.name}.parquet"


def figure_path(results: Path, study: Study, item: Item) -> Path:
    """Where an item's figure lies."""
    return results / "figures" / f"{study.name}_{item.name}.png"


OTHER_VERSION = "the table is of another version"
_UNFIT = (
    LookupError,
    AttributeError,
    TypeError,
    ValueError,
    OSError,
)  # from reading a table for what it lacks


def table(results: Path, study: Study, item: Item) -> pd.DataFrame | None:
    """An item's stored table; None if it was not computed."""
    import pandas as pd

    path = table_path(results, study, item)
    return pd.read_parquet(path) if path.exists() else None


def draw(study: Study, item: Item, results: Path, formats: tuple[str, ...] = ("png",)) -> str:
    """Draw an item's figure from its stored table, if it has both; returns what was wrong with the
    table, or "".

    A figure that does not come out of its table does not stay either.
    """
    path = figure_path(results, study, item)
    if not item.figure or not table_path(results, study, item).exists():
        return ""
    from aoabench.report import plots

    try:
        frame = table(results, study, item)
        plots.save(lambda: getattr(study.figures, item.name)(frame), path, formats)
    except _UNFIT as error:
        path.unlink(missing_ok=True)
        return f"{OTHER_VERSION} ({type(error).__name__}: {' '.join(str(error).split())[:80]})"
    return ""


@dataclass(frozen=True)
class Reading:
    """What an item's stored table says."""

    stored: bool
    values: dict[
        str, tuple[Estimate, float]
    ]  # by id, with the samples they rest on (NaN: not sampled)
    shown: pd.DataFrame | None = None  # texts to show as a table, where figures.py has NAME_table
    problem: str = ""  # why a stored table says nothing


def read(study: Study, item: Item, results: Path) -> Reading:
    """Read an item's stored table; for a table of another version, only `problem` is set."""
    if not table_path(results, study, item).exists():
        return Reading(False, {})
    try:
        frame = table(results, study, item)
        found: dict[str, Any] = getattr(study.figures, f"{item.name}_values", lambda _: {})(frame)
        shown = getattr(study.figures, f"{item.name}_table", lambda _: None)(frame)
    except _UNFIT:
        return Reading(True, {}, problem=OTHER_VERSION)
    pairs = {
        key: value if isinstance(value, tuple) else (value, float("nan"))
        for key, value in found.items()
    }
    return Reading(True, pairs, shown)


VERDICT_COLUMNS = (
    "study",
    "item",
    "id",
    "what",
    "printed",
    "ours",
    "se",
    "unit",
    "verdict",
    "reason",
    "claim",
)


def verdicts(studies: list[Study], results: Path) -> pd.DataFrame:
    """A row for each printed number and claim of the studies, its verdict computed from the stored
    tables.
    """
    import pandas as pd

    rows = []
    for study in studies:
        found: dict[str, tuple[Estimate, float]] = {}
        problems = {}
        for item in study.items:
            reading = read(study, item, results)
            found |= reading.values
            problems[item.name] = reading.problem
        for entry in study.printed:
            row = _judge(study, entry, found)
            unread = row["verdict"] == statistics.NOT_COMPUTED and problems[entry["item"]]
            rows.append({**row, "reason": problems[entry["item"]]} if unread else row)
    return pd.DataFrame(rows, columns=list(VERDICT_COLUMNS))


def _judge(
    study: Study, entry: dict[str, Any], found: dict[str, tuple[Estimate, float]]
) -> dict[str, Any]:
    if entry["item"] not in {item.name for item in study.items}:
        raise UserError(
            f"{study.folder / 'printed.yaml'}: {entry['id']}: "
            f"item {entry['item']!r} is not in study.yaml"
        )
    ours, samples = found.get(entry["id"], (None, float("nan")))
    claim = "claim" in entry
    limits: Any = entry.get("printed")
    if claim:
        low, high = entry["claim"]
        limits = (
            float("-inf") if low is None else float(low),
            float("inf") if high is None else float(high),
        )
    sampling = 0.0
    if ours is not None and "printed_samples" in entry and samples == samples:
        sampling = ours.se * (samples / entry["printed_samples"]) ** 0.5
    group = [e for e in study.printed if e.get("group") and e.get("group") == entry.get("group")]
    theirs = [found[e["id"]][0].value for e in group if e["id"] in found]
    in_kind = (
        bool(group)
        and len(theirs) == len(group)
        and statistics.same_order([e["printed"] for e in group], theirs)
    )
    strict, z, rounding = (
        entry.get("strict", False),
        entry.get("z", 3.0),
        entry.get("rounding", 0.0),
    )
    verdict = statistics.verdict(
        limits, rounding, ours, printed_se=sampling, in_kind=in_kind, strict=strict, z=z
    )
    reason = (
        entry.get("reason", "")
        if verdict in (statistics.NOT_REPRODUCIBLE, statistics.IN_KIND)
        else ""
    )
    if ours is not None and ours.value == ours.value and ours.se != ours.se:
        reason = "too few cases to tell a standard error"
    if ours is not None and limits is not None and verdict != statistics.NOT_COMPUTED:
        doubt = statistics.undecided(limits, rounding, ours, strict=strict, z=z)
        if doubt:
            reason = doubt
            verdict = statistics.NOT_REPRODUCIBLE if verdict == statistics.REPRODUCED else verdict
    if ours is not None and "tie" in entry and abs(ours.value) + z * ours.se <= entry["tie"]:
        verdict, reason = (
            statistics.IN_KIND,
            f"a tie: within ± {entry['tie']:g} {entry.get('unit', '')}".strip(),
        )
    return {
        "study": study.name,
        "item": entry["item"],
        "id": entry["id"],
        "what": entry["what"],
        "printed": entry.get("says", "")
        if claim
        else printed_text(limits, entry.get("rounding", 0.0)),
        "ours": float("nan") if ours is None else ours.value,
        "se": float("nan") if ours is None else ours.se,
        "unit": entry.get("unit", ""),
        "verdict": verdict,
        "reason": reason,
        "claim": claim,
    }


def printed_text(value: float | None, rounding: float) -> str:
    """A printed number with the digits that it was printed with."""
    if value is None:
        return "-"
    from math import floor, log10

    return (
        f"{value:.{max(0, -floor(log10(2 * rounding) + 1e-9))}f}" if rounding > 0 else f"{value:g}"
    )


def number_text(value: float, se: float) -> str:
    """A number with its standard error, to the digits that the error supports."""
    if value != value:
        return "-"
    if se != se or se <= 1e-12 * abs(value):  # none, or what rounding leaves of none
        return f"{value:.4g}"
    from math import floor, log10

    if abs(value) >= 1e6:
        return f"{value:.3g} ± {se:.1g}"
    digits = max(0, 1 - floor(log10(abs(se))))
    return f"{value:.{digits}f} ± {se:.{digits}f}"


def verdict_text(rows: pd.DataFrame) -> str:
    """The verdicts as lines for a terminal."""
    if not len(rows):
        return "no printed numbers"
    shown = [
        (
            r["study"],
            r["item"],
            r["what"],
            r["printed"],
            f"{number_text(r['ours'], r['se'])} {r['unit']}".strip(),
            r["verdict"] + (" (undecided)" if r["reason"].startswith("undecided") else ""),
        )
        for r in rows.to_dict("records")
    ]
    head = ("study", "item", "quantity", "printed", "ours ± s.e.", "verdict")
    widths = [max(len(str(line[i])) for line in [head, *shown]) for i in range(len(head))]
    lines = [
        "  ".join(str(cell).ljust(w) for cell, w in zip(line, widths)).rstrip()
        for line in [head, *shown]
    ]
    counts = rows["verdict"].value_counts()
    open_ = int(rows["reason"].str.startswith("undecided").sum())
    total = ", ".join(f"{n} {verdict}" for verdict, n in counts.items())
    total += f" ({open_} of these undecided: more replications would tell)" if open_ else ""
    return "\n".join(
        [
            lines[0],
            "-" * len(lines[0]),
            *lines[1:],
            "",
            f"{len(rows)} printed numbers and claims: {total}",
        ]
    )
