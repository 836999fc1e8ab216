"""`aoabench run`."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path

from aoabench.cell import Cell
from aoabench.cli.common import Parser
from aoabench.cli.show import print_run, print_worst
from aoabench.errors import check_number


def run(arguments: Sequence[str]) -> int:
    """`aoabench run`: every job is composed and validated first, then all are computed together."""
    from aoabench.config import compose
    from aoabench.engine import runner

    parser = Parser(prog="aoabench run", add_help=False, allow_abbrev=False)
    parser.add_argument("-m", "--multirun", action="store_true")
    parser.add_argument("-c", "--cfg", choices=["job"])
    parser.add_argument("-p", "--package", default="")
    parser.add_argument("--resolve", action="store_true")
    parser.add_argument("-h", "--help", action="store_true")
    parser.add_argument("-cd", "--config-dir")
    parser.add_argument("--worst", type=int, default=0, metavar="N")
    overrides = [a for a in arguments if a.startswith("~") or ("=" in a and not a.startswith("-"))]
    given = parser.parse_args([a for a in arguments if a not in overrides])
    check_number("--worst", given.worst, least=0, integer=True)
    if given.help:
        print(_run_help(given.config_dir))
        return 0
    if given.cfg:
        print(
            compose.show(overrides, given.config_dir, given.resolve, given.package, given.multirun),
            end="",
        )
        return 0
    cells = compose.compose_cells(overrides, config_dir=given.config_dir, sweep=given.multirun)
    for line in dict.fromkeys(line for cell in cells for line in cell.notes):
        print(line, file=sys.stderr)
    done = runner.run(cells)
    print_run(done, cells)
    for cell in {cell.id: cell for cell in cells if cell.scenario.recorded is not None}.values():
        _draw_recording(done.out, cell)
    if given.worst:
        print_worst(done.out, cells, given.worst)
    return 0


def _draw_recording(out: Path, cell: Cell) -> None:
    """Errors of a recording with ground truth as pictures."""
    os.environ.setdefault("MPLBACKEND", "Agg")  # figures go to files
    import numpy as np

    from aoabench.report import campaign

    scenario = cell.scenario
    truth, anchors = (
        scenario.truth(np.random.default_rng(0))[:, :2],
        scenario.true_anchors.frames[0][0, :, :2],
    )
    for path in campaign.write(
        out, cell.id, list(cell.estimators), truth, anchors, scenario.bounds_m
    ):
        print(f"figure: {path}")


_RUN_HELP = """\
aoabench run: simulate one cell, or with -m a sweep over cells,
and keep every replication in Parquet.

== Options: GROUP=NAME; several filters or estimators: 'filter=[NAME,NAME]' ==

{options}

== Config: override anything as KEY=VALUE ==

{config}
== Flags ==

-m, --multirun      sweep: KEY=VALUE,VALUE makes a cell of each combination
                    (Hydra's syntax, range() and glob() too)
-c job, --cfg job   show the composed config;
                    with --resolve its interpolations too, with -p KEY a part of it
--worst N           name the N worst replications of the run, each with the command that replays it
--config-dir DIR    a folder with configs of your own (DIR/filter/mine.yaml ...),
                    appended to the shipped ones

== Examples ==

aoabench run noise=vmf 'filter=[ekf_vmf,ukf_vmf]' reps=200
aoabench run -m noise.sigma_deg=2,5,10 'filter=[ekf_vmf,ekf_ae_nominal]' \\
    runner.out=results/raw/sigma
aoabench run -m experiment=nurminen2018_frames reps=500

`aoabench list` says what each option is."""


def _run_help(config_dir: str | None) -> str:
    from aoabench.config import compose
    from aoabench.config.presets import GROUPS, options

    listed = "\n".join(
        f"{group}: {', '.join(options(group, config_dir)) or '(none yet)'}" for group in GROUPS
    )
    return _RUN_HELP.format(options=listed, config=compose.show([], config_dir))
