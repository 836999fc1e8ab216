"""The command line: the only module that knows the terminal.

Exit status: 0 done, 2 the user's mistake (one line), 1 anything else, 130 interrupted.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NoReturn

from aoabench.types import RunError, UserError, check_number


def main(argv: Sequence[str] | None = None) -> NoReturn:
    """Entry point of `aoabench`."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    try:
        sys.exit(dispatch(arguments))
    except UserError as error:
        print(f"aoabench: {' '.join(str(error).split())}", file=sys.stderr)
        sys.exit(2)
    except RunError as error:
        print(f"aoabench: {' '.join(str(error).split())}", file=sys.stderr)
        sys.exit(1)
    except KeyboardInterrupt:
        print(
            "aoabench: interrupted; what was finished is kept, the same command goes on from there",
            file=sys.stderr,
        )
        sys.exit(130)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)


class _Parser(argparse.ArgumentParser):
    """An argument parser whose complaint is one line."""

    def error(self, message: str) -> NoReturn:
        raise UserError(
            f"{self.prog.partition(' ')[2] or 'command'}: {message}; see `{self.prog} --help`"
        )


def dispatch(arguments: Sequence[str]) -> int:
    """Run one subcommand; returns the exit status."""
    commands: dict[str, Callable[[Sequence[str]], int]] = {
        "run": run,
        "reproduce": reproduce,
        "report": report,
        "compare": compare,
        "collect": collect,
        "replay": replay,
        "list": list_presets,
    }
    if not arguments or arguments[0] in ("-h", "--help", "help"):
        print(_HELP)
        return 0
    if arguments[0] == "--version":
        from aoabench import __version__

        print(f"aoabench {__version__}")
        return 0
    if arguments[0] not in commands:
        from aoabench.config import did_you_mean

        hint = did_you_mean(arguments[0], commands) or f"; allowed: {', '.join(commands)}"
        raise UserError(f"unknown command {arguments[0]!r}{hint}")
    return commands[arguments[0]](arguments[1:])


_HELP = """\
aoabench: Monte Carlo benchmark of angle-of-arrival (AoA) positioning

  aoabench list
      the presets: scenarios, noises, filters, estimators, experiments
  aoabench run [OVERRIDES]
      simulate one cell: aoabench run noise=vmf 'filter=[ekf_vmf,ukf_vmf]' reps=200
  aoabench run -m [OVERRIDES]
      sweep, e.g. ... -m noise.sigma_deg=2,5,10 (Hydra multirun; run --help says more)
  aoabench compare RUN [--baseline NAME] [--metric NAME]
      paired comparison of the estimators of a run
  aoabench collect RUN
      make the tables of a run again from its parts (every run ends so)
  aoabench replay RUN --replication N --estimator NAME
      repeat one replication with its trace
  aoabench reproduce [STUDY ...] [--scale quick|paper] [--only ITEM]
      tables and figures of the studies
  aoabench report [--format pdf|svg]
      draw figures and page again from the stored tables

RUN is the folder of a run (runner.out).
Exit status: 0 done, 2 a mistake in the input, 1 anything else."""


# --- run ------------------------------------------------------------------------------------------


def run(arguments: Sequence[str]) -> int:
    """`aoabench run`: every job is composed and validated first, then all are computed together."""
    from aoabench import composing, runner

    parser = _Parser(prog="aoabench run", add_help=False, allow_abbrev=False)
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
            composing.show(
                overrides, given.config_dir, given.resolve, given.package, given.multirun
            ),
            end="",
        )
        return 0
    cells = composing.compose_cells(overrides, config_dir=given.config_dir, sweep=given.multirun)
    for line in dict.fromkeys(line for cell in cells for line in cell.notes):
        print(line, file=sys.stderr)
    done = runner.run(cells)
    _print_run(done, cells)
    for cell in {
        cell.id: cell for cell in cells if getattr(cell.scenario, "recorded", None) is not None
    }.values():
        _draw_recording(done.out, cell)
    if given.worst:
        _print_worst(done.out, cells, given.worst)
    return 0


def _draw_recording(out: Path, cell: Any) -> None:
    """Errors of a recording with ground truth as pictures."""
    os.environ.setdefault("MPLBACKEND", "Agg")  # figures go to files
    from aoabench.report import campaign

    scenario = cell.scenario
    truth, anchors = scenario.truth(None)[:, :2], scenario.known_anchors.position[0, :, :2]
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
    from aoabench import composing
    from aoabench.config import GROUPS, options

    listed = "\n".join(
        f"{group}: {', '.join(options(group, config_dir)) or '(none yet)'}" for group in GROUPS
    )
    return _RUN_HELP.format(options=listed, config=composing.show([], config_dir))


