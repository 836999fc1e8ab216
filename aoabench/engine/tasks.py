"""A task: one block of replications of one cell. The worker that computes it writes its parts."""

from __future__ import annotations

from collections.abc import Mapping
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path

from aoabench.cell import Cell
from aoabench.engine.block import run_block
from aoabench.engine.memory import keep_freed_memory
from aoabench.store.files import provenance
from aoabench.store.keys import Origin
from aoabench.store.lock import check_held
from aoabench.store.machine import machine
from aoabench.store.parts import has_part, write_part

_checked: ContextVar[Origin | None] = ContextVar("checked", default=None)  # after the last task


@dataclass(frozen=True)
class Task:
    """Replications start..stop-1 of one cell for some of its estimators (name -> part key), and the
    code and data behind the keys.
    """

    cell: Cell
    keys: Mapping[str, str]
    origin: Origin
    start: int
    stop: int

    @property
    def size(self) -> int:
        """Replications times estimators."""
        return (self.stop - self.start) * len(self.keys)


@dataclass(frozen=True)
class Loss:
    """Count of an estimator's replications lost to exceptions and undeclared NaN, with number and
    message of the first.
    """

    count: int = 0
    first: int = -1
    message: str = ""

    def __add__(self, other: Loss) -> Loss:
        if not self.count or not other.count:
            return self if self.count else other
        early = min(self, other, key=lambda loss: loss.first)
        return Loss(self.count + other.count, early.first, early.message)

    @classmethod
    def of(cls, errors: Mapping[int, str]) -> Loss:
        """The loss from error messages by replication number."""
        return cls(len(errors), min(errors), errors[min(errors)]) if errors else cls()


def kind_of(cell: Cell) -> str:
    """The kind of table that a part must hold for the cell: `steps` or `rows`."""
    return "steps" if cell.steps else "rows"


def compute(task: Task, out: Path) -> dict[str, Loss]:
    """Compute one task in a worker and write its parts; return the losses by estimator.

    A part that another process finished since the task was planned (a worker that outlived its
    killed parent) is not computed again. Raises RunError if this process has other code or data
    than the run that planned the task: before the first task of this code, and after each task,
    before anything is written.
    """
    cell = task.cell
    keep_freed_memory()
    if _checked.get() != task.origin:
        task.origin.check()
    check_held(out)
    kind, span = kind_of(cell), (task.start, task.stop)
    missing = [name for name, key in task.keys.items() if not has_part(out, key, *span, kind)]
    estimators = {name: cell.estimators[name] for name in missing}
    blocks = run_block(cell.scenario, cell.noise, estimators, cell.seed, *span, cell.steps)
    task.origin.check()
    _checked.set(task.origin)
    losses = {}
    check_held(out)  # no folder is made in the place of one that was moved meanwhile
    for name, block in blocks.items():
        origin = provenance({**cell.config, "this_estimator": name})
        write_part(out, task.keys[name], *span, block, origin, machine())
        if "failures" in block:
            errors = dict(
                zip(block["failures"]["replication"].tolist(), block["failures"]["error"])
            )
            losses[name] = Loss.of(
                {r: errors[r] for r in block["failures"]["replication"][block["failures"]["lost"]]}
            )
    return losses


def numbered(number: int, task: Task, out: Path) -> tuple[int, dict[str, Loss]]:
    """Compute one task; return its number and losses, as tasks finish in any order."""
    return number, compute(task, out)
