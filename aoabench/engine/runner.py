"""From cells to tables: compute the missing parts, reuse the stored ones, then make the tables."""

from __future__ import annotations

import math
import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from aoabench.cell import Cell, Until
from aoabench.engine.faults import KEPT, explained, report, writable
from aoabench.engine.machines import Machines
from aoabench.engine.planning import merged, spread, tasks_of
from aoabench.engine.tasks import Loss, Task, kind_of
from aoabench.engine.timing import FEW, Timings
from aoabench.engine.workers import compute_all, idle
from aoabench.errors import RunError
from aoabench.maths import statistics
from aoabench.store import index, tables
from aoabench.store.claim import claim
from aoabench.store.folder import errors, record_cell, replay_command, values
from aoabench.store.keys import RunKeys
from aoabench.store.layout import sweep
from aoabench.store.lock import Lock, locked
from aoabench.store.parts import discard, examined, intact_parts, missing_ranges

_GIVE_UP_AFTER = 100  # replications; a cell stops if at least this many have all failed


@dataclass(frozen=True)
class RunReport:
    """Result of a run: the output folder, estimator-replications computed and reused, wall seconds.

    `damaged`: checksum files that did not match their parts, which were computed again.
    `precision`: the precision reached by each estimator of cells that run until a precision is
    reached (rows of precision.parquet).
    """

    out: Path
    computed: int
    reused: int
    seconds: float
    damaged: tuple[Path, ...] = ()
    precision: tuple[Mapping[str, Any], ...] = ()

    def __repr__(self) -> str:
        damaged = f", {len(self.damaged)} damaged" if self.damaged else ""
        count = f"{self.computed} estimator-replications computed, {self.reused} reused{damaged}"
        return f"RunReport({self.out}: {count}, {self.seconds:.3g} s)"


def run(
    cells: Sequence[Cell],
    progress: bool | str = True,
    fresh: bool = False,
    tabulate: bool = True,
) -> RunReport:
    """Compute the missing parts of all cells, record the cells and make the tables. The cells share
    one runner.out. With `fresh`, compute all of their parts and replace the stored ones. A text as
    `progress` stands before the progress bar. Without `tabulate`, neither make tables nor measure
    times; `collect` or the next run makes the tables.

    Raises UserError if the output folder cannot be written or holds anything but runs, or if code
    or a data file was changed after this process loaded it; RunError for an error during the run (a
    full disk, a killed worker, more failures than allowed). Finished parts are kept and shown in
    the tables where possible; the same call continues from them.
    """
    cells = merged(cells)
    out = writable(cells[0].runner.out)
    with explained(out, KEPT):
        claim(out, cells[0].runner.out)
        keys = RunKeys.of(cells)  # before the wait for the lock: keys name what is loaded now
        for line in keys.notes:
            report(line)
        with locked(out, report) as lock:
            return _Run(out, cells, keys, lock, progress, fresh).run(tabulate)


def collect(out: Path, cells: Collection[str]) -> None:
    """Make the tables of a folder whose cells `cells` were recorded by runs without tables. Raises
    as `run` does.
    """
    with explained(out, KEPT), locked(out, report):
        tables.collect(out, cells)


