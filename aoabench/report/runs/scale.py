"""How much was computed for a figure, in words for its foot."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import Any

from aoabench.report.runs.source import Source

# (experiment, config of a cell, number of replications, whether a precision that until.* required
# was reached) -> "paper", "quick", or "" for neither
ScaleOf = Callable[[str, Mapping[str, Any], int, bool], str]
_OWN = "own"  # a scale that is neither quick nor paper


def scale_text(source: Source, scale_of: ScaleOf | None) -> str:
    """The scale of the cells that belong to experiments ("paper scale"), and whether the precision
    that until.* required was reached; "" where neither is known.
    """
    return "; ".join(filter(None, (_scales(source, scale_of), _precision(source))))


def _scales(source: Source, scale_of: ScaleOf | None) -> str:
    if scale_of is None or not source.configs:
        return ""
    some = source.frame[source.frame["experiment"].notna()]
    found = set()
    for cell in some["cell"].unique().tolist():
        mine = some[some["cell"] == cell]
        count = mine.groupby("estimator").size().min()
        experiment = mine["experiment"].iloc[0]
        asked = [entry.get("precision") for entry in source.entries[cell].values()]
        reached = all(one and one["reached"] for one in asked)
        config = json.loads(source.configs[cell])
        found.add(scale_of(experiment, config, int(count), reached) or _OWN)
    return f"{' and '.join(sorted(found))} scale" if found else ""


def _precision(source: Source) -> str:
    pairs = source.pairs()[["cell", "estimator"]].itertuples(index=False)
    entries = [source.entries[cell][name] for cell, name in pairs if cell in source.entries]
    asked = [entry["precision"] for entry in entries if entry.get("precision")]
    if not asked:
        return ""
    short = sum(not one["reached"] for one in asked)
    what = f"not reached by {short} of {len(asked)} estimators" if short else "reached"
    return f"precision of until {what}"
