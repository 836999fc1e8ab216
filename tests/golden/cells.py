"""Ids of the cells that ship: of every scenario with every noise, and of every experiment.

Stored results are found by these ids. After a change that means to move them, write the file again:

    python -m tests.golden.cells > tests/golden/cells.txt
"""

from __future__ import annotations

from collections.abc import Iterator

from aoabench.composing import compose_cells
from aoabench.config import options
from aoabench.types import UserError


def of_scenario(scenario: str) -> Iterator[str]:
    """A line `scenario NAME NOISE ID` for each noise, or `scenario NAME refused`."""
    noises = ",".join(options("noise"))
    words = [f"scenario={scenario}", f"noise={noises}", "estimator=[vmf_ml]"]
    try:
        for cell in compose_cells(words):
            yield f"scenario {scenario} {cell.noise_name} {cell.id}"
    except UserError:  # a recording needs the file that it is in
        yield f"scenario {scenario} refused"


def of_experiment(experiment: str) -> Iterator[str]:
    """A line `experiment NAME ID` for each cell, in the order of the sweep."""
    for cell in compose_cells([f"experiment={experiment}"]):
        yield f"experiment {experiment} {cell.id}"


def main() -> None:
    """Print all lines."""
    for scenario in options("scenario"):
        print(*of_scenario(scenario), sep="\n")
    for experiment in options("experiment"):
        print(*of_experiment(experiment), sep="\n")


if __name__ == "__main__":
    main()
