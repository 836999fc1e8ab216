"""`aoabench reproduce`."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from aoabench.cli.common import Parser, formats, results_options


def reproduce(arguments: Sequence[str]) -> int:
    """`aoabench reproduce`: compute the studies' items, then draw figures, tables and page."""
    from aoabench.studies import reproduce as reproducing

    os.environ.setdefault("MPLBACKEND", "Agg")  # figures go to files

    parser = Parser(
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
    results_options(parser)
    given = parser.parse_args(list(arguments))
    reproducing.reproduce(
        given.study, given.scale, given.only, Path(given.results), print, formats(given)
    )
    return 0
