"""`aoabench compare`."""

from __future__ import annotations

import sys
from pathlib import Path

import click
from click.shell_completion import CompletionItem

from aoabench.cli.common import (
    Command,
    echo,
    estimator_names,
    json_option,
    print_json,
    run_argument,
)


def _metrics(_ctx: click.Context, _param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    from aoabench.store.compare import METRICS

    return [CompletionItem(name) for name in METRICS if name.startswith(incomplete)]


@click.command(cls=Command)
@run_argument
@click.option(
    "--baseline",
    metavar="ESTIMATOR",
    shell_complete=estimator_names,
    help="The estimator to compare with; by default the one with the smallest mean in each cell.",
)
@click.option(
    "--metric",
    default="rmse_3d_m",
    show_default=True,
    shell_complete=_metrics,
    help="The mean of a numeric column of replications.parquet (rmse_xy_m, nees ...), or "
    "failure_rate, the share of replications in which a fix failed or diverged.",
)
@json_option
def compare(run: Path, baseline: str | None, metric: str, as_json: bool) -> None:
    """Compare the estimators of a run in pairs.

    A pair is one replication: all estimators get the same draws in it. The command prints a line
    for each difference, with its 95 % interval and p-value (Holm's method over all comparisons),
    and stores the table as compare.parquet in the folder of the run.

    \b
    Examples:
      aoabench compare results/raw/sigma --baseline ekf_vmf
      aoabench compare results/raw/sigma --metric rmse_z_m

    With --json: `run`, `metric`; `comparisons`, the number of p-values that Holm's method adjusts;
    `rows`, the rows of compare.parquet; `left_out`, an object {cell not compared: reason};
    `non_causal`, the estimators whose fixes use later measurements too.
    """
    from aoabench.report import tails
    from aoabench.report.comparison import lines
    from aoabench.store import compare as compare_module
    from aoabench.store import tables
    from aoabench.store.files import write_frame

    table = compare_module.compare(run, baseline, metric)
    if as_json:
        found = {name: table.attrs[name] for name in ("comparisons", "left_out", "non_causal")}
        print_json({"run": run, "metric": metric, **found, "rows": table.to_dict("records")})
    else:
        echo("\n".join(lines(table)))
        if table["heavy_tail"].any():
            echo("\n".join(tails.lines(tables.shown(run, "summary")["summary"])))
    try:
        write_frame(run / "compare.parquet", table)
    except OSError as error:  # another user's run, or an archive
        echo(f"({run}/compare.parquet cannot be written: {error.strerror})", file=sys.stderr)
