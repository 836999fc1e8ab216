"""`aoabench replay`."""

from __future__ import annotations

import os
from pathlib import Path

import click

from aoabench.cli.common import Choice, Command, echo, estimator_names, run_argument
from aoabench.errors import UserError, shorten


@click.command(cls=Command)
@run_argument
@click.argument(
    "words", nargs=-1, metavar="[plugins=[...]]", help="Your own packages, as the run named them."
)
@click.option(
    "--replication", type=int, required=True, metavar="N", help="Number of the replication, >= 0."
)
@click.option(
    "--estimator", required=True, shell_complete=estimator_names, help="Name of the estimator."
)
@click.option("--cell", help="Name of the cell, needed if the run has several cells.")
@click.option("--plugins", default="", help="The same, separated by commas.")
@click.option(
    "--export",
    type=Choice(["csv", "parquet"]),
    help="Also write measurements and anchors, as files that scenario=recorded reads.",
)
def replay(
    run: Path,
    words: tuple[str, ...],
    replication: int,
    estimator: str,
    cell: str | None,
    plugins: str,
    export: str | None,
) -> None:
    """Repeat one replication of a run with its trace.

    The trace (truth, measurements, estimates, covariances) and its picture are written into the
    folder `replay` of the run.

    \b
    Example:
      aoabench replay results/raw/sigma --replication 7 --estimator ekf_vmf

    `aoabench run --worst N` prints the commands for the N worst replications.
    """
    from aoabench.config.overrides import read
    from aoabench.config.plugins import package_names, parse_plugins
    from aoabench.engine import replay_files
    from aoabench.engine.replay import replay as repeat

    os.environ.setdefault("MPLBACKEND", "Agg")  # figures go to files
    settings = read(words)
    for setting in settings:
        if setting.key != "plugins":
            allowed = "replay repeats the run as it was; allowed: plugins=[...]"
            raise UserError(f"{shorten(setting.word)}: {allowed}")
    given = [name.strip() for name in plugins.split(",") if name.strip()]
    packages = parse_plugins(settings) or package_names(given)
    done = repeat(run, replication, estimator, cell, packages)
    echo(replay_files.write(done, export))
