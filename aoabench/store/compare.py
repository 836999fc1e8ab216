"""Paired comparison of a run's estimators: each line states a difference and its uncertainty.

A pair is one replication: all estimators get the same draws in it. Where replications share their
positions, RMSE and iterations are clustered by position, as in the summary. p-values are adjusted
by Holm's method for all comparisons of the table.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from aoabench.columns import REPLICATIONS
from aoabench.errors import RunError, UserError, did_you_mean
from aoabench.maths import intervals, statistics
from aoabench.maths.statistics import Paired
from aoabench.store import tables
from aoabench.store.clusters import CLUSTERED
from aoabench.store.comparison import FAILURES, Comparison
from aoabench.store.fixes import influences_of
from aoabench.store.parts import intact_parts

if TYPE_CHECKING:
    import pandas as pd

Entries = Mapping[str, Mapping[str, Any]]  # of a cell's record, by estimator
METRICS = (
    *(c for c, kind in REPLICATIONS.items() if kind == "double"),
    FAILURES,
    *(c for c in REPLICATIONS if c.startswith("n_")),
)
IDENTITY = ("cell", "scenario", "noise")
COLUMNS = (
    "metric",
    "estimator",
    "baseline",
    "n",
    "of",
    "mean",
    "baseline_mean",
    "change",
    "change_low",
    "change_high",
    "unit",
    "p",
    "p_holm",
    "by",
    "units",
    "verdict",
    "needed",
    "heavy_tail",
    "text",
)


def compare(
    run: str | os.PathLike[str], baseline: str | None = None, metric: str = "rmse_3d_m"
) -> pd.DataFrame:
    """Return a row per cell and estimator of a run, compared with the estimator `baseline` (None:
    the one with the smallest mean in each cell).

    Columns: cell, scenario, noise, the parameters that differ between cells; metric, estimator,
    baseline; n pairs of `of` replications; mean, baseline_mean; change (of the mean against the
    baseline's, in `unit`: %, percentage points, or the metric's own) with its 95 % interval
    change_low, change_high; p, p_holm; verdict; by (the independent unit: replication or position)
    and units (their number); needed (units needed to detect 1 % with probability 0.8); heavy_tail
    (of an RMSE: whether the summary flags one of the two estimators); text (the line).

    Where the data pick the baseline, Holm's method counts all pairs of a cell, printed or not.
    Raises UserError for a run, metric or baseline that does not exist, and RunError if parts that
    the intervals need are missing.
    """
    import pandas as pd

    shown = tables.shown(run, "tidy", "cells", "summary", "index")
    entries = dict(zip(shown["index"]["cell"], map(json.loads, shown["index"]["estimators"])))
    frame = _replications(shown["tidy"], baseline, metric)
    fixed = {*REPLICATIONS, "seed", FAILURES}
    varied = [c for c in frame.columns if c not in fixed and frame[c].nunique(dropna=False) > 1]
    by_cell = dict(list(frame.groupby("cell")))
    shared = set(shown["summary"].query("se_by == 'position'")["cell"])
    rows: list[tuple[dict[str, Any], Comparison]] = []
    left_out: dict[str, str] = {}  # cells without a comparison, and why
    unprinted: list[float] = []  # p-values of the other pairs, where the data pick the baseline
    for cell in shown["cells"]["cell"]:
        mine = by_cell[cell]
        names = mine["estimator"].unique()
        if len(names) < 2 or (baseline is not None and baseline not in names):
            left_out[cell] = (
                f"{names[0]} is its only estimator"
                if len(names) < 2
                else f"{baseline} is not among its estimators"
            )
            continue
        clustered = cell in shared and metric in CLUSTERED
        found, others = _of_cell(Path(run), entries[cell], mine, baseline, metric, clustered)
        first = {c: mine[c].iloc[0] for c in (*IDENTITY, *varied)}
        rows += [(first, comparison) for comparison in found]
        unprinted += others
    p = np.array([*(c.pair.p_value for _, c in rows), *unprinted], dtype=float)
    comparisons = int(np.isfinite(p).sum())
    adjusted = intervals.holm(p)[: len(rows)]
    table = pd.DataFrame(
        [first | c.row(float(p), comparisons) for (first, c), p in zip(rows, adjusted)],
        columns=[*IDENTITY, *varied, *COLUMNS],
    )
    table = table.astype({"p_holm": float, "verdict": object, "needed": float, "text": object})
    table["heavy_tail"] = _heavy_tails(table, shown["summary"])
    table.attrs |= {"comparisons": comparisons, "left_out": left_out}
    return _with_non_causal(table, shown["summary"])


def _with_non_causal(table: pd.DataFrame, summary: pd.DataFrame) -> pd.DataFrame:
    """The table with the attribute `non_causal`: the names of the estimators that the summary marks
    so; none in tables of before.
    """
    causal = summary["causal"].astype(bool) if "causal" in summary else None
    late = [] if causal is None else summary["estimator"][~causal].unique().tolist()
    table.attrs["non_causal"] = late
    return table


def _heavy_tails(table: pd.DataFrame, summary: pd.DataFrame) -> list[bool]:
    """Whether the summary flags an estimator of each row's comparison, whose metric is an RMSE."""
    heavy = summary["heavy_tail"] if "heavy_tail" in summary else [False] * len(summary)
    found = {pair for pair, flag in zip(zip(summary["cell"], summary["estimator"]), heavy) if flag}
    return [
        metric.startswith("rmse") and not found.isdisjoint([(cell, a), (cell, b)])
        for cell, metric, a, b in zip(*(table[n] for n in ("cell", *COLUMNS[:3])))
    ]


