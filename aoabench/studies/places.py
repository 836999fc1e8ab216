"""Where the commands of the studies read tables and write figures, page and replications."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path

from aoabench.resources import output_folder

RESULTS = Path("results")


@dataclass(frozen=True)
class Places:
    """Folders of one command: `results` holds the folder `tables`, `drawn` gets the folders
    `figures` and `report`, `raw` holds the replications of each study, `bench` the bench's table.
    """

    results: Path
    drawn: Path
    raw: Path
    bench: Path

    @classmethod
    def inside(cls, folder: Path) -> Places:
        """All folders inside one, as --results names it."""
        return cls(folder, folder, folder / "raw", folder / "bench")

    @property
    def options(self) -> str:
        """The options, after a space, with which `aoabench reproduce` writes these tables."""
        if self.results == RESULTS:
            return " --scale paper"
        own = self.results != RESULTS / "quick"
        return f" --results {shlex.quote(str(self.results))}" if own else ""


def of_scale(scale: str, folder: Path | None = None) -> Places:
    """The places of `reproduce`: `folder` if given, else results/quick at quick scale and results
    at paper scale. Both scales share results/raw, so that paper scale tops up what quick computed.
    """
    if folder is not None:
        return Places.inside(folder)
    root = RESULTS / "quick" if scale == "quick" else RESULTS
    return Places(root, root, RESULTS / "raw", RESULTS / "bench")


def of_report(scale: str, folder: Path | None = None) -> Places:
    """The places of `report`: those of `reproduce`, but figures and page of the committed tables
    go to results/draft, unless COMMIT=1 stands in the environment.
    """
    if folder is not None or scale == "quick":
        return of_scale(scale, folder)
    return Places(RESULTS, output_folder(), RESULTS / "raw", RESULTS / "bench")
