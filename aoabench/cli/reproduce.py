"""`aoabench reproduce`."""

from __future__ import annotations

import os
from pathlib import Path

import click
from click.shell_completion import CompletionItem

from aoabench.cli.common import (
    Choice,
    Command,
    formats,
    json_option,
    print_json,
    results_options,
    say,
)
from aoabench.cli.show import studies_json


def _studies(ctx: click.Context, _param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    from aoabench.studies import study

    given = ctx.params.get("study") or ()
    names = [name for name in study.names() if name not in given]
    return [CompletionItem(name) for name in names if name.startswith(incomplete)]


def _items(ctx: click.Context, _param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    from aoabench.studies import study

    given = (*(ctx.params.get("study") or ()), *ctx.args)  # in args, while a flag has no value
    chosen = [name for name in given if name in study.names()]
    names = {item.name for name in chosen or study.names() for item in study.load(name).items}
    return [CompletionItem(name) for name in sorted(names) if name.startswith(incomplete)]


@click.command(cls=Command)
@click.argument("study", nargs=-1, shell_complete=_studies, help="Names of studies; default: all.")
@click.option(
    "--scale",
    type=Choice(["quick", "medium", "paper"]),
    default="quick",
    show_default=True,
    help="quick: minutes; medium: about 20 minutes; paper: the paper's number of replications.",
)
@click.option(
    "--only", metavar="ITEM", shell_complete=_items, help="Only this table or figure, e.g. table1."
)
@click.option("--fresh", is_flag=True, help="Compute everything again; reuse nothing stored.")
@results_options
@json_option
def reproduce(
    study: tuple[str, ...],
    scale: str,
    only: str | None,
    fresh: bool,
    results: Path,
    format_: str | None,
    as_json: bool,
) -> None:
    """Compute the tables and figures of the studies.

    Each printed number or claim is compared with our number and gets a verdict.

    \b
    Examples:
      aoabench reproduce
      aoabench reproduce nurminen2018 --scale paper
      aoabench reproduce le2021 --only fig5

    With --json: `scale`; `results`, the folder; `items`, the computed items with study, item, rows,
    seconds; `verdicts`, a row for each claim; `readings`, one for each reading of
    a claim; `not_computed`, the items without a
    table, each with the reason; `page`, its path.
    """
    from aoabench.studies import reproduce as reproducing

    os.environ.setdefault("MPLBACKEND", "Agg")  # figures go to files
    done = reproducing.reproduce(study, scale, only, results, say, formats(format_), fresh)
    if as_json:
        items = {"scale": scale, "items": done.computed}
        print_json({**items, **studies_json(done.drawn, results)})