def _print_run(done: Any, cells: Sequence[Any]) -> None:
    import pandas as pd

    out = done.out
    rate = f", {done.computed / done.seconds:,.0f}/s" if done.computed else ""
    print(
        f"{len({c.id for c in cells})} cells: {done.computed} replications x estimators computed, "
        f"{done.reused} reused, {done.seconds:.1f} s{rate}"
    )
    summary = pd.read_parquet(out / "summary.parquet")
    asked = {(c.id, name) for c in cells for name in c.estimators}
    mine = summary[[pair in asked for pair in zip(summary["cell"], summary["estimator"])]]
    table = pd.read_parquet(out / "cells.parquet")
    extra = [
        c
        for c in table.columns
        if c not in ("experiment", "scenario", "noise", "seed", "estimators", "config")
    ]
    mine = mine.merge(table[extra], on="cell")
    swept = [c for c in extra if c != "cell" and mine[c].nunique(dropna=False) > 1]
    shown = mine[["scenario", "noise", *swept, "estimator", "replications"]].copy()
    for name, title in (("rmse_pooled_3d_m", "RMSE 3-D [m]"), ("rmse_pooled_xy_m", "RMSE xy [m]")):
        shown[title] = [f"{v:.4g} ± {s:.1g}" for v, s in zip(mine[name], mine[f"{name}_se"])]
    shown["failed"] = [f"{v:.1%}" for v in mine["failure_rate"]]
    shown["fixes ok"] = [f"{v:.2%}" for v in mine["share_ok"]]
    print(shown.to_string(index=False, max_rows=60))
    failures = pd.read_parquet(out / "failures.parquet")
    told = failures.loc[
        [pair in asked for pair in zip(failures["cell"], failures["estimator"])], "error"
    ].dropna()
    if len(told):
        print(
            f"exceptions and NaN in {len(told)} replications, e.g. {told.iloc[0]}; "
            f"see {out}/failures.parquet"
        )
    if done.precision:
        _print_precision(done.precision)
    print(
        f"tables: {out}/{{tidy,replications,cells,summary,timing}}.parquet    "
        f"in Python: aoabench.load({str(out)!r})"
    )


def _print_precision(rows: Sequence[Any]) -> None:
    """What was asked for with until.*, and what was reached."""
    first, short = rows[0], [row for row in rows if not row["reached"]]
    wanted = [f"{first['wanted_se']:g}"] if first["wanted_se"] else []
    wanted += (
        [f"{first['wanted_relative_se']:.3g} of the mean"] if first["wanted_relative_se"] else []
    )
    print(
        f"{first['metric']} until its standard error is at most {' and '.join(wanted)}: reached by "
        f"{len(rows) - len(short)} of {len(rows)} (precision.parquet)"
    )
    for row in short[:20]:
        print(
            f"  not reached: cell {row['cell']} {row['estimator']}: {row['mean']:.4g} "
            f"± {row['se']:.2g} after {row['replications']} replications"
        )


def _print_worst(out: Path, cells: Sequence[Any], n: int) -> None:
    """The worst replications: those without a position first, then by their RMSE; how many medians
    that is.
    """
    from aoabench import tables

    frame = tables.load(out)
    asked = {(c.id, name) for c in cells for name in c.estimators}
    frame = frame[[pair in asked for pair in zip(frame["cell"], frame["estimator"])]]
    median = frame.groupby(["cell", "estimator"])["rmse_3d_m"].transform("median")
    frame = frame.assign(times=frame["rmse_3d_m"] / median)
    worst = frame.sort_values(
        "rmse_3d_m", ascending=False, na_position="first", kind="stable"
    ).head(n)
    by_id = {c.id: c for c in cells}
    print(f"the {len(worst)} worst replications, by RMSE 3-D:")
    for row in worst.to_dict("records"):
        cell = by_id[row["cell"]]
        error = (
            "no position" if row["rmse_3d_m"] != row["rmse_3d_m"] else f"{row['rmse_3d_m']:.4g} m"
        )
        times = (
            f", {row['times']:.3g} times its estimator's median"
            if row["times"] == row["times"]
            else ""
        )
        print(
            f"  {row['noise']} {row['estimator']} replication {row['replication']}: "
            f"{error}{times}, {row['outcome']}"
        )
        again = tables.replay_command(
            out, row["cell"], row["estimator"], row["replication"], cell.config, cell.plugins
        )
        print(f"    {again}")


# --- studies --------------------------------------------------------------------------------------


def reproduce(arguments: Sequence[str]) -> int:
    """`aoabench reproduce`: compute the studies' items, then draw figures, tables and page."""
    from aoabench import reproducing

    os.environ.setdefault("MPLBACKEND", "Agg")  # figures go to files

    parser = _Parser(
        prog="aoabench reproduce", description="Regenerate the tables and figures of the studies."
    )
    parser.add_argument("study", nargs="*", help="all if none is named")
    parser.add_argument(
        "--scale",
        default="quick",
        choices=["quick", "medium", "paper"],
        help="quick: minutes; medium: some 20; paper: the paper's counts",
    )
    parser.add_argument("--only", metavar="ITEM", help="one table or figure, e.g. table1")
    _results_options(parser)
    given = parser.parse_args(list(arguments))
    reproducing.reproduce(
        given.study, given.scale, given.only, Path(given.results), print, _formats(given)
    )
    return 0


