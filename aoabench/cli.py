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

from aoabench.types import UserError


def main(argv: Sequence[str] | None = None) -> NoReturn:
    """Entry point of `aoabench`."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    try:
        sys.exit(dispatch(arguments))
    except UserError as error:
        print(f"aoabench: {' '.join(str(error).split())}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        print("aoabench: interrupted; what was finished is kept, the same command goes on from there", file=sys.stderr)
        sys.exit(130)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)


class _Parser(argparse.ArgumentParser):
    """An argument parser whose complaint is one line."""

    def error(self, message: str) -> NoReturn:
        raise UserError(f"{self.prog.partition(' ')[2] or 'command'}: {message}; see `{self.prog} --help`")


def dispatch(arguments: Sequence[str]) -> int:
    """Run one subcommand; returns the exit status."""
    commands: dict[str, Callable[[Sequence[str]], int]] = {
        "run": run,
        "reproduce": reproduce,
        "report": report,
        "compare": compare,
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

  aoabench list                        the presets: scenarios, noises, filters, estimators, experiments
  aoabench run [OVERRIDES]             simulate one cell: aoabench run noise=vmf 'filter=[ekf_vmf,ukf_vmf]' reps=200
  aoabench run -m [OVERRIDES]          sweep, e.g. ... -m noise.sigma_deg=2,5,10 (Hydra multirun; run --help says more)
  aoabench compare RUN                 paired comparison of the estimators of a run
  aoabench replay RUN --replication N --estimator NAME    repeat one replication with its trace
  aoabench reproduce [STUDY ...] [--scale quick|paper] [--only ITEM]    tables and figures of the studies
  aoabench report [--format pdf|svg]   draw figures and page again from the stored tables

RUN is the folder of a run (runner.out). Exit status: 0 done, 2 a mistake in the input, 1 anything else."""


# --- run --------------------------------------------------------------------------------------------------------------


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
    overrides = [a for a in arguments if a.startswith("~") or ("=" in a and not a.startswith("-"))]
    given = parser.parse_args([a for a in arguments if a not in overrides])
    if given.help:
        print(_run_help(given.config_dir))
        return 0
    if given.cfg:
        print(composing.show(overrides, given.config_dir, given.resolve, given.package, given.multirun), end="")
        return 0
    cells = composing.compose_cells(overrides, config_dir=given.config_dir, sweep=given.multirun)
    done = runner.run(cells)
    _print_run(done, cells)
    return 0


_RUN_HELP = """\
aoabench run: simulate one cell, or with -m a sweep over cells, and keep every replication in Parquet.

== Options: GROUP=NAME; several filters or estimators: 'filter=[NAME,NAME]' ==

{options}

== Config: override anything as KEY=VALUE ==

{config}
== Flags ==

-m, --multirun      sweep: KEY=VALUE,VALUE makes a cell of each combination (Hydra's syntax, range() and glob() too)
-c job, --cfg job   show the composed config; with --resolve its interpolations too, with -p KEY a part of it
--config-dir DIR    a folder with configs of your own (DIR/filter/mine.yaml ...), appended to the shipped ones

== Examples ==

aoabench run noise=vmf 'filter=[ekf_vmf,ukf_vmf]' reps=200
aoabench run -m noise.sigma_deg=2,5,10 'filter=[ekf_vmf,ekf_ae_nominal]' runner.out=results/raw/sigma
aoabench run -m experiment=nurminen2018_frames reps=500

`aoabench list` says what each option is."""


def _run_help(config_dir: str | None) -> str:
    from aoabench import composing
    from aoabench.config import GROUPS, options

    listed = "\n".join(f"{group}: {', '.join(options(group, config_dir)) or '(none yet)'}" for group in GROUPS)
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
    extra = [c for c in table.columns if c not in ("experiment", "scenario", "noise", "seed", "estimators", "config")]
    mine = mine.merge(table[extra], on="cell")
    swept = [c for c in extra if c != "cell" and mine[c].nunique(dropna=False) > 1]
    shown = mine[["scenario", "noise", *swept, "estimator", "replications"]].copy()
    for name, title in (("rmse_pooled_3d_m", "RMSE 3-D [m]"), ("rmse_pooled_xy_m", "RMSE xy [m]")):
        shown[title] = [f"{v:.4g} ± {s:.1g}" for v, s in zip(mine[name], mine[f"{name}_se"])]
    shown["failed"] = [f"{v:.1%}" for v in mine["failure_rate"]]
    shown["fixes ok"] = [f"{v:.2%}" for v in mine["share_ok"]]
    print(shown.to_string(index=False, max_rows=60))
    print(f"tables: {out}/{{replications,cells,summary,timing}}.parquet    in Python: aoabench.load({str(out)!r})")


# --- studies ----------------------------------------------------------------------------------------------------------


