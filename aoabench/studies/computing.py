"""From an item to its table: run its experiment, and reduce what the run stored by its function."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from aoabench.cell import Cell
from aoabench.config.compose import compose_cells
from aoabench.config.overrides import file_setting
from aoabench.engine import runner
from aoabench.store import tables
from aoabench.store.fixes import Read, fixes, steps
from aoabench.studies import progress, study

_READERS = {"fixes": fixes, "steps": steps}


@dataclass(frozen=True)
class Ran:
    """The cells of a run, and the number of replications of each by its id."""

    cells: list[Cell]
    reps: dict[str, int]


@dataclass
class Runs:
    """The runs of a command's experiments, whose replications lie in a folder for each study under
    `raw`; with `fresh`, they reuse no stored replications. Items in a row that share an experiment
    and its overrides share its run.
    """

    raw: Path
    fresh: bool = False
    _last: tuple[list[str], Ran] = field(default_factory=lambda: ([], Ran([], {})))

    def folder(self, s: study.Study) -> Path:
        """The folder of a study, one for all its items, so that they share cells."""
        return self.raw / s.name

    def run(self, s: study.Study, overrides: list[str], title: str) -> Ran:
        """Run the cells of some overrides in the study's folder."""
        words = [*overrides, file_setting("runner.out", self.folder(s))]
        if self._last[0] != words:
            cells = compose_cells(words)
            reps = {cell.id: cell.reps for cell in cells}
            report = runner.run(cells, title, self.fresh)
            reps |= {row["cell"]: row["replications"] for row in report.precision}
            self._last = words, Ran(cells, reps)
        return self._last[1]


def compute(
    s: study.Study,
    item: study.Item,
    scale: str,
    runs: Runs,
    title: str = "replications",
    reps: int | None = None,
) -> tuple[Any, Any]:
    """The table (a frame) of one item, and the config that it came from. `title` stands before the
    progress bar; `reps` replaces the number of replications of the scale.
    """
    reduce = getattr(s.numbers, item.name)
    if item.experiment is None:
        with progress.shown(title):
            return reduce(scale), {
                "function": study.code_of(s, reduce),
                "scale": scale,
            }
    out = runs.folder(s)
    words = [f"experiment={item.experiment}", *item.scale[scale]]
    if reps is not None:  # in place of a precision to reach
        words = [word for word in words if not word.startswith("until.")] + [f"reps={reps}"]
    ran = runs.run(s, words, title)
    origin = {
        "experiment": item.experiment,
        "cells": [c.config for c in ran.cells],
        "reps": max(ran.reps.values()),
    }
    with progress.shown(title):
        if item.reads in _READERS:
            reader = _READERS[item.reads]
            found = ((c, Read(reader, out, c.id, c.estimators, ran.reps[c.id])) for c in ran.cells)
            return reduce(found), origin
        frame = tables.load(out, [cell.id for cell in ran.cells])
        wanted = {(c.id, name): ran.reps[c.id] for c in ran.cells for name in c.estimators}
        kept = [wanted.get(pair, 0) for pair in zip(frame["cell"], frame["estimator"])]
        return reduce(frame[frame["replication"] < kept]), origin
