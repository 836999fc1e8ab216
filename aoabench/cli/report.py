"""`aoabench report`."""

from __future__ import annotations

import os
from pathlib import Path

import click

from aoabench.cli.common import Command, formats, json_option, print_json, results_options, say
from aoabench.cli.show import studies_json


@click.command(cls=Command)
@results_options
@json_option
def report(results: Path, format_: str | None, as_json: bool) -> None:
    """Draw figures and page again from stored tables.

    Nothing is simulated.

    \b
    Examples:
      aoabench report
      aoabench report --format pdf

    With --json: `results`, the folder; `verdicts`, a row for each claim; `readings`, one for each reading of
    a claim;
    `not_computed`, the items without a table, each with the reason; `page`, its path.
    """
    from aoabench.studies import reproduce as reproducing

    os.environ.setdefault("MPLBACKEND", "Agg")  # figures go to files
    drawn = reproducing.draw(reproducing.all_studies(), results, say, formats=formats(format_))
    if as_json:
        print_json(studies_json(drawn, results))
