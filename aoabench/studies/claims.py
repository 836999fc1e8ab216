"""The verdicts on all printed numbers and claims, from the stored tables."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from aoabench.errors import UserError
from aoabench.maths.statistics import Estimate
from aoabench.studies import verdict as verdict_module
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
from aoabench.report.text import number_text, printed_text
from aoabench.studies.reading import read
from aoabench.studies.study import Study

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
        found: dict[str, tuple[Estimate, float]] = {}
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


def _judge(
    study: Study, entry: dict[str, Any], found: dict[str, tuple[Estimate, float]]
) -> dict[str, Any]:
    if entry["item"] not in {item.name for item in study.items}:
        raise UserError(
            f"{study.folder / 'printed.yaml'}: {entry['id']}: "
            f"item {entry['item']!r} is not in study.yaml"
        )
    ours, samples = found.get(entry["id"], (None, float("nan")))
    claim = "claim" in entry
    limits: Any = entry.get("printed")
    if claim:
        low, high = entry["claim"]
        limits = (
            float("-inf") if low is None else float(low),
            float("inf") if high is None else float(high),
        )
    sampling = 0.0
    if ours is not None and "printed_samples" in entry and samples == samples:
        sampling = ours.se * (samples / entry["printed_samples"]) ** 0.5
    group = [e for e in study.printed if e.get("group") and e.get("group") == entry.get("group")]
    theirs = [found[e["id"]][0].value for e in group if e["id"] in found]
    in_kind = (
        bool(group)
        and len(theirs) == len(group)
        and same_order([e["printed"] for e in group], theirs)
    )
    strict, z, rounding = (
        entry.get("strict", False),
        entry.get("z", 3.0),
        entry.get("rounding", 0.0),
    )
    verdict = verdict_module.verdict(
        limits, rounding, ours, printed_se=sampling, in_kind=in_kind, strict=strict, z=z
    )
    reason = entry.get("reason", "") if verdict in (NOT_REPRODUCIBLE, IN_KIND) else ""
    if ours is not None and ours.value == ours.value and ours.se != ours.se:
        reason = "too few cases to tell a standard error"
    if ours is not None and limits is not None and verdict != NOT_COMPUTED:
        doubt = undecided(limits, rounding, ours, strict=strict, z=z)
        if doubt:
            reason = doubt
            verdict = NOT_REPRODUCIBLE if verdict == REPRODUCED else verdict
    if ours is not None and "tie" in entry and abs(ours.value) + z * ours.se <= entry["tie"]:
        verdict, reason = (
            IN_KIND,
            f"a tie: within ± {entry['tie']:g} {entry.get('unit', '')}".strip(),
        )
    return {
        "study": study.name,
        "item": entry["item"],
        "id": entry["id"],
        "what": entry["what"],
        "printed": entry.get("says", "")
        if claim
        else printed_text(limits, entry.get("rounding", 0.0)),
        "ours": float("nan") if ours is None else ours.value,
        "se": float("nan") if ours is None else ours.se,
        "unit": entry.get("unit", ""),
        "verdict": verdict,
        "reason": reason,
        "claim": claim,
    }


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
    total += f" ({open_} of these undecided: more replications would tell)" if open_ else ""
    return "\n".join(
        [
            lines[0],
            "-" * len(lines[0]),
            *lines[1:],
            "",
            f"{len(rows)} printed numbers and claims: {total}",
        ]
    )
