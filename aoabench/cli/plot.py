"""`aoabench plot`."""

from __future__ import annotations

import os
import shlex
import sys
from pathlib import Path

import click
from click.shell_completion import CompletionItem

from aoabench.cli.common import Choice, Command, echo, estimator_names, run_argument, say
from aoabench.errors import RunError, UserError
from aoabench.report.runs.kinds import KINDS


def _metrics(_ctx: click.Context, _param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    from aoabench.report.runs.metrics import NAMES

    return [CompletionItem(name) for name in NAMES if name.startswith(incomplete)]


def _columns(ctx: click.Context, _param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Completions: the columns that differ between the cells and estimators of the run."""
    from aoabench.report.runs.source import TAG, read, varied

    try:
        run = read(ctx.params["run"])
        found = [*varied(run), *([TAG] if len(run.tags) > 1 else [])]
    except (UserError, RunError, OSError, KeyError, TypeError):
        found = []
    return [CompletionItem(name) for name in found if name.startswith(incomplete)]


@click.command(cls=Command)
@run_argument
@click.option(
    "--kind",
    type=Choice(KINDS),
    help="The kind of figure.  [default: a curve if one parameter with numbers was swept, a "
    "heatmap if several were, else a cdf]",
)
@click.option(
    "--metric",
    shell_complete=_metrics,
    help="What is drawn: a numeric column of replications.parquet or failure_rate, as in "
    "`compare`; for a curve or heatmap also a column of summary.parquet with an interval (cep50_m "
    "...); for cdf, box, violin and time the error of each fix: error_3d_m, error_xy_m, error_z_m. "
    "[default: the 3-D error of each fix if it is stored, else rmse_3d_m]",
)
@click.option(
    "--by",
    metavar="COLUMN",
    shell_complete=_columns,
    help="The column with a colour for each value, of a recording also its tag.  [default: "
    "estimator]",
)
@click.option(
    "--over",
    metavar="KEY[,KEY]",
    shell_complete=_columns,
    help="The swept parameters on the axes: one of a curve, two of a heatmap. Other swept "
    "parameters have a panel for each value.",
)
@click.option(
    "--where",
    metavar="KEY=VALUE[,VALUE]",
    multiple=True,
    help="Draw these results alone; may be repeated.",
)
@click.option(
    "--baseline",
    metavar="ESTIMATOR",
    shell_complete=estimator_names,
    help="The estimator with which pairs are compared.  [default: that with the smallest mean]",
)
@click.option(
    "-o",
    "--out",
    type=click.Path(path_type=Path),
    help="The file: .png, .pdf, .svg, or .html for a page with the figure, its table and the "
    "command.  [default: plots/KIND.png in the folder of the run]",
)
def plot(
    run: Path,
    kind: str | None,
    metric: str | None,
    by: str | None,
    over: str | None,
    where: tuple[str, ...],
    baseline: str | None,
    out: Path | None,
) -> None:
    """Draw the results of a run.

    cdf, box and violin show how errors are distributed, curve and heatmap a mean over swept
    parameters, with intervals, time the error over the steps (a run with store.steps=true), pairs
    each replication of two estimators. The foot of the figure says how many replications it shows,
    at which scale of a study, whether they are synthetic or recorded, and what bars and bands are.

    \b
    Examples:
      aoabench plot results/raw/sigma
      aoabench plot results/raw/sigma --kind cdf --metric error_xy_m --where noise.sigma_deg=5
      aoabench plot results/raw/sigma --kind pairs --baseline ekf_vmf -o pairs.pdf
      aoabench plot results/raw/sigma --metric cep90_m --by noise -o curve.html
      aoabench plot results/raw/walk --by tag            (a recording)
    """
    os.environ.setdefault("MPLBACKEND", "Agg")  # figures go to files
    from aoabench.report.runs import drawing, writing
    from aoabench.report.runs.choice import Asked
    from aoabench.studies.scale import scale_of

    if out is not None:
        writing.check_out(out)
    keys = tuple(over.split(",")) if over else ()
    made = drawing.prepare(run, Asked(kind, metric, by, keys, baseline), where, scale_of)
    if kind is None:
        others = ", ".join(made.choice.others)
        chosen = f"kind={made.choice.kind} is drawn; this run can show {others} too"
        echo(f"aoabench: {chosen}", file=sys.stderr)
    if made.choice.left_out:
        echo(f"aoabench: {made.choice.left_out}", file=sys.stderr)
    path = out or run / "plots" / f"{made.choice.kind}.png"
    given = {"metric": metric, "by": by, "over": over, "baseline": baseline}
    words = ["aoabench", "plot", str(run), "--kind", made.choice.kind]
    words += [word for key, value in given.items() if value for word in (f"--{key}", value)]
    words += [word for condition in where for word in ("--where", condition)]
    try:
        writing.write(made, path, shlex.join([*words, "-o", str(path)]))
    except PermissionError as error:  # another user's run, or an archive
        if out is not None:
            raise
        again = "name another file with -o"
        raise RunError(f"{path} cannot be written: {error.strerror}; {again}") from None
    say(f"{made.choice.kind}: {path}")