def report(arguments: Sequence[str]) -> int:
    """`aoabench report`: figures and page from the stored tables; nothing is simulated."""
    from aoabench import reproducing

    os.environ.setdefault("MPLBACKEND", "Agg")  # figures go to files

    parser = _Parser(
        prog="aoabench report", description="Draw figures and page again from the stored tables."
    )
    _results_options(parser)
    given = parser.parse_args(list(arguments))
    reproducing.draw(reproducing.all_studies(), Path(given.results), print, formats=_formats(given))
    return 0


def _results_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--results", default="results", help="folder of tables, figures and page (default: results)"
    )
    parser.add_argument(
        "--format", choices=["pdf", "svg"], help="figures in this format too, beside the PNG"
    )


def _formats(given: argparse.Namespace) -> list[str]:
    return ["png", given.format] if given.format else ["png"]


# --- reading a run --------------------------------------------------------------------------------


def compare(arguments: Sequence[str]) -> int:
    """`aoabench compare`: paired differences between the estimators of each cell, printed and kept
    beside the run.
    """
    from aoabench import comparing
    from aoabench.store import write_frame

    parser = _Parser(
        prog="aoabench compare",
        description="Paired comparison of estimators over the replications.",
    )
    parser.add_argument(
        "run", help="folder of a run (runner.out); the table is kept there as compare.parquet"
    )
    parser.add_argument(
        "--baseline", help="estimator to compare with (default: the smallest mean of each cell)"
    )
    names = ", ".join(comparing.METRICS)
    parser.add_argument(
        "--metric", default="rmse_3d_m", help=f"one of {names} (default: rmse_3d_m)"
    )
    given = parser.parse_args(list(arguments))
    table = comparing.compare(given.run, given.baseline, given.metric)
    print("\n".join(comparing.lines(table)))
    try:
        write_frame(Path(given.run) / "compare.parquet", table)
    except OSError as error:  # another one's run, or an archive
        print(f"(not kept as {given.run}/compare.parquet: {error.strerror})", file=sys.stderr)
    return 0


def collect(arguments: Sequence[str]) -> int:
    """`aoabench collect`: make the tables of a run again from its parts."""
    from aoabench import store, tables

    parser = _Parser(
        prog="aoabench collect",
        description="Make the tables of a run from its parts; every run does so.",
    )
    parser.add_argument("run", help="folder of a run (runner.out)")
    given = parser.parse_args(list(arguments))
    out = Path(given.run)
    noted = tables.records(out)
    if not noted:
        raise UserError(f"{out}: no results here; allowed: the runner.out folder of a run")
    with store.locked(out, lambda line: print(f"aoabench: {line}", file=sys.stderr)):
        tables.collect(out)
    print(f"{len(noted)} cells: {out}/{{tidy,replications,summary,cells,timing}}.parquet")
    return 0


def replay(arguments: Sequence[str]) -> int:
    """`aoabench replay`: repeat one replication of a run, write its trace and a picture of it."""
    from aoabench import replaying
    from aoabench.config import parse_plugins

    os.environ.setdefault("MPLBACKEND", "Agg")  # figures go to files

    parser = _Parser(
        prog="aoabench replay", description="Repeat one replication of a run with its trace."
    )
    parser.add_argument("run", help="folder of a run (runner.out)")
    parser.add_argument("--replication", type=int, required=True, help="its number, >= 0")
    parser.add_argument("--estimator", required=True, help="name of the estimator")
    parser.add_argument("--cell", help="cell of the run, if it has several")
    parser.add_argument(
        "--plugins", default="", help="packages of your own that the run used, with commas"
    )
    formats = "measurements and anchors too, as files that scenario=recorded reads"
    parser.add_argument("--export", choices=["csv", "parquet"], help=formats)
    given = parser.parse_args(list(arguments))
    plugins = parse_plugins([f"plugins={given.plugins}"])
    chosen = (given.replication, given.estimator, given.cell, plugins, given.export)
    print(replaying.replay(Path(given.run), *chosen))
    return 0


def list_presets(arguments: Sequence[str]) -> int:
    """`aoabench list`: every preset with its one-line description."""
    from aoabench.config import GROUPS, options

    parser = _Parser(prog="aoabench list", description="The presets of each config group.")
    parser.add_argument("group", nargs="?", choices=GROUPS, help="only this group")
    parser.add_argument("--config-dir", help="also the configs of this folder")
    given = parser.parse_args(list(arguments))
    if given.config_dir and not Path(given.config_dir).is_dir():
        raise UserError(f"--config-dir={given.config_dir}: no such folder")
    for group in [given.group] if given.group else GROUPS:
        presets = options(group, given.config_dir)
        print(f"{group}:" if presets else f"{group}: (none yet)")
        for name, text in presets.items():
            print(f"  {name:24s} {text}")
    return 0


if __name__ == "__main__":
    main()
