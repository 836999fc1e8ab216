"""The verdicts on all claims of the studies, from the stored tables: a row for each claim, and a
row for each of its readings.
"""

from __future__ import annotations

import math
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from aoabench.maths.estimate import Estimate
from aoabench.maths.intervals import normal_quantile
from aoabench.report.text import significant
from aoabench.studies import stored, verdict
from aoabench.studies.claims import CLASSES, Claim, Reading
from aoabench.studies.study import Item, Study
from aoabench.studies.verdict import DEPENDS, FAILS, HOLDS, NOT_JUDGED, UNDECIDED

if TYPE_CHECKING:
    import pandas as pd

NOT_COMPUTED = "not computed"
OTHER_SCALE = "not judged at this scale"
WORDS = (HOLDS, DEPENDS, FAILS, UNDECIDED, NOT_JUDGED)
NAMED = 5  # readings that a claim's row names
BEYOND = 10.0  # times the table's replications: an undecided claim that needs more is listed apart
JUDGED = {
    "study": str, "item": str, "id": str, "class": str, "quantifier": str, "what": str,
    "where": str, "quote": str, "printed": str, "ours": float, "se": float, "low": float,
    "high": float, "unit": str, "verdict": str, "reason": str, "readings": str, "robustness": str,
    "chosen": str, "flips": str, "shows": float, "needed": float, "basis": str, "counts": bool,
}  # fmt: skip
READ = {
    "study": str, "item": str, "id": str, "reading": str, "robustness": bool, "table": str,
    "number": str, "numbers": int, "ours": float, "se": float, "low": float, "high": float,
    "unit": str, "verdict": str, "reason": str, "flips": str, "shows": float, "needed": float,
}  # fmt: skip


@dataclass(frozen=True)
class Verdicts:
    """The verdicts on the claims of some studies: `claims` has a row for each claim, with the
    columns JUDGED, `readings` one for each reading, with the columns READ.
    """

    claims: pd.DataFrame
    readings: pd.DataFrame

    def of(self, asked: Container[tuple[str, str]]) -> Verdicts:
        """Those on the items `asked`, pairs of study and item."""
        frames = (self.claims, self.readings)
        kept = ([pair in asked for pair in zip(f["study"], f["item"])] for f in frames)
        return Verdicts(*(f[k] for f, k in zip(frames, kept)))


def verdicts(studies: Sequence[Study], results: Path) -> Verdicts:
    """The verdicts on the claims of the studies, from the tables under `results`."""
    import pandas as pd

    claims, readings = [], []
    for study in studies:
        numbers = Numbers(study, results)
        for claim in study.claims:
            item = numbers.items[claim.item]
            found = [_read(claim, reading, numbers) for reading in claim.readings]
            claims.append({"study": study.name, **_row(claim, item, found)})
            own = {"study": study.name, "item": item.name, "id": claim.id}
            readings += [row | own for row in found]
    return Verdicts(
        pd.DataFrame(claims, columns=list(JUDGED)), pd.DataFrame(readings, columns=list(READ))
    )


class Numbers:
    """Our numbers of a study, by id, and the items and stored tables that they come from."""

    def __init__(self, study: Study, results: Path) -> None:
        self.items = {item.name: item for item in study.items}
        self.contents = {name: stored.read(study, i, results) for name, i in self.items.items()}
        self.item_of = {i: name for name, c in self.contents.items() for i in c.values}

    def estimate(self, number: str) -> Estimate:
        """The number with an id."""
        return self.contents[self.item_of[number]].values[number][0]

    def count(self, number: str) -> float:
        """The samples or replications behind a number; NaN if unknown."""
        content = self.contents[self.item_of[number]]
        samples = content.values[number][1]
        return samples if samples == samples else content.reps

    def of_another_scale(self, ids: Sequence[str]) -> bool:
        """Whether one of the numbers was computed at a scale at which claims are not judged."""
        names = {self.item_of[i] for i in ids}
        return any(
            self.contents[n].scale != "paper" and self.items[n].judged_at != "any" for n in names
        )