def reproduce(arguments: Sequence[str]) -> int:
    """`aoabench reproduce`: compute the items of the studies, then draw figures, tables and page."""
    from aoabench import reproducing

    os.environ.setdefault("MPLBACKEND", "Agg")  # figures go to files

    parser = _Parser(prog="aoabench reproduce", description="Regenerate the tables and figures of the studies.")
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
    reproducing.reproduce(given.study, given.scale, given.only, Path(given.results), print, _formats(given))
    return 0


def report(arguments: Sequence[str]) -> int:
    """`aoabench report`: figures and page from the stored tables; nothing is simulated."""
    from aoabench import reproducing

    os.environ.setdefault("MPLBACKEND", "Agg")  # figures go to files

    parser = _Parser(prog="aoabench report", description="Draw figures and page again from the stored tables.")
    _results_options(parser)
    given = parser.parse_args(list(arguments))
    reproducing.draw(reproducing.all_studies(), Path(given.results), print, formats=_formats(given))
    return 0


def _results_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--results", default="results", help="folder of tables, figures and page (default: results)")
    parser.add_argument("--format", choices=["pdf", "svg"], help="figures in this format too, beside the PNG")


def _formats(given: argparse.Namespace) -> list[str]:
    return ["png", given.format] if given.format else ["png"]


# --- reading a run ----------------------------------------------------------------------------------------------------


def compare(arguments: Sequence[str]) -> int:
    """`aoabench compare`: paired differences between the estimators of each cell."""
    import pandas as pd

    from aoabench import statistics, tables
    from aoabench.config import did_you_mean
    from aoabench.store import REPLICATIONS

    parser = _Parser(prog="aoabench compare", description="Paired comparison of estimators over the replications.")
    parser.add_argument("run", help="folder of a run (runner.out)")
    parser.add_argument("--baseline", help="estimator to compare with (default: the smallest mean of each cell)")
    parser.add_argument("--metric", default="rmse_3d_m", help="column of the replications table (default: rmse_3d_m)")
    given = parser.parse_args(list(arguments))
    frame = tables.load(given.run)
    numeric = [c for c, kind in REPLICATIONS.items() if kind == "double" or c.startswith("n_")]
    if given.metric not in numeric:
        hint = did_you_mean(given.metric, numeric) or f"; allowed: {', '.join(numeric)}"
        raise UserError(f"--metric={given.metric}: no such column{hint}")
    names = list(frame["estimator"].unique())
    if given.baseline and given.baseline not in names:
        hint = did_you_mean(given.baseline, names) or f"; allowed: {', '.join(names)}"
        raise UserError(f"--baseline={given.baseline}: not in this run{hint}")
    fixed = {*REPLICATIONS, "seed"}
    varied = [c for c in frame.columns if c not in fixed and frame[c].nunique(dropna=False) > 1]
    order = list(pd.read_parquet(Path(given.run) / "cells.parquet", columns=["cell"])["cell"])
    for cell, rows in sorted(frame.groupby("cell"), key=lambda pair: order.index(pair[0])):
        wide = rows.pivot(index="replication", columns="estimator", values=given.metric)
        wide = wide.dropna(axis="columns", how="all")
        complete = wide.dropna()
        if len(complete) < len(wide):
            print(f"\n(cell {cell}: only {len(complete)} of {len(wide)} replications have a value of every estimator)")
        wide = complete if len(complete) > 1 else wide
        if wide.empty:
            continue
        means = wide.mean().sort_values()
        base = given.baseline if given.baseline in wide else means.index[0]
        first = rows.iloc[0]
        print(
            f"\n{first['scenario']} {first['noise']}{''.join(f' {c}={first[c]}' for c in varied)} (cell {cell}), "
            f"{given.metric}, "
            f"compared with {base} = {means[base]:.4g}"
        )
        for name in means.index:
            if name == base:
                continue
            pair = statistics.paired(wide[name], wide[base])
            low, high = pair.percent_interval()
            says = "larger" if low > 0 else "smaller" if high < 0 else "no difference seen"
            if low != low:
                print(f"  {name:24s} too few pairs with a value to compare: N = {pair.n}")
                continue
            print(
                f"  {name:24s} {pair.percent.value:+8.2f} %  [{low:+.2f}, {high:+.2f}]  "
                f"p = {pair.p_value:.2g}  N = {pair.n}  {says}"
            )
    return 0


def replay(arguments: Sequence[str]) -> int:
    """`aoabench replay`: repeat one replication of a run and write its truth, measurements and estimates."""
    from aoabench import replaying
    from aoabench.config import parse_plugins

    parser = _Parser(prog="aoabench replay", description="Repeat one replication of a run with its trace.")
    parser.add_argument("run", help="folder of a run (runner.out)")
    parser.add_argument("--replication", type=int, required=True, help="its number, >= 0")
    parser.add_argument("--estimator", required=True, help="name of the estimator")
    parser.add_argument("--cell", help="cell of the run, if it has several")
    parser.add_argument("--plugins", default="", help="packages of your own that the run used, with commas")
    given = parser.parse_args(list(arguments))
    plugins = parse_plugins([f"plugins={given.plugins}"])
    print(replaying.replay(Path(given.run), given.replication, given.estimator, given.cell, plugins))
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
