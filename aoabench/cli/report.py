"""`aoabench report`."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from aoabench.cli.common import Parser, formats, results_options


def report(arguments: Sequence[str]) -> int:
    """`aoabench report`: figures and page from the stored tables; nothing is simulated."""
    from aoabench.studies import reproduce as reproducing

    os.environ.setdefault("MPLBACKEND", "Agg")  # figures go to files

    parser = Parser(
        prog="aoabench report", description="Draw figures and page again from the stored tables."
    )
    results_options(parser)
    given = parser.parse_args(list(arguments))
    reproducing.draw(reproducing.all_studies(), Path(given.results), print, formats=formats(given))
    return 0
