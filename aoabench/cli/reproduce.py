"""`aoabench reproduce`."""

from __future__ import annotations

import os
from pathlib import Path

import click
from click.core import ParameterSource
from click.shell_completion import CompletionItem

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
from aoabench.errors import UserError


def _studies(ctx: click.Context, _param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    from aoabench.studies import study

    given = ctx.params.get("study") or ()
    names = [name for name in study.names() if name not in given]
    return [CompletionItem(name) for name in names if name.startswith(incomplete)]


def _items(ctx: click.Context, _param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Completions of the last word of a list: ITEM, or STUDY/ITEM after a slash."""
    from aoabench.studies import study

    given = (*(ctx.params.get("study") or ()), *ctx.args)  # in args, while a flag has no value
    chosen = [name for name in given if name in study.names()] or study.names()
    before, comma, word = incomplete.rpartition(",")
    pairs = [(name, item.name) for name in chosen for item in study.load(name).items]
    names = {f"{study}/{item}" if "/" in word else item for study, item in pairs}
    return [CompletionItem(before + comma + n) for n in sorted(names) if n.startswith(word)]


@click.command(cls=Command)
@click.argument("study", nargs=-1, shell_complete=_studies, help="Names of studies; default: all.")
@scale_option(
    "quick", "quick: minutes, coarse; paper: an hour or two, the papers' numbers of replications."
)
@click.option(
    "--only",
    metavar="ITEM,...",
    shell_complete=_items,
    help="Only these tables or figures, e.g. table1 or nurminen2018/fig4,fig5.",
)
@click.option(
    "--decide",
    is_flag=True,
    help="Add replications to the stored tables of paper scale until their claims are decided.",
)
@click.option(
    "--budget",
    type=click.FloatRange(min=0, min_open=True),
    metavar="MIN",
    help="The minutes that --decide may take; default: 10.",
)
@click.option("--fresh", is_flag=True, help="Compute everything again; reuse nothing stored.")
@all_option
@results_options
@json_option
def reproduce(
    study: tuple[str, ...],
    scale: str,
    only: str | None,
    decide: bool,
    budget: float | None,
    fresh: bool,
    every: bool,
    results: Path | None,
    format_: str | None,
    as_json: bool,
) -> None:
    """Compute the tables and figures of the studies.

    What the papers print is compared with our numbers and gets a verdict. Cheap items come first,
    and each figure is drawn as soon as its table is computed. Quick scale writes results/quick,
    which git ignores, paper scale results; both keep replications in results/raw, so that paper
    scale continues from what quick scale computed.

    \b
    Examples:
      aoabench reproduce
      aoabench reproduce nurminen2018 --scale paper
      aoabench reproduce --only nurminen2018/fig4,le2021/table1
      aoabench reproduce nurminen2018 --decide --budget 30

    With --json: `scale`; `results`, the folder; `items`, the computed items with study, item, rows,
    seconds; `verdicts`, a row for each claim; `readings`, one for each reading of
    a claim; `not_computed`, the items without a
    table, each with the reason; `page`, its path.
    """
    from aoabench.studies import places
    from aoabench.studies import reproduce as reproducing

    os.environ.setdefault("MPLBACKEND", "Agg")  # figures go to files
    if decide:
        source = click.get_current_context().get_parameter_source("scale")
        if scale == "quick" and source is not ParameterSource.DEFAULT:
            raise UserError("--scale=quick: --decide adds to tables of paper scale; leave it out")
        if fresh:
            raise UserError("--fresh: --decide adds to what is stored; leave it out")
        scale = "paper"
    elif budget is not None:
        raise UserError(f"--budget={budget:g}: only with --decide")
    where = places.of_scale(scale, results)
    minutes = 10.0 if budget is None else budget
    if decide:
        options = (formats(format_), 60 * minutes, every)
        done = reproducing.decide(study, only, where, say, *options)
    else:
        done = reproducing.reproduce(study, scale, only, where, say, formats(format_), fresh, every)
    if as_json:
        items = {"scale": scale, "items": done.computed}
        print_json({**items, **studies_json(done.drawn, where.results)})
