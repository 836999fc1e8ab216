"""Folders of many cells: processor time of one reused cell, of new cells, and of reading them."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from aoabench.cell import Cell
from aoabench.engine import runner
from aoabench.engine.block import run_block
from aoabench.store import tables
from aoabench.store.files import provenance
from aoabench.store.folder import read_record, record_cell, write_record
from aoabench.store.keys import RunKeys
from aoabench.store.parts import write_part
from benchmarks.timing import Row, cell_of

CELLS = 10_000  # of one filter and 2 replications each
NEW = 200
SWEEP = 2_000  # new cells of one run into an empty folder


def growth(repeats: int) -> Iterator[Row]:
    """The cells of a sweep; one reused cell, new cells, and `load`, in a folder of CELLS cells."""
    with tempfile.TemporaryDirectory() as folder:
        first = cell_of(
            "reps=2", "runner.n_jobs=1", f"runner.out={folder}/out", filters=["ekf_vmf"]
        )
        runner.run([first], progress=False)
        new = [_changed(first, 1 + i) for i in range(SWEEP)]
        seconds = _cpu(lambda: runner.run(new, progress=False))
        how = "processor time of a run, without its start and its config; 1 filter, 2 replications"
        what = f"sweep of {SWEEP} new cells"
        yield Row(what, "a cell, all in", 1e3 * seconds / SWEEP, "ms", "at most 20", how)
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder, "out")
        first = cell_of("reps=2", "runner.n_jobs=1", f"runner.out={out}", filters=["ekf_vmf"])
        runner.run([first], progress=False)
        _fill(out, first)
        what, cells = f"folder of {CELLS} cells", f"1 filter, 2 replications, {CELLS} cells"
        seconds = _cpu(lambda: tables.collect(out))
        how = "processor time of the tables of all cells from their parts"
        yield Row(what, "tables, per new cell", 1e3 * seconds / CELLS, "ms", "", how)
        seconds = min(_cpu(lambda: runner.run([first], progress=False)) for _ in range(repeats))
        how = f"processor time of a run, without its start and its config; {cells}"
        yield Row(what, "one cell, reused", seconds, "s", "at most 3", how)
        seconds = _cpu(lambda: _stored(out, first, range(2 * CELLS, 2 * CELLS + NEW)))
        how = f"processor time of part, record and tables, {NEW} new cells at once; {cells}"
        yield Row(what, "new cell, stored", 1e3 * seconds / NEW, "ms", "at most 20", how)
        new = [_changed(first, CELLS + i) for i in range(NEW)]
        seconds = _cpu(lambda: runner.run(new, progress=False))
        how = f"processor time of a run of {NEW} new cells, simulation, filter and timing included"
        yield Row(what, "new cell, all in", 1e3 * seconds / NEW, "ms", "at most 20", how)
        seconds = min(_cpu(lambda: tables.load(out)) for _ in range(repeats))
        yield Row(what, "load", seconds, "s", "at most 1", f"processor time; {cells}")


def _cpu(action: Callable[[], Any]) -> float:
    """Seconds of the processor that an action takes in this process."""
    begin = time.process_time()
    action()
    return time.process_time() - begin


def _changed(cell: Cell, number: int) -> Cell:
    """The cell with another standard deviation of its noise."""
    sigma = 1 + number / 1000
    config = {**cell.config, "noise": {**cell.config["noise"], "sigma_deg": sigma}}
    noise: Any = cell.noise
    changed = replace(noise, sigma_deg=sigma)
    return replace(cell, noise=changed, config=config, swept=("noise.sigma_deg",))


def _stored(out: Path, first: Cell, numbers: Iterable[int]) -> None:
    """Store new cells, each with the results of the first one."""
    (name,) = first.estimators
    draws = RunKeys.of([first]).draws[first.id]
    block = run_block(first.scenario, first.noise, first.estimators, first.seed, 0, 2)[name]
    new = [_changed(first, number) for number in numbers]
    for cell in new:
        write_part(out, cell.id, 0, 2, block, provenance(cell.config))
        record_cell(out, cell, {name: cell.id}, draws, {}, {name: 2}, {})
    tables.collect(out, [cell.id for cell in new])


def _fill(out: Path, first: Cell) -> None:
    """Add the records of CELLS - 1 further cells, all of them with the part of the first cell."""
    record = read_record(out / "cells" / f"{first.id}.json")
    for number in range(1, CELLS):
        cell = _changed(first, number)
        write_record(out, {**record, "cell": cell.id, "config": cell.config})
