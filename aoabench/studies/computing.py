"""From an item to its table: run its experiment, and reduce what the run stored by its function."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from aoabench.cell import Cell
from aoabench.config.compose import compose_cells
from aoabench.config.overrides import file_setting
from aoabench.engine import runner
from aoabench.store import recorded
from aoabench.store.fixes import Read
from aoabench.studies import study

_READERS = {"fixes": recorded.fixes, "steps": recorded.steps}


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
    _without_tables: dict[Path, set[str]] = field(default_factory=dict)  # cells, by folder

    def folder(self, s: study.Study) -> Path:
        """The folder of a study, one for all its items, so that they share cells."""
        return self.raw / s.name

    def run(self, s: study.Study, overrides: list[str], title: str) -> Ran:
        """Run the cells of some overrides in the study's folder."""
        words = [*overrides, file_setting("runner.out", self.folder(s))]
        if self._last[0] != words:
            cells = compose_cells(words)
            reps = {cell.id: cell.reps for cell in cells}
            self._without_tables.setdefault(self.folder(s), set()).update(reps)
            report = runner.run(cells, title, self.fresh, tabulate=False)
            reps |= {row["cell"]: row["replications"] for row in report.precision}
            self._last = words, Ran(cells, reps)
        return self._last[1]

    def tabulate(self, s: study.Study) -> None:
        """Make the tables of a study's folder; its items have read the parts."""
        cells = self._without_tables.pop(self.folder(s), None)
        if cells:
            runner.collect(self.folder(s), cells)


def run(
    s: study.Study,
    item: study.Item,
    scale: str,
    runs: Runs,
    title: str = "replications",
    reps: int | None = None,
) -> Ran | None:
    """Run the experiment of an item; None if it has none. `title` stands before the progress bar;
    `reps` replaces the number of replications of the scale.
    """
    if item.experiment is None:
        return None
    words = [f"experiment={item.experiment}", *item.scale[scale]]
    if reps is not None:  # in place of a precision to reach
        words = [word for word in words if not word.startswith("until.")] + [f"reps={reps}"]
    return runs.run(s, words, title)


def reduce(
    s: study.Study, item: study.Item, scale: str, out: Path, ran: Ran | None
) -> tuple[Any, Any]:
    """The table (a frame) of one item, from what its experiment has recorded in the folder `out`,
    and the config that it came from.
    """
    function = getattr(s.numbers, item.name)
    if ran is None:
        return function(scale), {"function": study.code_of(s, function), "scale": scale}
    origin = {
        "experiment": item.experiment,
        "cells": [c.config for c in ran.cells],
        "reps": max(ran.reps.values()),
    }
    if item.reads in _READERS:
        return function((c, _read(item.reads, out, c, ran.reps[c.id])) for c in ran.cells), origin
    wanted: dict[str, dict[str, int]] = {}
    for c in ran.cells:
        wanted.setdefault(c.id, {}).update(dict.fromkeys(c.estimators, ran.reps[c.id]))
    return function(recorded.replications(out, wanted)), origin


def _read(what: str, out: Path, cell: Cell, reps: int) -> Read:
    """What an item reads of one cell: `fixes` or `steps` of the first `reps` replications."""
    return Read(lambda name: _READERS[what](out, cell.id, name, reps), cell.estimators)
