"""`aoabench report`."""

from __future__ import annotations

import os
from pathlib import Path

import click

from aoabench.cli.common import (
    Command,
    all_option,
    formats,
    json_option,
    print_json,
    results_options,
    say,
    scale_option,
)
from aoabench.cli.show import studies_json


@click.command(cls=Command)
@scale_option("paper", "Which tables: paper, the committed ones in results; quick, results/quick.")
@all_option
@results_options
@json_option
def report(
    scale: str, every: bool, results: Path | None, format_: str | None, as_json: bool
) -> None:
    """Draw figures and page again from stored tables.

    Nothing is simulated. Figures and page of the committed tables go to results/draft, which git
    ignores; with COMMIT=1 in the environment they replace the committed ones.

    \b
    Examples:
      aoabench report
      aoabench report --format pdf
      aoabench report --scale quick

    With --json: `results`, the folder; `verdicts`, a row for each claim; `readings`,
    one for each reading of a claim; `not_computed`, the items without a table, each with the
    reason; `page`, its path.
    """
    from aoabench.studies import places
    from aoabench.studies import reproduce as reproducing

    os.environ.setdefault("MPLBACKEND", "Agg")  # figures go to files
    where = places.of_report(scale, results)
    drawn = reproducing.draw(reproducing.all_studies(), where, say, formats(format_), every)
    if as_json:
        print_json(studies_json(drawn, where.results))