class _Run:
    """One run over cells that share an output folder, whose lock the caller holds."""

    def __init__(
        self,
        out: Path,
        cells: Sequence[Cell],
        keys: RunKeys,
        lock: Lock,
        progress: bool | str,
        fresh: bool,
    ) -> None:
        self.out, self.cells, self.progress, self.lock = out, cells, progress, lock
        self.options = cells[0].runner
        self.draws, self.keys, self.origins = keys.draws, keys.parts, keys.origins
        self.stale = {key for some in keys.parts.values() for key in some.values() if fresh}
        self.losses: dict[str, Loss] = {}  # by part key
        self.stored: dict[str, int] = {}  # by part key: number of replications
        self.goal: dict[str, int] = {}  # by cell: number of replications to reach next
        self.stopped: dict[str, str] = {}  # by cell: the reason
        self.precision: dict[str, dict[str, dict[str, Any]]] = {}  # by cell and estimator
        self.known: dict[str, np.ndarray] = {}  # by part key: the metric that is to be precise
        self.damaged: list[Path] = []
        self.machines = Machines(
            self.options.other_machines == "refuse", remote=self.options.backend == "dask"
        )
        self.computed = 0

    def run(self, tabulate: bool) -> RunReport:
        """Compute and record all cells, and make the tables if asked to; RunError if a cell was
        stopped.
        """
        begin = time.perf_counter()
        sweep(self.out, {key for one in self.keys.values() for key in one.values()})
        index.read(self.out, self.keys)  # raises before anything is computed
        until = self.options.until
        running = list(self.cells)
        for count in until.counts if until else [None]:
            self.goal |= {cell.id: count or cell.reps for cell in running}
            self._compute_missing(running)
            running = [
                c
                for c in running
                if c.id not in self.stopped and until and not self._precise(c, until)
            ]
            if not running:
                break
        self.lock.check()
        self.machines.compare(self.out, {key for one in self.keys.values() for key in one.values()})
        reached = self._record(tabulate)
        self.lock.check()
        if self.stopped:
            raise RunError("; ".join(self.stopped.values()))
        precision = [
            {"cell": cell, "estimator": name, **row}
            for cell, rows in self.precision.items()
            for name, row in rows.items()
        ]
        seconds = time.perf_counter() - begin
        reused = reached - self.computed
        return RunReport(
            self.out, self.computed, reused, seconds, tuple(self.damaged), tuple(precision)
        )

    def _compute_missing(self, cells: Sequence[Cell]) -> None:
        """Compute all replications up to the goals; repeat while cells stop, as other cells may
        need parts that a stopped cell shares.
        """
        while True:
            before = len(self.stopped)
            tasks = self._plan([cell for cell in cells if cell.id not in self.stopped])
            compute_all(
                tasks,
                self.out,
                self.progress,
                self._note,
                lambda task: task.cell.id in self.stopped,
            )
            if len(self.stopped) == before:
                return

    def _plan(self, cells: Sequence[Cell]) -> list[Task]:
        """Return the tasks for the missing replications of the cells, and enter the failures of
        their stored parts.
        """
        tasks: list[Task] = []
        claimed: set[str] = set()  # cells that differ in another estimator's parameter share parts
        for cell in cells:
            goal, done = self.goal[cell.id], {}
            for name, key in self.keys[cell.id].items():
                if key not in claimed:
                    claimed.add(key)
                    if key in self.stale:
                        self.stale.remove(key)
                        discard(self.out, key)
                    parts, damaged = examined(self.out, key)
                    for file in damaged:
                        report(
                            f"{file.with_suffix('').with_suffix('')}: altered or torn; "
                            "computed again"
                        )
                    self.damaged += damaged
                    self.machines.note(parts, self._most(cell))
                    self.losses[key] = Loss.of(errors(parts, goal, lost=True))
                    self.stored[key] = min(sum(part.stop - part.start for part in parts), goal)
                    done[name] = parts
                self._check(cell, name)
            if cell.id not in self.stopped:
                keys, origin = self.keys[cell.id], self.origins[cell.id]
                tasks += tasks_of(cell, keys, origin, done, goal, len(cells))
        self.machines.settle()
        return spread(tasks, idle(self.options))

    def _most(self, cell: Cell) -> int:
        """The largest number of replications that the cell may reach."""
        return self.options.until.max_reps if self.options.until else cell.reps

    def _note(self, task: Task, losses: Mapping[str, Loss]) -> None:
        """Enter the replications and losses of a finished task."""
        self.lock.check()
        self.computed += task.size
        for name, key in task.keys.items():
            self.losses[key] += losses.get(name, Loss())
            self.stored[key] += task.stop - task.start
            self._check(task.cell, name)

    def _check(self, cell: Cell, name: str) -> None:
        """Stop the cell if an estimator failed in more replications than allowed, or in all of at
        least _GIVE_UP_AFTER.
        """
        key, goal, most = self.keys[cell.id][name], self.goal[cell.id], self.options.max_failed
        loss, stored = self.losses[key], self.stored[key]
        all_failed = most < 1 and loss.count == stored >= _GIVE_UP_AFTER
        if cell.id not in self.stopped and (loss.count > most * goal or all_failed):
            again = replay_command(self.out, cell.id, name, loss.first, cell.config, cell.plugins)
            self.stopped[cell.id] = (
                f"cell {cell.id} ({cell.scenario_name}, {cell.noise_name}) stopped: "
                f"{name!r} failed in {loss.count} of {stored} replications, "
                f"more than runner.max_failed={most:g} of {goal}; "
                f"replication {loss.first}: {loss.message}{f' ({again})' if again else ''}"
            )

    def _precise(self, cell: Cell, until: Until) -> bool:
        """Whether the means of all estimators of the cell are precise enough; estimators without
        any value are ignored.
        """
        goal = self.goal[cell.id]
        rows: dict[str, dict[str, Any]] = {}
        for name, key in self.keys[cell.id].items():
            known = self.known.get(key, np.empty(0))
            self.known[key] = values(self.out, key, until.metric, goal, known)
            mean = statistics.mean(self.known[key])
            relative = mean.se / abs(mean.value) if mean.value else math.nan
            wanted = [(mean.se, until.se), (relative, until.relative_se)]
            reached = all(limit is None or error <= limit for error, limit in wanted)
            rows[name] = {
                "metric": until.metric,
                "replications": goal,
                "mean": mean.value,
                "se": mean.se,
                "relative_se": relative,
                "wanted_se": until.se,
                "wanted_relative_se": until.relative_se,
                "reached": reached,
            }
        self.precision[cell.id] = rows
        return all(row["reached"] or math.isnan(row["mean"]) for row in rows.values())

    def _record(self, tabulate: bool) -> int:
        """Record the cells, and make the tables and measure times if asked to; return the number of
        estimator-replications recorded.
        """
        timings, shown = Timings(index.read(self.out, self.keys).timing()), 0
        hidden = 0
        going = [cell for cell in self.cells if tabulate and cell.id not in self.stopped]
        for cell in (c for c in going if c.reps < FEW):  # quickly measured
            timings.measure(cell, self.keys[cell.id])
        for cell in self.cells:
            keys = self.keys[cell.id]
            reps = dict.fromkeys(keys, self.goal[cell.id])
            if cell.id in self.stopped:  # the replications before the first gap
                reps = {name: self._prefix(cell, key) for name, key in keys.items()}
            shown += sum(reps.values())
            precision = self.precision.get(cell.id, {})
            more = record_cell(
                self.out, cell, keys, self.draws[cell.id], timings.known, reps, precision
            )
            hidden = max(hidden, more)
        if hidden and tabulate and not self.stopped:
            report(
                f"the tables now show fewer replications than are stored; reps={hidden} shows all"
            )
        if tabulate:
            tables.collect(self.out, {cell.id for cell in self.cells})
        late: dict[str, Any] = {}
        for cell in going:
            late |= timings.measure(cell, self.keys[cell.id])
        tables.note_timing(self.out, late)
        return shown

    def _prefix(self, cell: Cell, key: str) -> int:
        done = [(part.start, part.stop) for part in intact_parts(self.out, key, kind_of(cell))]
        gaps = missing_ranges(done, self.goal[cell.id])
        return gaps[0][0] if gaps else self.goal[cell.id]
