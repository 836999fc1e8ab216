"""The verdicts as text for a terminal of 100 columns: one screen, and the list of all claims."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from itertools import zip_longest
from typing import TYPE_CHECKING, Any

from aoabench.report.text import interval_text
from aoabench.studies.claims import Limits
from aoabench.studies.statements import Verdicts, headline
from aoabench.studies.study import Study
from aoabench.studies.verdict import DEPENDS, FAILS, HOLDS, NOT_JUDGED, UNDECIDED

if TYPE_CHECKING:
    import pandas as pd

WIDTH = 100
MOST = 5  # claims that the screen names
_ORDER = (FAILS, DEPENDS, UNDECIDED, HOLDS)  # by how much a reader wants to know of them
_COUNTED = (HOLDS, DEPENDS, FAILS, UNDECIDED, NOT_JUDGED)


def screen(verdicts: Verdicts, studies: Sequence[Study]) -> str:
    """At most 20 lines: how many claims hold, depend, fail and are open in each study, and the most
    interesting ones.
    """
    counted = verdicts.claims[verdicts.claims["counts"].astype(bool)]
    if not len(counted):
        return "no claims that can fail"
    lines = [*_counts(counted), ""]
    named = list(_interesting(verdicts, studies))
    if named:
        lines.append("most interesting (of each study first what fails by most standard errors):")
        lines += [line for row in named for line in _two_lines(row)]
    return "\n".join(lines).rstrip()


def _counts(counted: pd.DataFrame) -> Iterator[str]:
    """A table of the verdicts by study."""
    groups = {str(name): part for name, part in counted.groupby("study", sort=False)}
    if len(groups) > 1:
        groups["all"] = counted
    yield f"{'claims that can fail':22}" + "".join(f"{word:>12}" for word in _COUNTED)
    for name, part in groups.items():
        found = part["verdict"].value_counts()
        yield f"{name:22}" + "".join(f"{found.get(word, 0):>12}" for word in _COUNTED)


def _interesting(verdicts: Verdicts, studies: Sequence[Study]) -> list[dict[Any, Any]]:
    """At most MOST readings of judged claims that can fail: from each study in turn, those that
    fail or depend before the others, and among equals by their distance from the limit in standard
    errors.
    """
    known = {(s.name, c.id): c for s in studies for c in s.claims}
    counted = verdicts.claims[verdicts.claims["counts"].astype(bool)].set_index(["study", "id"])
    best: dict[tuple[str, str], dict[Any, Any]] = {}
    for row in verdicts.readings.to_dict("records"):
        key = (row["study"], row["id"])
        if key not in counted.index or row["robustness"] or row["verdict"] == NOT_JUDGED:
            continue
        claim, word = known[key], counted.loc[key, "verdict"]
        away = distance(claim.limits(0.0), row["ours"], row["se"])
        rank = (_ORDER.index(word), row["verdict"] != FAILS, -away)
        if key not in best or rank < best[key]["rank"]:
            best[key] = {**row, "rank": rank, "what": claim.what, "verdict": word}
            best[key]["printed"] = counted.loc[key, "printed"]
    by_study = [
        sorted((r for r in best.values() if r["study"] == s.name), key=lambda r: r["rank"])
        for s in studies
    ]
    turns = [row for turn in zip_longest(*by_study) for row in turn if row]
    return sorted(turns[:MOST], key=lambda row: row["rank"])


def distance(limits: Limits, value: float, se: float) -> float:
    """How many standard errors a number lies from the nearest finite limit; infinite for one
    without error that is not on it.
    """
    ends = [end for end in (limits.low, limits.high) if math.isfinite(end)]
    away = min((abs(value - end) for end in ends), default=0.0)
    if math.isnan(away) or math.isnan(se):
        return 0.0
    return away / se if se > 0 else math.inf if away > 0 else 0.0


def _two_lines(row: Mapping[Any, Any]) -> list[str]:
    """A claim as two lines: its verdict and words; printed, ours and reading."""
    reading = f" ({row['reading']})" if row["reading"] else ""
    first = f"  {row['verdict']:10}{row['study']} {row['item']}: {row['what']}"
    second = f"{'':12}{_numbers(row)}{reading}"
    return [line if len(line) <= WIDTH else f"{line[: WIDTH - 4]} ..." for line in (first, second)]


def _numbers(row: Mapping[Any, Any]) -> str:
    """Printed value or claimed limits, and ours with its interval."""
    ours = f"ours {interval_text(row['ours'], row['low'], row['high'])} {row['unit']}".strip()
    if not row["printed"]:
        return ours
    limits = row["printed"].startswith(("<", ">", "≤", "≥"))
    return f"{'claimed' if limits else 'printed'} {row['printed']}, {ours}"


def everything(claims: pd.DataFrame) -> str:
    """All claims by study: verdict, words, numbers and reason, in lines of WIDTH columns."""
    lines: list[str] = []
    for study, part in claims.groupby("study", sort=False):
        lines += [str(study), "-" * len(str(study))]
        for row in part.to_dict("records"):
            more = "; ".join(filter(None, [_numbers(row), row["readings"], row["reason"]]))
            head = f"{row['verdict']:11} {row['item']}: {row['what']}"
            lines += textwrap.wrap(head, WIDTH, subsequent_indent=" " * 12)
            lines += textwrap.wrap(more, WIDTH, initial_indent=" " * 12, subsequent_indent=" " * 12)
        lines.append("")
    return "\n".join([*lines, *textwrap.wrap(headline(claims), WIDTH)])
