"""Stored parts that another kind of processor computed: reported or refused."""

from __future__ import annotations

import contextlib
import json
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

from aoabench.engine.faults import report
from aoabench.errors import RunError, UserError
from aoabench.store.documents import read_document
from aoabench.store.machine import difference, machine
from aoabench.store.parts import Part, checksum_files


@dataclass
class Machines:
    """Counts the stored parts of other kinds of processors that a run uses, by what differs.

    On a cluster (`remote`) the kind of this machine matters only with `refuse`.
    """

    refuse: bool
    remote: bool
    others: Counter[str] = field(default_factory=Counter)
    parts: int = 0
    reported: bool = False

    def note(self, parts: Iterable[Part], reps: int) -> None:
        """Enter the parts of one key that hold any of the first `reps` replications."""
        for part in parts:
            if part.start < reps:
                self.parts += 1
                if part.machine is not None and (words := difference(part.machine, machine())):
                    self.others[words] += 1

    def settle(self) -> None:
        """Report, once, that parts of other kinds are used; UserError if that is refused."""
        if not self.others or self.reported or (self.remote and not self.refuse):
            return
        self.reported = True
        (words, _), *rest = self.others.most_common()
        more = f"; and {len(rest)} other kinds" if rest else ""
        line = (
            f"{self.others.total()} of {self.parts} stored parts were computed on another kind of "
            f"processor ({words}{more}): last digits may differ; "
        )
        if self.refuse:
            raise UserError(
                f"runner.other_machines='refuse': {line}allowed: report, to use them all the same, "
                "or --fresh, to compute them here"
            )
        report(f"{line}--fresh computes them here, runner.other_machines=refuse stops the run")

    def compare(self, out: Path, keys: Iterable[str]) -> None:
        """Report that the workers of a cluster, or earlier runs, were of several kinds."""
        if not self.remote:
            return
        files = (file for key in keys for file in checksum_files(out, key))
        found = Counter(json.dumps(_machine_in(file), sort_keys=True) for file in files)
        del found["null"]
        kinds = [json.loads(text) for text, _ in found.most_common()]
        if len(kinds) > 1:
            words = difference(kinds[1], kinds[0], "others")
            report(
                f"the parts were computed on {len(kinds)} kinds of processors ({words}): last "
                "digits may differ; runner.other_machines=refuse allows that of this machine only"
            )


def _machine_in(file: Path) -> dict[str, str] | None:
    """The machine in the checksum file of a part; None if it holds none."""
    with contextlib.suppress(OSError, ValueError):
        found: dict[str, str] | None = read_document(file).get("machine")
        return found
    return None


def check_same(wanted: dict[str, str], name: str) -> None:
    """Raise RunError if this process, a worker on the machine `name`, computes on another kind of
    processor than `wanted`.
    """
    if words := difference(machine(), wanted):
        raise RunError(
            f"the worker on {name} computes on another kind of processor than this run ({words}), "
            "which runner.other_machines=refuse does not allow; allowed: report"
        )
