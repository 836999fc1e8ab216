"""`make bench`: speed and memory, a table and a figure, to results/draft/bench; with COMMIT=1 in
the environment to results/bench and docs/reference/benchmarks.md.

A part gives rows; nothing is asserted, because a shared machine is noisy. Actions to compare run in
turn, and the medians are taken, so that a load of the machine slows all of them.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path

import pandas as pd

from aoabench.resources import output_folder
from aoabench.store.files import write_frame
from benchmarks import cost, filters, growth, harness, kernels, process, recordings, show, snapshots
from benchmarks.timing import Row

Part = Callable[[int], Iterator[Row]]
PARTS: dict[str, Part] = {
    part.__name__: part
    for part in (
        filters.kalman,
        filters.particle,
        snapshots.snapshot,
        snapshots.room,
        filters.access_nodes,
        kernels.generality,
        harness.harness,
        cost.cost,
        process.start,
        process.interrupt,
        process.scaling,
        process.memory,
        growth.growth,
        recordings.locate,
        process.studies,
        kernels.precision,
    )
}
PAGE = Path("docs/reference/benchmarks.md")
COMMITTED = Path("results/bench/bench.parquet")
BEFORE = COMMITTED.with_name("before.parquet")  # the version before, on the same machine


def main() -> None:
    """Measure all or some parts, merge the rows with the stored ones, write table and figure."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("--results", default=output_folder(), type=Path)
    parser.add_argument("--repeats", default=7, type=int)
    parser.add_argument(
        "--only",
        nargs="+",
        choices=list(PARTS),
        default=list(PARTS),
        metavar="PART",
        help=", ".join(PARTS),
    )
    given = parser.parse_args()
    path = given.results / "bench" / "bench.parquet"
    draft = given.results == output_folder() and not path.exists()
    stored = COMMITTED if draft else path  # a draft begins with the committed rows
    frame = pd.read_parquet(stored) if stored.exists() else pd.DataFrame({"part": []})
    for name in PARTS:
        if name in given.only:
            frame = merged(frame, name, measured(name, given.repeats))
            write_frame(path, frame)  # after each part, so that an interruption loses no part
    show.draw(frame, path.with_suffix(".png"))
    cost.draw(frame, path.with_name("cost.png"))
    if PAGE.exists() and path == COMMITTED:
        before = pd.read_parquet(BEFORE) if BEFORE.exists() else None
        show.write_into(PAGE, show.markdown(frame, before))
    print(f"written to {path}")


def measured(name: str, repeats: int) -> pd.DataFrame:
    """The rows of a part, printed as they come."""
    found = []
    for row in PARTS[name](repeats):
        found.append({"part": name, **asdict(row)})
        value = f"{row.value:10.3f} {row.unit:5s}"
        print(f"{row.what:34s} {row.detail:32s} {value} {row.target}", flush=True)
    return pd.DataFrame(found)


def merged(frame: pd.DataFrame, name: str, new: pd.DataFrame) -> pd.DataFrame:
    """The rows of all parts in their order, those of one part replaced by new ones."""
    others = frame[frame["part"].isin(set(PARTS) - {name})]
    both = pd.concat([part for part in (others, new) if len(part)] or [others])
    order = list(PARTS)
    return both.sort_values(
        "part", key=lambda c: c.map(order.index), kind="stable", ignore_index=True
    )


if __name__ == "__main__":
    main()
