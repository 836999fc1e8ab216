"""`aoabench compare`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from aoabench.cli.common import Parser


def compare(arguments: Sequence[str]) -> int:
    """`aoabench compare`: paired differences between the estimators of each cell, printed and kept
    beside the run.
    """
    from aoabench.report.comparison import lines
    from aoabench.store import compare as compare_module
    from aoabench.store.compare import METRICS
    from aoabench.store.files import write_frame

    parser = Parser(
        prog="aoabench compare",
        description="Paired comparison of estimators over the replications.",
    )
    parser.add_argument(
        "run", help="folder of a run (runner.out); the table is kept there as compare.parquet"
    )
    parser.add_argument(
        "--baseline", help="estimator to compare with (default: the smallest mean of each cell)"
    )
    names = ", ".join(METRICS)
    parser.add_argument(
        "--metric", default="rmse_3d_m", help=f"one of {names} (default: rmse_3d_m)"
    )
    given = parser.parse_args(list(arguments))
    table = compare_module.compare(given.run, given.baseline, given.metric)
    print("\n".join(lines(table)))
    try:
        write_frame(Path(given.run) / "compare.parquet", table)
    except OSError as error:  # another one's run, or an archive
        print(f"(not kept as {given.run}/compare.parquet: {error.strerror})", file=sys.stderr)
    return 0