def _replications(frame: pd.DataFrame, baseline: str | None, metric: str) -> pd.DataFrame:
    """The replications of a run (see `tables.load`), with a column for failures; UserError for an
    unknown metric or baseline.
    """
    if metric not in METRICS:
        hint = did_you_mean(metric, METRICS) or f"; allowed: {', '.join(METRICS)}"
        raise UserError(f"metric={metric}: no such metric{hint}")
    names = list(frame["estimator"].unique())
    if baseline is not None and baseline not in names:
        hint = did_you_mean(baseline, names) or f"; allowed: {', '.join(names)}"
        raise UserError(f"baseline={baseline}: not in this run{hint}")
    return with_failures(frame)


def with_failures(frame: pd.DataFrame) -> pd.DataFrame:
    """The replications with the column failure_rate added: 1 where a fix failed or diverged, else
    0.
    """
    frame[FAILURES] = frame["outcome"].isin(["failed", "diverged"]).astype(float)
    return frame


def _of_cell(
    run: Path,
    entries: Entries,
    rows: pd.DataFrame,
    baseline: str | None,
    metric: str,
    clustered: bool,
) -> tuple[list[Comparison], list[float]]:
    """The comparisons with the baseline, in the order of the means; if the data pick the baseline,
    also the p-values of the other pairs.
    """
    wide = rows.pivot(index="replication", columns="estimator", values=metric)
    means = wide.mean().sort_values()  # those without any value come last
    base = str(means.index[0]) if baseline is None else baseline
    pair_up = _pairing(run, entries, wide, metric, clustered)
    others = [name for name in means.index if name != base]
    found = [
        Comparison(metric, name, base, len(wide), means[name], means[base], *pair_up(name, base))
        for name in others
    ]
    pairs = combinations(others, 2) if baseline is None else ()
    return found, [pair_up(a, b)[0].p_value for a, b in pairs]


def _pairing(
    run: Path, entries: Entries, wide: pd.DataFrame, metric: str, clustered: bool
) -> Callable[[str, str], tuple[Paired, str]]:
    """A function that compares two columns of `wide`; it returns the result and its independent
    unit.
    """
    known: dict[tuple[str, bytes], np.ndarray] = {}

    def influence(name: str, kept: np.ndarray) -> np.ndarray:
        key = name, kept.tobytes()
        if key not in known:
            entry = entries[name]
            found = influences_of(run, entry, intact_parts(run, entry["key"]), kept, metric)
            if found is None:
                raise RunError(
                    f"{run}: the fixes of {name} in part {entry['key']} are missing; "
                    "run the same command again"
                )
            known[key] = found
        return known[key]

    def pair_up(a: str, b: str) -> tuple[Paired, str]:
        both = wide[[a, b]].dropna()
        if metric == FAILURES:
            return statistics.paired_rate(both[a] > 0, both[b] > 0), "replication"
        if not clustered or both.empty:
            return statistics.paired(both[a], both[b]), "replication"
        kept = both.index.to_numpy()
        return statistics.paired(
            both[a], both[b], (influence(a, kept), influence(b, kept))
        ), "position"

    return pair_up