def _read(claim: Claim, reading: Reading, ours: Numbers) -> dict[str, Any]:
    """The row of one reading of a claim."""
    row: dict[str, Any] = dict.fromkeys(READ, math.nan)
    row |= {"reading": reading.name, "robustness": reading.robustness, "unit": claim.unit}
    row |= {"table": claim.item, "numbers": 0, "verdict": NOT_JUDGED}
    row |= dict.fromkeys(("number", "flips", "reason"), "")
    ids = reading.ids(ours.item_of)
    if not ids:
        return row | {"reason": ours.contents[claim.item].problem or NOT_COMPUTED}
    numbers = [ours.estimate(i) for i in ids]
    limits = claim.limits(normal_quantile(verdict.LEVEL))
    found = verdict.judge(numbers, limits, claim.quantifier, claim.tie)
    mine = numbers[found.decisive]
    low, high = found.interval
    number = ids[found.decisive]
    row |= {"table": ours.item_of[number], "number": number, "numbers": len(ids)}
    row |= {"ours": mine.value, "se": mine.se, "low": low, "high": high}
    if not claim.judged:
        return row | {"reason": _unjudged(claim, mine)}
    if ours.of_another_scale(ids):
        return row | {"reason": OTHER_SCALE}
    count = ours.count(number)
    reasons = []
    if found.ties:
        some = "a tie" if len(ids) == 1 else f"{found.ties} of {len(ids)} are ties"
        reasons.append(f"{some} (within ± {claim.tie:g} {claim.unit}".rstrip() + ")")
    if found.word == UNDECIDED and found.ties < len(ids):
        reasons.append(_undecided(mine, found, count, ours.items[ours.item_of[number]]))
    return row | {
        "verdict": found.word,
        "reason": "; ".join(reasons),
        "flips": _flips(claim, found.word, found.flips),
        "ends": found.flips,
        "shows": found.shows,
        "needed": found.more * count,
    }  # fmt: skip


