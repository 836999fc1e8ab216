"""How many replications an item needs, so that its undecided claims are decided.

Each time that replications are added is one more chance to be wrong: a false claim of which the
interval of 99.7 % is looked at k times holds in at most 0.15 k %.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from aoabench.report.text import significant
from aoabench.studies import statements, stored
from aoabench.studies.choice import Pair
from aoabench.studies.study import Item, Study
from aoabench.studies.verdict import UNDECIDED

MARGIN = 1.15  # more than the estimated number, as the estimate moves while replications are added


@dataclass(frozen=True)
class Need:
    """An item with undecided claims: the replications `reps` that would decide them, those in its
    table, and the expected seconds of computing them all.
    """

    study: Study
    item: Item
    reps: int
    stored: int
    expected_s: float
    claims: tuple[str, ...]


@dataclass(frozen=True)
class Needs:
    """The items that more replications would decide, the quickest first, and the claims that they
    would not, each with the reason.
    """

    items: tuple[Need, ...]
    left: dict[str, str]


def needs(pairs: Sequence[Pair], results: Path) -> Needs:
    """What the undecided claims on the chosen items need."""
    asked = {(s.name, item.name): (s, item) for s, item in pairs}
    studies = list({s.name: s for s, _ in pairs}.values())
    rows = statements.verdicts(studies, results).of(asked).readings
    rows = rows[(rows["verdict"] == UNDECIDED) & ~rows["robustness"]]
    most = rows.groupby(["study", "id"])["needed"].max()  # over the readings
    left: dict[str, str] = {}
    found: dict[tuple[str, str], list[tuple[str, float]]] = {}
    for row in rows.to_dict("records"):
        claim = f"{row['study']} {row['id']}"
        s, item = asked.get((row["study"], row["table"]), (None, None))
        if s is None or item is None:
            left[claim] = f"rests on {row['table']}, which was not named"
        elif item.experiment is None:
            left[claim] = "its item has no replications"
        elif item.counts != "replications":
            left[claim] = f"{row['reason']}, and their number is the paper's"
        elif not math.isfinite(row["needed"]):
            left[claim] = row["reason"]
        elif row["needed"] > statements.BEYOND * item.paper_reps:
            reps = significant(most[row["study"], row["id"]], 2)
            left[claim] = f"needs N = {reps}, beyond ten times the study's"
        else:
            found.setdefault((s.name, item.name), []).append((claim, row["needed"]))
    items = [_need(*asked[key], wanted, results) for key, wanted in found.items()]
    return Needs(tuple(sorted(items, key=lambda n: n.expected_s)), left)


def _need(s: Study, item: Item, wanted: list[tuple[str, float]], results: Path) -> Need:
    """The need of an item, from its undecided claims with the replications that each needs."""
    content = stored.read(s, item, results)
    reps = math.ceil(MARGIN * max(content.reps, *(needed for _, needed in wanted)))
    study_reps = content.reps if math.isnan(item.paper_reps) else item.paper_reps
    most = math.floor(statements.BEYOND * study_reps)
    seconds = float(content.origin.get("seconds", 0.0)) * reps / content.reps
    names = tuple(dict.fromkeys(claim for claim, _ in wanted))
    return Need(s, item, min(reps, most), int(content.reps), seconds, names)
