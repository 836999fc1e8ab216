"""From a study's list of items to its tables, figures, verdicts and page.

A study is a folder under `experiments/`: study.yaml (the items), `numbers` (item -> table) and
`figures` (table -> figure and values), each a module or a package, claims.yaml, errata.yaml,
README.md. Computing ends in Parquet; drawing starts from it.
"""

from __future__ import annotations

import inspect
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from aoabench.config.compose import compose_cells
from aoabench.config.overrides import file_setting
from aoabench.engine import runner
from aoabench.engine.faults import writable
from aoabench.errors import UserError, did_you_mean
from aoabench.store import tables
from aoabench.store.files import provenance, write_frame
from aoabench.store.fixes import fixes
from aoabench.studies import claims, page, reading, study

if TYPE_CHECKING:
    import pandas as pd

Echo = Callable[[str], None]


@dataclass(frozen=True)
class Drawn:
    """Result of `draw`: the verdicts of the named studies (see `claims.verdicts`), the reason by
    (study, item) why a table cannot be used ("" if it can), and the path of the page.
    """

    verdicts: pd.DataFrame
    problems: dict[tuple[str, str], str]
    page: Path


@dataclass(frozen=True)
class Reproduced:
    """Result of `reproduce`: `computed` has a mapping (study, item, rows, seconds) for each item,
    and `drawn` is the result of `draw`.
    """

    computed: list[dict[str, Any]]
    drawn: Drawn


def all_studies() -> list[str]:
    """Names of the shipped studies."""
    return study.names()


def reproduce(
    names: Sequence[str],
    scale: str,
    only: str | None,
    results: Path,
    echo: Echo,
    formats: Sequence[str] = ("png",),
    fresh: bool = False,
) -> Reproduced:
    """Compute the items of the named studies (if none is named, of all but those that must be
    named) at a scale, then draw them; with `fresh`, reuse no stored replications.

    Raises UserError for an unknown study or item.
    """
    known = all_studies()
    for name in names:
        if name not in known:
            raise UserError(
                f"study {name!r}: unknown"
                f"{did_you_mean(name, known) or '; allowed: ' + ', '.join(known)}"
            )
    chosen = [s for s in map(study.load, names or known) if names or not s.named_only]
    items = [(s, item) for s in chosen for item in s.items if only is None or item.name == only]
    if only is not None and not items:
        present = [item.name for s in chosen for item in s.items]
        raise UserError(
            f"--only={only}: unknown item"
            f"{did_you_mean(only, present) or '; allowed: ' + ', '.join(present)}"
        )
    writable(str(results), "--results")
    computed = []
    for s, item in items:
        begin = time.perf_counter()
        frame, origin = compute(s, item, scale, results, fresh)
        seconds = round(time.perf_counter() - begin, 2)
        origin = {**provenance(origin), "scale": scale, "seconds": seconds}
        write_frame(study.table_path(results, s, item), frame, origin)
        row = {"study": s.name, "item": item.name, "rows": len(frame)}
        computed.append({**row, "seconds": origin["seconds"]})
        echo(f"{s.name} {item.name}: {len(frame)} rows, {origin['seconds']:.1f} s ({scale})")
    only_items = {item.name for _, item in items}
    drawn = draw([s.name for s in chosen], results, echo, only_items, formats)
    return Reproduced(computed, drawn)


def compute(
    s: study.Study, item: study.Item, scale: str, results: Path, fresh: bool = False
) -> tuple[Any, Any]:
    """The table (a frame) of one item, and the config that it came from."""
    reduce = getattr(s.numbers, item.name)
    if item.experiment is None:
        return reduce("quick" if scale == "quick" else "paper"), {
            "function": f"experiments/{s.name}/{_file_of(reduce, s.folder)}:{item.name}",
            "scale": scale,
        }
    out = results / "raw" / s.name  # one folder a study, so that its items share cells
    cells = compose_cells(
        [f"experiment={item.experiment}", *item.scale[scale], file_setting("runner.out", out)]
    )
    runner.run(cells, fresh=fresh)
    origin = {"experiment": item.experiment, "cells": [c.config for c in cells]}
    if item.reads == "fixes":
        found = ((c, {name: fixes(out, c.id, name) for name in c.estimators}) for c in cells)
        return reduce(found), origin
    frame = tables.load(out)
    wanted = {(c.id, name): c.reps for c in cells for name in c.estimators}
    reps = [wanted.get(pair, 0) for pair in zip(frame["cell"], frame["estimator"])]
    return reduce(frame[frame["replication"] < reps]), origin


def _file_of(function: Callable[..., Any], folder: Path) -> str:
    """The file that defines a function, relative to a folder that holds it."""
    return Path(inspect.getfile(function)).relative_to(folder).as_posix()


def draw(
    names: Sequence[str],
    results: Path,
    echo: Echo,
    only: set[str] | None = None,
    formats: Sequence[str] = ("png",),
) -> Drawn:
    """Figures of the named studies, and verdicts and page of all, from the tables under `results`.

    Calls `echo` with a line for each table of another version, and for each study with a line that
    lists the items without a table.
    """
    writable(str(results / "figures"), "--results")
    problems: dict[tuple[str, str], str] = {}
    for name in names:
        s = study.load(name)
        absent = [item.name for item in s.items if not study.table_path(results, s, item).exists()]
        for item in s.items:
            if only is None or item.name in only:
                fault = reading.draw(s, item, results, tuple(formats))
                problem = fault or reading.read(s, item, results).problem
                problems[name, item.name] = problem
                if problem:
                    echo(
                        f"{name} {item.name}: not computed: {problem}; "
                        f"aoabench reproduce {name} --only {item.name}"
                    )
        if absent and only is None:
            echo(f"{name}: not computed: {', '.join(absent)}; aoabench reproduce {name}")
    everything = [study.load(name) for name in all_studies()]
    verdicts = claims.verdicts(everything, results)
    if len(verdicts):
        write_frame(results / "tables" / "verdicts.parquet", verdicts)
    html = page.write(everything, verdicts, results, problems)
    echo("")
    named = verdicts[verdicts["study"].isin(list(names))]
    echo(claims.verdict_text(named))
    echo(f"tables   {results / 'tables'}")
    echo(f"figures  {results / 'figures'}")
    echo(f"page     {html}")
    return Drawn(named, problems, html)
