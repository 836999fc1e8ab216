"""The command line: the group of subcommands and their exit status.

Exit status: 0 done, 2 the user's mistake (one line), 1 anything else, 130 interrupted.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from typing import NoReturn

from aoabench.cli.collect import collect
from aoabench.cli.compare import compare
from aoabench.cli.list import list_presets
from aoabench.cli.replay import replay
from aoabench.cli.report import report
from aoabench.cli.reproduce import reproduce
from aoabench.cli.run import run
from aoabench.errors import RunError, UserError


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
        from aoabench.errors import did_you_mean

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
