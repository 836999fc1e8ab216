"""`aoabench replay`."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from aoabench.cli.common import Parser


def replay(arguments: Sequence[str]) -> int:
    """`aoabench replay`: repeat one replication of a run, write its trace and a picture of it."""
    from aoabench.config.plugins import parse_plugins
    from aoabench.engine import replay_files
    from aoabench.engine.replay import replay as repeat

    os.environ.setdefault("MPLBACKEND", "Agg")  # figures go to files

    parser = Parser(
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
    done = repeat(Path(given.run), given.replication, given.estimator, given.cell, plugins)
    print(replay_files.write(done, given.export))
    return 0
