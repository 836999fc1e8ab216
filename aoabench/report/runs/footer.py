"""The sentences at the foot of a figure of a run: how many replications, of what, and what the
marks are.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from aoabench.report.runs.choice import Choice
from aoabench.report.runs.look import HEAVY
from aoabench.report.runs.metrics import ERRORS
from aoabench.report.runs.source import Source, ordered, value_text
from aoabench.store.clusters import CLUSTERED

if TYPE_CHECKING:
    import pandas as pd

MARKS = {
    "cdf": "Bands: 95 % intervals of each point alone, {units}.",
    "box": "Boxes: median, 25 to 75 %; whiskers: 5 to 95 %; asterisks: minimum and maximum.",
    "violin": "Violins: density; bars: 25 to 75 %; dots: median.",
    "curve": "Bars: 95 % intervals of each point alone, {units}.",
    "pairs": "A point is a replication; below the diagonal its value is smaller than that of "
    "{base}. Brackets: 95 % interval of the change of the mean against {base}, {units}, as in "
    "`aoabench compare`.",
}
_MOST_NAMED = 5  # estimators
_MOST_VALUES = 3  # of a name


def about(source: Source, fixes: pd.DataFrame | None = None) -> list[str]:
    """The number of replications, and of fixes from a table of their quantiles; what was simulated
    or recorded, and with which seed.
    """
    frame = source.frame
    counts = frame.groupby(["cell", "estimator"]).size()
    several = frame["cell"].nunique() > 1
    place = "tag" if source.tracks else "cell"
    many = f" ({_span(fixes['of'])} fixes)" if fixes is not None else ""
    each = f"each estimator and {place}" if several else "each estimator"
    recorded = source.recorded == "recorded"
    noun = ("track" if recorded else "replication") + ("" if counts.max() == 1 else "s")
    parts = [f"N = {_span(counts)} {noun}{many} of {each}"]
    parts += [source.scale, source.recorded] if source.scale else [source.recorded]
    for name in ("experiment",) if recorded else ("scenario", "noise", "seed", "experiment"):
        values = [value_text(value) for value in ordered(frame[name])]
        if len(values) <= _MOST_VALUES and values != ["null"]:
            parts.append(f"{name} {', '.join(values)}")
    return ["; ".join(parts) + "."]


def _span(counts: pd.Series) -> str:
    low, high = int(counts.min()), int(counts.max())
    return f"{low:,}" if low == high else f"{low:,} to {high:,}"


def units(source: Source, metric: str) -> str:
    """What the intervals of a metric take as independent units."""
    own = metric in source.frame and metric not in CLUSTERED
    if source.tracks and metric in ERRORS:
        return "clustered by position"
    if source.summary is None or own or metric.startswith("rmse_q50"):
        return "over replications"
    by = set(source.summary["se_by"])
    words = {"position": "clustered by position", "replication": "over replications"}
    return " or ".join(words[name] for name in sorted(by, reverse=True))


def bands(points: pd.DataFrame, text: str) -> str:
    """What the bands are, or why there are none."""
    none = "No bands: they need two replications, or positions that replications share."
    return none if points["low"].isna().all() else text


def axis(log: bool, below: int, above: int, cdf: bool) -> Iterator[str]:
    """The kind of axis, and the number of values beyond its ends; those to the left of a
    distribution function are in its line.
    """
    if log:
        yield (
            f"Logarithmic axis, as the largest 95 % quantile exceeds {HEAVY:g} times the smallest "
            "median."
        )
    if above:
        yield f"{above:,} value{'s lie' if above > 1 else ' lies'} beyond the axis."
    if below and not cdf:
        yield f"{below:,} value{'s are' if below > 1 else ' is'} 0 and not shown."


def over_time(apart: bool, spans: int) -> str:
    """What lines and bands of errors over time are; `spans`: the number of steps of a point."""
    several = f"the {spans} steps of each point" if spans > 1 else ""
    if apart:
        return f"A line is a track of the recording{', median over ' * bool(several)}{several}."
    what = f"replications{' and ' * bool(several)}{several}"
    return f"Lines: median over {what}; bands: 5 to 95 % of them."


def bars(means: pd.DataFrame) -> Iterator[str]:
    """Why intervals are missing."""
    known = np.isfinite(means[["low", "high"]].to_numpy(dtype=float)).all(axis=1)
    lack = int((~known & np.isfinite(means["value"].to_numpy(dtype=float))).sum())
    if lack:
        yield f"{lack} of {len(means)} points have no interval: too few replications."


def left_out(choice: Choice) -> list[str]:
    """The sentence about panels that are not drawn, if any."""
    return [choice.left_out] if choice.left_out else []


def without(table: pd.DataFrame, what: str) -> Iterator[str]:
    """The estimators with fewer values than fixes or replications."""
    short = table[table["n"] < table["of"]]
    sums = short.groupby(["group"], sort=False)[["n", "of"]].sum()
    if len(sums):
        named = [f"{name} {of - n:,} of {of:,}" for name, n, of in sums.itertuples()]
        more = f" and {len(named) - _MOST_NAMED} more" * (len(named) > _MOST_NAMED)
        yield f"{what.capitalize()} without a value: {', '.join(named[:_MOST_NAMED])}{more}."
