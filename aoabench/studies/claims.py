"""The verdicts on all printed numbers and claims, from the stored tables."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from aoabench.errors import UserError
from aoabench.maths.statistics import Estimate
from aoabench.report.text import number_text, printed_text
from aoabench.studies import verdict as verdict_module
from aoabench.studies.reading import read
from aoabench.studies.study import Study
from aoabench.studies.verdict import (
    IN_KIND,
    NOT_COMPUTED,
    NOT_REPRODUCIBLE,
    REPRODUCED,
    same_order,
    undecided,
)

if TYPE_CHECKING:
    import pandas as pd

Found = dict[str, tuple[Estimate, float]]  # our numbers by id, with the samples behind each
VERDICT_COLUMNS = (
    "study",
    "item",
    "id",
    "what",
    "printed",
    "ours",
    "se",
    "unit",
    "verdict",
    "reason",
    "claim",
)


def verdicts(studies: list[Study], results: Path) -> pd.DataFrame:
    """A row for each printed number and claim of the studies, its verdict computed from the stored
    tables.
    """
    import pandas as pd

    rows = []
    for study in studies:
        found: Found = {}
        problems = {}
        for item in study.items:
            reading = read(study, item, results)
            found |= reading.values
            problems[item.name] = reading.problem
        for entry in study.printed:
            row = _judge(study, entry, found)
            unread = row["verdict"] == NOT_COMPUTED and problems[entry["item"]]
            rows.append({**row, "reason": problems[entry["item"]]} if unread else row)
    return pd.DataFrame(rows, columns=list(VERDICT_COLUMNS))


def _judge(study: Study, entry: dict[str, Any], found: Found) -> dict[str, Any]:
    """The row of one printed number or claim; UserError if its item is not in study.yaml."""
    if entry["item"] not in {item.name for item in study.items}:
        raise UserError(
            f"{study.folder / 'claims.yaml'}: {entry['id']}: "
            f"item {entry['item']!r} is not in study.yaml"
        )
    ours, samples = found.get(entry["id"], (None, math.nan))
    verdict, reason = _decide(entry, ours, samples, _in_kind(study, entry, found))
    claim = "claim" in entry
    number = printed_text(entry.get("printed"), entry.get("rounding", 0.0))
    return {
        "study": study.name,
        "item": entry["item"],
        "id": entry["id"],
        "what": entry["what"],
        "printed": entry.get("says", "") if claim else number,
        "ours": math.nan if ours is None else ours.value,
        "se": math.nan if ours is None else ours.se,
        "unit": entry.get("unit", ""),
        "verdict": verdict,
        "reason": reason,
        "claim": claim,
    }


def _decide(
    entry: dict[str, Any], ours: Estimate | None, samples: float, in_kind: bool
) -> tuple[str, str]:
    """Verdict on our number, which rests on `samples` samples (NaN: none), and the reason."""
    printed, rounding = _printed(entry), entry.get("rounding", 0.0)
    strict, z = entry.get("strict", False), entry.get("z", 3.0)
    se = _printed_se(entry, ours, samples)
    verdict = verdict_module.verdict(
        printed, rounding, ours, printed_se=se, in_kind=in_kind, strict=strict, z=z
    )
    if ours is None or math.isnan(ours.value):
        return verdict, ""
    if math.isnan(ours.se):
        return verdict, "too few cases for a standard error"
    reason = entry.get("reason", "") if verdict in (NOT_REPRODUCIBLE, IN_KIND) else ""
    doubt = undecided(printed, rounding, ours, strict=strict, z=z) if printed is not None else ""
    if doubt:
        verdict, reason = NOT_REPRODUCIBLE if verdict == REPRODUCED else verdict, doubt
    if "tie" in entry and abs(ours.value) + z * ours.se <= entry["tie"]:
        unit = entry.get("unit", "")
        return IN_KIND, f"a tie: within ± {entry['tie']:g} {unit}".strip()
    return verdict, reason


def _printed(entry: dict[str, Any]) -> float | tuple[float, float] | None:
    """The printed number, the interval (low, high) that the paper claims, or None for neither."""
    if "claim" not in entry:
        return entry.get("printed")
    low, high = entry["claim"]
    return -math.inf if low is None else float(low), math.inf if high is None else float(high)


def _printed_se(entry: dict[str, Any], ours: Estimate | None, samples: float) -> float:
    """Monte Carlo error of the printed number: ours at the paper's samples; 0 if unknown."""
    if ours is None or "printed_samples" not in entry or math.isnan(samples):
        return 0.0
    return ours.se * (samples / entry["printed_samples"]) ** 0.5


def _in_kind(study: Study, entry: dict[str, Any], found: Found) -> bool:
    """Whether our numbers of the entry's group stand in the order of the printed ones."""
    group = [e for e in study.printed if e.get("group") and e.get("group") == entry.get("group")]
    ours = [found[e["id"]][0].value for e in group if e["id"] in found]
    if not group or len(ours) < len(group):
        return False
    return same_order([e["printed"] for e in group], ours)


def verdict_text(rows: pd.DataFrame) -> str:
    """The verdicts as lines for a terminal."""
    if not len(rows):
        return "no printed numbers"
    shown = [
        (
            r["study"],
            r["item"],
            r["what"],
            r["printed"],
            f"{number_text(r['ours'], r['se'])} {r['unit']}".strip(),
            r["verdict"] + (" (undecided)" if r["reason"].startswith("undecided") else ""),
        )
        for r in rows.to_dict("records")
    ]
    head = ("study", "item", "quantity", "printed", "ours ± s.e.", "verdict")
    widths = [max(len(str(line[i])) for line in [head, *shown]) for i in range(len(head))]
    lines = [
        "  ".join(str(cell).ljust(w) for cell, w in zip(line, widths)).rstrip()
        for line in [head, *shown]
    ]
    counts = rows["verdict"].value_counts()
    open_ = int(rows["reason"].str.startswith("undecided").sum())
    total = ", ".join(f"{n} {verdict}" for verdict, n in counts.items())
    total += f" ({open_} of these undecided: more replications are needed)" if open_ else ""
    return "\n".join(
        [
            lines[0],
            "-" * len(lines[0]),
            *lines[1:],
            "",
            f"{len(rows)} printed numbers and claims: {total}",
        ]
    )
