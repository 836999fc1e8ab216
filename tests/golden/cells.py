"""Ids of the cells that ship: of every scenario with every noise, and of every experiment.

Stored results are found by these ids. After a change that means to move them, write the file again:

    python -m tests.golden.cells > tests/golden/cells.txt
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

from aoabench.cell import Cell
from aoabench.config.compose import compose_cells
from aoabench.config.presets import options
from aoabench.errors import UserError


@cache
def with_every_noise(scenario: str) -> dict[str, Cell]:
    """The scenario's cells by noise, each with one estimator that fits; their ids depend on none."""
    name = "filter=[ekf_aoa]"
    if "room" in scenario:
        name = "estimator=[anchor_mean]"
    elif scenario.startswith("bs_grid"):
        name = "estimator=[ml_kcorr]"
    words = [f"scenario={scenario}", f"noise={','.join(options('noise'))}", name]
    return {cell.noise_name: cell for cell in compose_cells(words)}


def of_scenario(scenario: str) -> Iterator[str]:
    """A line `scenario NAME NOISE ID` for each noise, or `scenario NAME refused`."""
    try:
        for noise, cell in with_every_noise(scenario).items():
            yield f"scenario {scenario} {noise} {cell.id}"
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
