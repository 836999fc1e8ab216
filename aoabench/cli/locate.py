"""`aoabench locate`."""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from aoabench.cli.common import Command, echo, say
from aoabench.cli.complete import override_items
from aoabench.cli.stopping import held
from aoabench.errors import UserError, check_number

if TYPE_CHECKING:
    from aoabench.deployment.located import Located
    from aoabench.deployment.request import Request
    from aoabench.maths.geometry import Array

_SHOWN = 10  # rows on the screen


@click.command(cls=Command)
@click.argument(
    "log", metavar="LOG", help="A log of measured angles, a quoted pattern of several, or -."
)
@click.argument(
    "words",
    metavar="[scenario.KEY=VALUE]...",
    nargs=-1,
    type=click.UNPROCESSED,
    shell_complete=override_items,
    help="How to read the log, as in `aoabench list recorded`; parameters of the method too.",
)
@click.option(
    "--anchors",
    help="The file of the anchors: id, x_m, y_m, z_m, facing_deg ...  Not needed for a log with "
    "the positions of its receivers (anchor_x_m ...).",
)
@click.option("--format", "form", help="The format of the log, such as ublox or silabs.")
@click.option("--estimator", help="The estimator.  [default: robust_ml]")
@click.option("--filter", "filter_", help="A filter or smoother, in place of an estimator.")
@click.option("--plan", type=click.Path(), help="Walls for the map: GeoJSON, CSV or DXF.")
@click.option("--truth", type=click.Path(), help="A file of true positions.")
@click.option(
    "--max-sigma",
    type=float,
    metavar="M",
    help="Reject fixes whose stated standard deviation in the plane exceeds M metres.",
)
@click.option(
    "-o",
    "--out",
    type=click.Path(path_type=Path),
    help="The table of fixes: .csv, .parquet or .geojson.  [default: LOG-fixes.csv in this folder]",
)
def locate(
    log: str,
    words: tuple[str, ...],
    anchors: str | None,
    form: str | None,
    estimator: str | None,
    filter_: str | None,
    plan: str | None,
    truth: str | None,
    max_sigma: float | None,
    out: Path | None,
) -> int:
    """Locate the tags of a device's log.

    Writes a table with time, tag, position, standard deviations, outcome and reason of each fix,
    and a map; with known truth, a figure of the errors too. The log - is standard input: rows of
    CSV are written as fixes are complete, to standard output or to a file.

    \b
    Examples:
      aoabench locate capture.log --anchors anchors.csv --format ublox
      aoabench locate log.csv --anchors anchors.csv --plan walls.geojson scenario.window_s=0.1
      aoabench locate log.csv --anchors anchors.csv --filter ekf_vmf -o track.geojson
      socat -u /dev/ttyUSB0,b115200,raw - | aoabench locate - --anchors anchors.csv --format ublox
    """
    from aoabench.deployment.request import Request

    check_number("--max-sigma", max_sigma, above=0, optional=True)
    request = Request(log, anchors, form, estimator, filter_, truth, words)
    if log == "-":
        return _from_stream(request, plan, max_sigma, out)
    return _from_files(request, plan, max_sigma, out or Path(f"{_stem(log)}fixes.csv"))


def _stem(log: str) -> str:
    """The beginning of the default name of the table."""
    name = Path(log).name
    return "" if re.search(r"[*?\[\]{},]", name) else f"{Path(name).stem}-"


def _from_files(request: Request, plan: str | None, max_sigma: float | None, out: Path) -> int:
    """Locate the tags of files; write table and figures, print what they say."""
    from aoabench.deployment import files, located, plans
    from aoabench.engine.faults import report

    files.check_out(out, [request.log, request.anchors, request.truth, plan])
    asked = request.asked(report)
    drawn = None if plan is None else plans.plan(plan, asked, request.frame)
    found = located.locate(asked, max_sigma, report)
    for line in (*asked.cell.notes, *(drawn.notes if drawn else ())):
        echo(line, file=sys.stderr)
    files.write(found.frame, out, asked.cell.config, asked.scenario.anchors_file.origin)
    for line in found.errors:
        report(line)
    _print(found)
    say(f"fixes: {out}")
    for kind, path in _figures(found, out, drawn.walls if drawn else None):
        say(f"{kind}: {path}")
    return 0


def _from_stream(
    request: Request, plan: str | None, max_sigma: float | None, out: Path | None
) -> int:
    """Write the fixes of standard input as they are complete; return the exit status."""
    from aoabench.deployment.files import check_stream_out, opened
    from aoabench.deployment.streaming import Run
    from aoabench.engine.faults import report

    for flag, given in (("--plan", plan), ("--truth", request.truth)):
        if given is not None:
            raise UserError(f"{flag}={given} is not allowed with LOG=-; allowed: a log in a file")
    check_stream_out(out, [request.anchors])
    run = Run(request, max_sigma, report)
    with opened(out) as write, held() as stop:
        try:
            for columns in run.tables(sys.stdin.fileno(), stop.wake):
                write(columns)
        except UserError:
            if stop.number is None:
                raise  # else the log was stopped before it could be read
    for line in run.lines():
        echo(line, file=sys.stderr)
    return 0 if stop.number is None else 128 + stop.number


def _print(found: Located) -> None:
    """Print the first rows and what the table says."""
    from aoabench.deployment import summary

    asked, frame = found.asked, found.frame
    for line in (*summary.head(frame, _SHOWN), *summary.lines(frame, asked.name)):
        say(line)
    sense = asked.scenario.azimuth_sense
    for line in summary.residual_lines(found.residuals, asked.scenario.anchors_file.ids, sense):
        say(line)
    by_mark = asked.scenario.weight == "mark"
    if found.with_truth:
        for line in summary.accuracy_lines(summary.accuracy(frame, by_mark), by_mark):
            say(line)


def _figures(found: Located, out: Path, walls: Array | None) -> list[tuple[str, Path]]:
    os.environ.setdefault("MPLBACKEND", "Agg")  # figures go to files
    from aoabench.deployment import figures

    return figures.write(found, out, walls)
