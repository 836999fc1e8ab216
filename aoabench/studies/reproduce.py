"""From a study's list of items to its tables, figures, verdicts and page.

A study is a folder under `experiments/`: study.yaml (the items), `numbers` (item -> table) and
`figures` (table -> figure and values), each a module or a package, claims.yaml, errata.yaml,
README.md. Computing ends in Parquet; drawing starts from it.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from aoabench.engine.faults import writable
from aoabench.errors import UserError
from aoabench.kernels.loading import ahead
from aoabench.resources import committing
from aoabench.store.files import provenance, write_frame
from aoabench.studies import computing, findings, page, progress, screen, statements, stored, study
from aoabench.studies.choice import Pair, cheapest_first, chosen
from aoabench.studies.computing import Runs
from aoabench.studies.decide import needs
from aoabench.studies.pipeline import Echo, Pipeline, tell_problem, write_table
from aoabench.studies.places import Places, of_scale
from aoabench.studies.statements import Verdicts

README = Path("README.md")


@dataclass(frozen=True)
class Drawn:
    """Result of `draw`: the verdicts on the chosen items, the reason by (study, item) why a table
    cannot be used ("" if it can), and the path of the page.
    """

    verdicts: Verdicts
    problems: dict[tuple[str, str], str]
    page: Path


@dataclass(frozen=True)
class Reproduced:
    """Result of `reproduce`: `computed` has a mapping (study, item, rows, seconds) for each item,
    and `drawn` is the result of `draw`.
    """

    computed: list[dict[str, Any]]
    drawn: Drawn


def all_studies() -> list[str]:
    """Names of the shipped studies."""
    return study.names()


def reproduce(
    names: Sequence[str],
    scale: str,
    only: str | None,
    places: Places,
    echo: Echo,
    formats: Sequence[str] = ("png",),
    fresh: bool = False,
    every: bool = False,
) -> Reproduced:
    """Compute the items that `choice.chosen` selects at a scale, cheap ones first, draw each as
    soon as it is computed, and write verdicts and page. With `fresh`, reuse no stored replications;
    with COMMIT=1 in the environment, keep the items' seconds for the progress of later runs. The
    verdicts are printed as one screen, or with `every` claim by claim.

    Raises UserError for an unknown study or item.
    """
    expected = progress.expected(scale)
    pairs = cheapest_first(chosen(names, only, all_studies()), expected)
    writable(str(places.results), "--results")
    pace = progress.Pace(pairs, expected)
    pipeline = Pipeline(scale, places, tuple(formats), echo, pace, Runs(places.raw, fresh))
    everything = only is None and not names
    with ahead() if everything else nullcontext():
        pipeline.compute(pairs)
    if committing():
        progress.note(scale, pipeline.computed)
    return Reproduced(pipeline.computed, _conclude(pairs, pipeline.problems, places, echo, every))


def decide(
    names: Sequence[str],
    only: str | None,
    places: Places,
    echo: Echo,
    formats: Sequence[str] = ("png",),
    budget_s: float = 600.0,
    every: bool = False,
) -> Reproduced:
    """Add replications to the stored tables of paper scale until no claim on the chosen items is
    undecided that more replications would decide, or until the next item would not fit into
    `budget_s` seconds.

    Raises UserError for an unknown study or item.
    """
    pairs = chosen(names, only, all_studies())
    writable(str(places.results), "--results")
    runs = Runs(places.raw)
    computed: list[dict[str, Any]] = []
    problems: dict[tuple[str, str], str] = {}
    begin = time.perf_counter()
    while True:
        wanted = needs(pairs, places.results)
        left_s = budget_s - (time.perf_counter() - begin)
        fits = [need for need in wanted.items if need.expected_s <= left_s]
        if not fits:
            break
        s, item, reps = fits[0].study, fits[0].item, fits[0].reps
        echo(f"{s.name} {item.name}: N = {reps} instead of {fits[0].stored} for "
             f"{', '.join(fits[0].claims)}; {progress.duration(fits[0].expected_s)}")  # fmt: skip
        title = f"{s.name} {item.name}, N = {reps}"
        now = time.perf_counter()
        ran = computing.run(s, item, "paper", runs, title, reps)
        took_s = time.perf_counter() - now
        computed.append(write_table(s, item, "paper", places, runs, ran, took_s))
        problems[s.name, item.name] = _drawn(s, item, places, echo, formats)
    for need in wanted.items:
        echo(f"{', '.join(need.claims)}: N = {need.reps} takes about "
             f"{progress.duration(need.expected_s)}, beyond --budget")  # fmt: skip
    for claim, reason in wanted.left.items():
        echo(f"{claim}: {reason}")
    for s in {s.name: s for s, _ in pairs}.values():
        runs.tabulate(s)
    return Reproduced(computed, _conclude(pairs, problems, places, echo, every))


def draw(
    names: Sequence[str],
    places: Places,
    echo: Echo,
    formats: Sequence[str] = ("png",),
    every: bool = False,
) -> Drawn:
    """Figures of the named studies, and verdicts and page of all, from the stored tables. The
    verdicts are printed as one screen, or with `every` claim by claim.

    Calls `echo` with a line for each table of another version, and for each study with a line that
    lists the items without a table. Raises UserError if there is no table at all.
    """
    pairs = chosen(names, None, all_studies())
    present = {id(i): study.table_path(places.results, s, i).exists() for s, i in pairs}
    if not any(present.values()) and not any((places.results / "tables").glob("*.parquet")):
        raise UserError(
            f"{places.results / 'tables'}: no tables here; allowed: a folder that `aoabench "
            "reproduce` wrote"
        )
    writable(str(places.drawn / "figures"), "--results")
    problems = {(s.name, i.name): _drawn(s, i, places, echo, formats) for s, i in pairs}
    for s in {s.name: s for s, _ in pairs}.values():
        absent = [item.name for item in s.items if not present[id(item)]]
        if absent:
            again = f"aoabench reproduce {s.name} --only {','.join(absent)}{places.options}"
            echo(f"{s.name}: not computed; {again}")
    return _conclude(pairs, problems, places, echo, every)


def _drawn(
    s: study.Study, item: study.Item, places: Places, echo: Echo, formats: Sequence[str]
) -> str:
    """Draw an item and return the reason why its table cannot be used, or "", and echo it."""
    problem = stored.drawn(s, item, places, tuple(formats))
    tell_problem(s, item, places, echo, problem)
    return problem


def _conclude(
    pairs: Sequence[Pair],
    problems: dict[tuple[str, str], str],
    places: Places,
    echo: Echo,
    every: bool,
) -> Drawn:
    """Write verdicts and page of all studies, with COMMIT=1 what was found into README.md too, and
    print the verdicts of the chosen items: one screen, or with `every` each claim.
    """
    everything = [study.load(name) for name in all_studies()]
    verdicts = statements.verdicts(everything, places.results)
    # without the time, so that equal verdicts are equal files
    same = {key: value for key, value in provenance().items() if key != "time"}
    write_frame(places.drawn / "report" / "verdicts.parquet", verdicts.claims, same)
    write_frame(places.drawn / "report" / "readings.parquet", verdicts.readings, same)
    html = page.write(everything, verdicts, places, problems)
    if committing() and places == of_scale("paper"):
        findings.write_into(README, findings.overview(everything, verdicts.claims, places.results))
    mine = verdicts.of({(s.name, item.name) for s, item in pairs})
    echo("")
    echo(screen.everything(mine.claims) if every else screen.screen(mine, everything))
    echo("")
    echo(f"tables   {places.results / 'tables'}")
    echo(f"figures  {places.drawn / 'figures'}")
    echo(f"page     {html}")
    if not every:
        echo("each claim with quotation, readings and reason: on the page, or with --all or --json")
    return Drawn(mine, problems, html)
