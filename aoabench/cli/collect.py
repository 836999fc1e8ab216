"""`aoabench collect`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from aoabench.cli.common import Parser
from aoabench.errors import UserError


def collect(arguments: Sequence[str]) -> int:
    """`aoabench collect`: make the tables of a run again from its parts."""
    from aoabench.store import folder, tables
    from aoabench.store.files import locked

    parser = Parser(
        prog="aoabench collect",
        description="Make the tables of a run from its parts; every run does so.",
    )
    parser.add_argument("run", help="folder of a run (runner.out)")
    given = parser.parse_args(list(arguments))
    out = Path(given.run)
    noted = folder.records(out)
    if not noted:
        raise UserError(f"{out}: no results here; allowed: the runner.out folder of a run")
    with locked(out, lambda line: print(f"aoabench: {line}", file=sys.stderr)):
        tables.collect(out)
    print(f"{len(noted)} cells: {out}/{{tidy,replications,summary,cells,timing}}.parquet")
    return 0
