"""`aoabench run`."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from aoabench.cli.common import Choice, Command, echo, json_option, print_json, say
from aoabench.cli.complete import override_items
from aoabench.errors import UserError, check_number, did_you_mean

if TYPE_CHECKING:
    from aoabench.cell import Cell


class _Run(Command):
    """`run`, whose help ends with the presets and the default config."""

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        from aoabench.config import compose
        from aoabench.config.presets import GROUPS, options

        folder = ctx.params.get("config_dir")
        config = compose.show([], folder)
        with formatter.section("Presets, GROUP=NAME"):
            for group in GROUPS:
                formatter.write_text(f"{group}: {', '.join(options(group, folder))}")
        with formatter.section("Config, KEY=VALUE"):
            for line in config.splitlines():
                formatter.write(f"  {line}\n")


@click.command("run", cls=_Run, add_help_option=False)
@click.argument(
    "words",
    metavar="[OVERRIDES]...",
    nargs=-1,
    type=click.UNPROCESSED,
    shell_complete=override_items,
    help="GROUP=NAME chooses a preset, GROUP=[NAME,NAME] several filters or estimators, "
    "GROUP=all those that fit, KEY=VALUE sets a key, ~KEY deletes it.",
)
@click.option(
    "-m",
    "--multirun",
    is_flag=True,
    help="Sweep: KEY=VALUE,VALUE makes a cell of each combination; range() and glob() too.",
)
@click.option("-c", "--cfg", type=Choice(["job"]), help="Print the composed config; run nothing.")
@click.option("-p", "--package", default="", metavar="KEY", help="With --cfg: print this key only.")
@click.option("--resolve", is_flag=True, help="With --cfg: resolve the interpolations.")
@click.option(
    "--config-dir",
    "-cd",
    type=click.Path(),
    help="A folder with configs of your own (DIR/filter/mine.yaml), added to the shipped ones.",
)
@click.option(
    "--worst",
    type=int,
    default=0,
    metavar="N",
    help="Name the N worst replications, each with the command that replays it.",
)
@click.option(
    "--fresh",
    is_flag=True,
    help="Compute everything again and replace the stored replications of these cells.",
)
@json_option
@click.option("-h", "--help", "wants_help", is_flag=True, help="Show this message and exit.")
@click.pass_context
def run(
    ctx: click.Context,
    words: tuple[str, ...],
    multirun: bool,
    cfg: str | None,
    package: str,
    resolve: bool,
    config_dir: str | None,
    worst: int,
    fresh: bool,
    as_json: bool,
    wants_help: bool,
) -> None:
    """Simulate one cell, or with -m a sweep over cells.

    All jobs are composed and validated first, then computed together. Every replication is stored
    in the folder runner.out; replications that an earlier run stored in the folder are reused. File
    names need only the quotes that the shell needs: 'scenario.path=my log (1).csv'.

    \b
    Examples:
      aoabench run noise=vmf 'filter=[ekf_vmf,ukf_vmf]' reps=200
      aoabench run -m noise.sigma_deg=2,5,10 'filter=[ekf_vmf,ekf_ae_nominal]' \\
          runner.out=results/raw/sigma
      aoabench run -m experiment=nurminen2018_frames reps=500

    With --json: `out`, the folder; `seconds`, `computed`, `reused`; `cells`, each with its `config`
    and in `left_out` the presets that `all` does not choose, with the reason; `summary`, the rows
    of summary.parquet; `tags`, of recordings, the fixes of each tag and estimator; `heavy_tails`,
    the estimators whose RMSE a few large errors decide; `not_ok`, the estimators with fixes that
    are not ok, each with shares and the commonest reason; `errors`, `precision`, `damaged`;
    `notes`, remarks about the input; `figures` of a recording; `worst`, with --worst.
    """
    if wants_help:
        click.echo(ctx.get_help())
        return
    check_number("--worst", worst, least=0, integer=True)
    _refuse_flags(words, ctx.command)
    if cfg:
        from aoabench.config import compose

        echo(compose.show(words, config_dir, resolve, package, multirun).removesuffix("\n"))
        return
    cells = _composed(words, multirun, config_dir)
    _simulate(cells, fresh, worst, as_json)


def _refuse_flags(words: Sequence[str], command: click.Command) -> None:
    """Raise UserError for a word that is a flag without its dashes."""
    flags = {
        flag.lstrip("-"): flag
        for parameter in command.params
        for flag in parameter.opts
        if flag.startswith("--")
    }
    for word in words:
        if word in flags:
            raise UserError(
                f"{word!r} is not an override{did_you_mean(flags[word], [flags[word]])}"
            )


def _composed(words: Sequence[str], sweep: bool, config_dir: str | None) -> list[Cell]:
    """The cells of the overrides; print their notes."""
    from aoabench.config import compose
    from aoabench.config.fit import left_out_text
    from aoabench.engine.faults import report

    cells = compose.compose_cells(words, config_dir=config_dir, sweep=sweep, say=report)
    notes = dict.fromkeys(line for cell in cells for line in cell.notes)
    for line in (*notes, *left_out_text(cells)):
        echo(line, file=sys.stderr)
    return cells


def _simulate(cells: list[Cell], fresh: bool, n_worst: int, as_json: bool) -> None:
    """Run the cells, and print the results."""
    from aoabench.cli import show
    from aoabench.engine import runner

    found = show.finished(runner.run(cells, fresh=fresh), cells)
    figures = list(_figures(found.report.out, found.cells.values()))
    worst = show.worst(found, n_worst) if n_worst else []
    if as_json:
        notes = list(dict.fromkeys(line for cell in cells for line in cell.notes))
        rest = {"notes": notes, "figures": figures, "worst": worst}
        print_json({**show.run_json(found), **rest})
        return
    for line in show.run_text(found):
        say(line)
    for path in figures:
        say(f"figure: {path}")
    if n_worst:
        echo("\n".join(show.worst_text(worst)))


def _figures(out: Path, cells: Iterable[Cell]) -> Iterator[Path]:
    """Draw the errors or positions of recordings; yield the paths of the figures."""
    os.environ.setdefault("MPLBACKEND", "Agg")  # figures go to files
    for cell in cells:
        scenario, tracks = cell.scenario, cell.scenario.tracks
        if tracks is not None:
            import numpy as np

            from aoabench.report import recording
            from aoabench.report.text import shown_name

            anchors = scenario.true_anchors.position[0].reshape(-1, 3)[:, :2]
            around = np.unique(anchors, axis=0), scenario.bounds_m
            names = {n: shown_name(n, e.causal) for n, e in cell.estimators.items()}
            yield from recording.write(out, cell.id, names, tracks, *around)