def _row(claim: Claim, item: Item, found: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The row of a claim from the rows of its readings."""
    own = [row for row in found if not row["robustness"]]
    shown = own[0]
    word = verdict.together(row["verdict"] for row in own)
    reasons = _reasons(own)
    explained = claim.reason if word in (FAILS, DEPENDS) else ""
    needed = [row["needed"] for row in own if row["needed"] == row["needed"]]
    return {
        "item": claim.item,
        "id": claim.id,
        "class": claim.kind,
        "quantifier": claim.quantifier if claim.kind == "statement" else "",
        "what": claim.what,
        "where": claim.where,
        "quote": claim.quote,
        "printed": claim.printed_text or limits_text(claim),
        **{key: shown[key] for key in ("ours", "se", "low", "high", "unit", "shows")},
        "verdict": word,
        "flips": _flips_together(claim, word, own),
        "reason": "; ".join(filter(None, [explained, *reasons])),
        "readings": _counted(own) if len(own) > 1 else "",
        "robustness": _counted([row for row in found if row["robustness"]]),
        "chosen": claim.chosen,
        "needed": max(needed, default=math.nan),
        "basis": item.basis,
        "counts": claim.judged,
    }


def _reasons(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """The distinct reasons of the readings; of what would decide them, the one that needs most."""
    undecided = [row for row in rows if row["needed"] == row["needed"]]
    most = max(undecided, key=lambda row: row["needed"], default=None)
    kept = [row for row in rows if row is most or row["needed"] != row["needed"]]
    return list(dict.fromkeys(row["reason"] for row in kept if row["reason"]))


def _unjudged(claim: Claim, ours: Estimate) -> str:
    """Why a claim is not judged; for a target of a fit with its misfit."""
    if claim.kind == "fitted" and claim.printed is not None and claim.tolerance:
        misfit = abs(ours.value - claim.printed) / claim.tolerance
        return f"{CLASSES['fitted']}, missed by {misfit:.2g} tolerances"
    return claim.not_judged or claim.reason or CLASSES[claim.kind]


def _undecided(ours: Estimate, found: verdict.Judgement, count: float, item: Item) -> str:
    """What would decide an undecided reading, whose number rests on `count` units of an item."""
    if math.isnan(ours.se):
        return "too few cases for a standard error"
    if not math.isfinite(found.more):
        return "on the limit" if found.more == math.inf else "unknown interval"
    if found.more <= 1:
        return "across the limit"
    times, needed = (significant(number, 2) for number in (found.more, found.more * count))
    known = count == count and item.counts == "replications"
    count_text = f", N = {needed}" if known else ""
    study_count = count if math.isnan(item.paper_reps) else item.paper_reps
    beyond = found.more * count > BEYOND * study_count
    apart = ": beyond ten times the study's" if beyond else ""
    return f"{times} times the {item.counts} would decide{count_text}{apart}"


def _flips(claim: Claim, word: str, ends: tuple[float, float], where: str = "") -> str:
    """For which limits a statement with this verdict holds, given `ends` as in Judgement.flips and
    the readings in words; "" if the paper sets the limits.
    """
    if claim.kind != "statement" or claim.chosen == "paper":
        return ""
    low, high = (f"{significant(end, 3)} {claim.unit}".rstrip() for end in ends)
    limits = claim.limits(0.0)
    holds = ("holds" if word == HOLDS else "would hold") + where
    if math.isinf(limits.high):
        return f"{holds} for any limit below {low}"
    if math.isinf(limits.low):
        return f"{holds} for any limit above {high}"
    return f"{holds} for any limits around {low} to {high}"


def _flips_together(claim: Claim, word: str, rows: Sequence[Mapping[str, Any]]) -> str:
    """For which limits a statement holds in every judged reading, whose rows are given."""
    ends = [row["ends"] for row in rows if row["verdict"] != NOT_JUDGED]
    if not ends:
        return ""
    hull = min(low for low, _ in ends), max(high for _, high in ends)
    return _flips(claim, word, hull, " in every reading" if len(ends) > 1 else "")


def limits_text(claim: Claim) -> str:
    """The limits of a statement as text, e.g. "> 0 %"; "" without any."""
    signs = {"above": ">", "at_least": "≥", "below": "<", "at_most": "≤"}
    given = [(sign, getattr(claim, key)) for key, sign in signs.items()]
    texts = [f"{sign} {value:g}" for sign, value in given if value is not None]
    return " and ".join(texts) + (f" {claim.unit}" if texts and claim.unit else "")


def _counted(rows: Sequence[Mapping[str, Any]]) -> str:
    """In how many readings a claim has which verdict, e.g. "holds in 1 of 2: independent; fails in
    1 of 2: common"; without their names where these are more than NAMED.
    """
    groups = {word: [r["reading"] for r in rows if r["verdict"] == word] for word in WORDS}
    texts = [
        f"{word} in {len(names)} of {len(rows)}"
        + (f": {', '.join(names)}" if len(rows) <= NAMED else "")
        for word, names in groups.items()
        if names
    ]
    return "; ".join(texts)


def headline(claims: pd.DataFrame) -> str:
    """How many of the statements that can fail hold, depend on the reading, fail or are open."""
    judged = claims[claims["counts"].astype(bool)]
    counts = judged["verdict"].value_counts()
    texts = {  # for one, and for several
        HOLDS: ("holds in every reading", "hold in every reading"),
        DEPENDS: ("depends on what the paper leaves open", "depend on what the paper leaves open"),
        FAILS: ("fails", "fail"),
        UNDECIDED: ("is undecided", "are undecided"),
        NOT_JUDGED: ("is not judged at this scale", "are not judged at this scale"),
    }
    always = (HOLDS, DEPENDS, FAILS)
    found = {word: int(counts.get(word, 0)) for word in texts}
    parts = [f"{n} {texts[w][n != 1]}" for w, n in found.items() if n or w in always]
    return f"of {len(judged)} statements that can fail, {', '.join(parts[:-1])} and {parts[-1]}"
