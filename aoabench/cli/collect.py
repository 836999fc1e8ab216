"""`aoabench collect`."""

from __future__ import annotations

from pathlib import Path

import click

from aoabench.cli.common import Command, json_option, print_json, run_argument, say
from aoabench.engine.faults import report

_TABLES = ("tidy", "replications", "summary", "cells", "timing")


@click.command(cls=Command)
@run_argument
@json_option
def collect(run: Path, as_json: bool) -> None:
    """Make the tables of a run again from its parts.

    Every run makes its tables at its end; this command is needed only after tables were lost.

    \b
    Example:
      aoabench collect results/raw/sigma

    With --json: `run`, the folder; `cells`, the number of cells in the tables; `tables`, an object
    {name: path}.
    """
    from aoabench.report import tails
    from aoabench.store import folder, tables
    from aoabench.store.lock import locked

    cells = len(folder.record_files(run))
    if not cells:
        raise folder.no_results(run)
    with locked(run, report):
        tables.collect(run)
    if as_json:
        paths = {name: run / f"{name}.parquet" for name in _TABLES}
        print_json({"run": run, "cells": cells, "tables": paths})
        return
    say(f"{cells} cells: {run}/{{{','.join(_TABLES)}}}.parquet")
    for line in tails.lines(tables.shown(run, "summary")["summary"]):
        say(line)
