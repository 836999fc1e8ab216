"""Items computed one after the other: each is reduced and drawn while the next one's experiment
runs.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from aoabench.kernels.loading import waited_s
from aoabench.store.files import provenance, write_frame
from aoabench.studies import computing, progress, stored, study
from aoabench.studies.background import Background
from aoabench.studies.choice import Pair
from aoabench.studies.computing import Ran, Runs
from aoabench.studies.places import Places
from aoabench.studies.sections import embedded
from aoabench.studies.study import Item, Study

Echo = Callable[[str], None]


@dataclass
class Pipeline:
    """Computes items at a scale and draws them. `echo` gets a line for each item that is done.

    computed: a mapping (study, item, rows, seconds) for each item that is done, in order; problems:
    by (study, item) the reason why a table cannot be drawn, "" if it can.
    """

    scale: str
    places: Places
    formats: tuple[str, ...]
    echo: Echo
    pace: progress.Pace
    runs: Runs
    computed: list[dict[str, Any]] = field(default_factory=list)
    problems: dict[tuple[str, str], str] = field(default_factory=dict)
    _waiting: deque[tuple[Study, Item, Future[tuple[dict[str, Any], str]]]] = field(
        default_factory=deque
    )
    _begin_s: float = field(default_factory=lambda: time.perf_counter() - waited_s())

    def compute(self, pairs: Sequence[Pair]) -> None:
        """Compute all items. Raises what the first of them raises."""
        with Background() as background:
            tables: list[Future[None]] = []
            for number, (s, item) in enumerate(pairs):
                # a fresh run replaces parts that the item before may share and still read
                self._tell(wait=item.times or self.runs.fresh)
                if item.times:
                    _wait_for(tables)
                title = f"{s.name} {item.name} ({self.pace.text()})"
                begin = time.perf_counter()
                ran = computing.run(s, item, self.scale, self.runs, title)
                took_s = time.perf_counter() - begin
                self.pace.ran(self._elapsed_s())
                rest = partial(self._finish, s, item, ran, took_s)
                self._waiting.append((s, item, background.submit(rest)))
                self._tell(wait=item.times)
                if all(other.name != s.name for other, _ in pairs[number + 1 :]):
                    tables.append(background.submit(partial(self.runs.tabulate, s)))
            self._tell(wait=True)
            _wait_for(tables)

    def _finish(
        self, s: Study, item: Item, ran: Ran | None, took_s: float
    ) -> tuple[dict[str, Any], str]:
        """Make and draw the table of an item whose experiment ran for `took_s` seconds."""
        row = write_table(s, item, self.scale, self.places, self.runs, ran, took_s)
        problem = stored.drawn(s, item, self.places, self.formats)
        figure = study.figure_path(self.places.drawn, s, item)
        if figure.exists():
            embedded(figure)  # kept for the page
        return row, problem

    def _elapsed_s(self) -> float:
        """Seconds since the command began, without those in which kernels were compiled."""
        return time.perf_counter() - waited_s() - self._begin_s

    def _tell(self, wait: bool) -> None:
        """Enter and echo the items that are done; with `wait`, all of them."""
        while self._waiting and (wait or self._waiting[0][2].done()):
            s, item, future = self._waiting.popleft()
            with progress.shown(f"{s.name} {item.name} ({self.pace.text()})"):
                row, problem = future.result()
            self.pace.done(self._elapsed_s())
            self.computed.append(row)
            rows = f"{s.name} {item.name}: {row['rows']} rows, {row['seconds']:.1f} s"
            self.echo(f"{rows} ({self.scale}); {self.pace.text()}")
            self.problems[s.name, item.name] = problem
            tell_problem(s, item, self.places, self.echo, problem)


def _wait_for(tables: Sequence[Future[None]]) -> None:
    """Wait until the tables of some studies are made; raises what making them raises."""
    with progress.shown("tables of the replications"):
        for made in tables:
            made.result()


def write_table(
    s: Study, item: Item, scale: str, places: Places, runs: Runs, ran: Ran | None, took_s: float
) -> dict[str, Any]:
    """Reduce and store the table of an item whose experiment ran for `took_s` seconds; return its
    study, item, rows and seconds.
    """
    begin = time.perf_counter()
    frame, origin = computing.reduce(s, item, scale, runs.folder(s), ran)
    seconds = round(took_s + time.perf_counter() - begin, 2)
    origin = {**provenance(origin), "scale": scale, "seconds": seconds}
    write_frame(study.table_path(places.results, s, item), frame, origin)
    return {"study": s.name, "item": item.name, "rows": len(frame), "seconds": seconds}


def tell_problem(s: Study, item: Item, places: Places, echo: Echo, problem: str) -> None:
    """Echo the reason why a table cannot be used, if there is one, and the command that helps."""
    if problem:
        again = f"aoabench reproduce {s.name} --only {item.name}{places.options}"
        echo(f"{s.name} {item.name}: not computed: {problem}; {again}")
