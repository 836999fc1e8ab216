"""Paired comparison of the estimators of a run: a table in which every line says what was seen, and
how surely.

Pairs are replications, which all estimators see with the same draws. Where replications share their
positions, RMSE and iterations are clustered by position, as in the summary. p-values are adjusted
by Holm's method for all comparisons of the table.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Mapping
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from aoabench.columns import REPLICATIONS
from aoabench.errors import RunError, UserError, did_you_mean
from aoabench.maths import intervals, statistics
from aoabench.maths.statistics import Paired
from aoabench.store import tables
from aoabench.store.fixes import clusters
from aoabench.store.summary import CLUSTERED

if TYPE_CHECKING:
    import pandas as pd


LEVEL = 0.05  # of all claims of a table together; intervals are 95 % ones, each by itself


FAILURES = "failure_rate"


METRICS = (
    *(c for c, kind in REPLICATIONS.items() if kind == "double"),
    FAILURES,
    *(c for c in REPLICATIONS if c.startswith("n_")),
)


IDENTITY = ("cell", "scenario", "noise")


NONE_SEEN, EQUAL, TOO_FEW, NO_VALUES = "no difference seen", "equal", "too few", "no values"


def compare(
    run: str | os.PathLike[str], baseline: str | None = None, metric: str = "rmse_3d_m"
) -> pd.DataFrame:
    """A row per estimator and cell of a run, compared with `baseline` (none: the smallest mean of
    each cell).

    Columns: cell, scenario, noise, what differs between cells; metric, estimator, baseline; n pairs
    of `of` replications; mean, baseline_mean; change (of the mean against the baseline's, in
    `unit`: %, percentage points, or the metric's own) with its 95 % interval change_low,
    change_high; p, p_holm; verdict; by (what is taken as independent) and units (how many); needed
    (units that would show 1 %, with probability 0.8); text (the line).

    Where the data pick the baseline, Holm's method counts all pairs of a cell, printed or not.
    Raises UserError for a run, metric or baseline that is not there, and RunError where parts have
    vanished that the intervals need.
    """
    import pandas as pd

    frame = tables.load(run)
    if metric not in METRICS:
        hint = did_you_mean(metric, METRICS) or f"; allowed: {', '.join(METRICS)}"
        raise UserError(f"metric={metric}: no such metric{hint}")
    names = list(frame["estimator"].unique())
    if baseline is not None and baseline not in names:
        hint = did_you_mean(baseline, names) or f"; allowed: {', '.join(names)}"
        raise UserError(f"baseline={baseline}: not in this run{hint}")
    frame[FAILURES] = frame["outcome"].isin(["failed", "diverged"]).astype(float)
    fixed = {*REPLICATIONS, "seed", FAILURES}
    varied = [c for c in frame.columns if c not in fixed and frame[c].nunique(dropna=False) > 1]
    order = pd.read_parquet(Path(run) / "cells.parquet", columns=["cell"])["cell"]
    by_cell = dict(list(frame.groupby("cell")))
    summary = pd.read_parquet(Path(run) / "summary.parquet", columns=["cell", "se_by"])
    shared = set(summary["cell"][summary["se_by"] == "position"])
    rows: list[dict[str, Any]] = []
    left_out: dict[str, str] = {}  # cells without a comparison, and why
    unprinted: list[float] = []  # p-values of pairs that were looked at to pick the baseline
    for cell in order:
        mine = by_cell[cell]
        first = {c: mine[c].iloc[0] for c in (*IDENTITY, *varied)}
        here = mine["estimator"].unique()
        if len(here) < 2 or (baseline is not None and baseline not in here):
            left_out[cell] = f"only {here[0]}" if len(here) < 2 else f"no {baseline}"
            continue
        for row in _of_cell(Path(run), cell, mine, baseline, metric, cell in shared):
            if "estimator" in row:
                rows.append({**first, "metric": metric, **row})
            else:
                unprinted.append(row["p"])
    table = pd.DataFrame(rows, columns=[*IDENTITY, *varied, *COLUMNS])
    p = np.array([*table["p"], *unprinted], dtype=float)
    table["p_holm"] = intervals.holm(p)[: len(table)]
    comparisons = int(np.isfinite(p).sum())
    said = [_judge(row, comparisons) for row in table.to_dict("records")]
    table[["verdict", "needed", "text"]] = pd.DataFrame(
        said, columns=["verdict", "needed", "text"], dtype=object
    )
    table["needed"] = table["needed"].astype(float)
    table.attrs |= {"comparisons": comparisons, "left_out": left_out}
    return table.drop(columns="pair")


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
    "pair",
)


def _of_cell(
    run: Path, cell: str, rows: pd.DataFrame, baseline: str | None, metric: str, shared: bool
) -> Iterator[dict[str, Any]]:
    """The comparisons with the baseline, by their means; then, of a baseline that the data pick,
    the other pairs.
    """
    wide = rows.pivot(index="replication", columns="estimator", values=metric)
    means = wide.mean().sort_values()  # those without any value come last
    base = str(means.index[0]) if baseline is None else baseline
    pair_up = _pairing(run, cell, wide, metric, shared and metric in CLUSTERED)
    for name in means.index:
        if name != base:
            levels = {"mean": means[name], "baseline_mean": means[base], "of": len(wide)}
            yield {
                "estimator": name,
                "baseline": base,
                **levels,
                **_numbers(*pair_up(name, base), metric),
            }
    if baseline is None:
        for a, b in combinations([n for n in means.index if n != base], 2):
            yield {"p": pair_up(a, b)[0].p_value}


def _pairing(
    run: Path, cell: str, wide: pd.DataFrame, metric: str, clustered: bool
) -> Callable[[str, str], tuple[Paired, str]]:
    """The function that compares two columns of `wide`, and says what it takes as independent."""
    known: dict[tuple[str, bytes], np.ndarray] = {}

    def influence(name: str, kept: np.ndarray) -> np.ndarray:
        key = name, kept.tobytes()
        if key not in known:
            sums = clusters(run, cell, name, kept)
            found = None if sums is None else sums.influence(metric)
            if found is None:
                raise RunError(
                    f"{run}: the fixes of {name} in cell {cell} are gone; "
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


def _numbers(pair: Paired, by: str, metric: str) -> dict[str, Any]:
    """The columns of one comparison."""
    relative = math.isfinite(pair.percent.value)
    change, (low, high) = (
        (pair.percent, pair.percent_interval()) if relative else (pair.difference, pair.interval())
    )
    own = metric.rpartition("_")[2] if metric.endswith("_m") else ""
    value = (
        100 * pair.difference.value if metric == FAILURES else change.value
    )  # the interval is about a shrunken one
    return {
        "n": pair.n, "change": value, "change_low": low, "change_high": high,
        "unit": "percentage points" if metric == FAILURES else "%" if relative else own,
        "p": pair.p_value, "by": by, "units": pair.units, "pair": pair,
    }  # fmt: skip


def words(metric: str) -> tuple[str, str]:
    """What an estimator is called whose values are smaller, or larger, than another one's."""
    return (
        ("better", "worse")
        if metric.startswith("rmse") or metric == FAILURES
        else ("lower", "higher")
    )


def _judge(row: Mapping[Any, Any], comparisons: int) -> tuple[str, float, str]:
    """Verdict, units that would show 1 %, and the line of one comparison."""
    a, b, metric, n, pair = row["estimator"], row["baseline"], row["metric"], row["n"], row["pair"]
    empty = [
        name for name, value in ((a, row["mean"]), (b, row["baseline_mean"])) if math.isnan(value)
    ]
    if empty:
        return (
            NO_VALUES,
            math.nan,
            f"{a} and {b} cannot be compared: no {metric} of {' and '.join(empty)}",
        )
    if math.isnan(row["p"]):
        return (
            TOO_FEW,
            math.nan,
            f"{a} and {b} cannot be compared: too few pairs with a value, N = {n}",
        )
    count = f"N = {n}" + (
        f" (only {n} of {row['of']} replications have both)" if n < row["of"] else ""
    )
    if pair.difference.value == 0 == pair.difference.se:
        return EQUAL, math.nan, f"{a} is equal to {b} in every replication, {count}"
    ratio = row["unit"] in ("%", "percentage points")
    need = statistics.needed(pair, 1.0, comparisons, LEVEL) if ratio else math.nan
    unit = f" {row['unit']}".rstrip()
    p = f"p {'= ' if row['p_holm'] > 0 else '< '}{max(row['p_holm'], 1e-300):.2g} (Holm)"
    if row["p_holm"] < LEVEL:
        smaller = row["change"] < 0
        ends = (
            (-row["change_high"], -row["change_low"])
            if smaller
            else (row["change_low"], row["change_high"])
        )
        value, low, high = rounded(abs(row["change"]), *ends)
        says = words(metric)[0 if smaller else 1]
        return says, need, f"{a} is {says} than {b} by {value}{unit} [{low}, {high}], {p}, {count}"
    value, low, high = rounded(row["change"], row["change_low"], row["change_high"], "+")
    seen = f"{value}{unit} [{low}, {high}], {p}"
    line = f"{a} and {b}: no difference seen at this {count}: {seen}"
    one = f"1{' percentage point' if metric == FAILURES else ' %'}"
    if not math.isfinite(need) or need == 0:
        return NONE_SEEN, math.nan, line
    if need <= row["units"]:
        return NONE_SEEN, need, f"{line}; this many would show {one}"
    unit_count = f"{np.format_float_positional(need, 2, fractional=False, trim='-')}"
    about = (
        f"about N = {unit_count}" if row["by"] == "replication" else f"about {unit_count} positions"
    )
    return NONE_SEEN, need, f"{line}; {about} would show {one}"


def rounded(value: float, low: float, high: float, sign: str = "") -> tuple[str, str, str]:
    """A value and its interval to two digits of the interval's half-width."""
    half = (high - low) / 2
    digits = (
        min(max(1 - math.floor(math.log10(half)), 0), 9) if half > 0 and math.isfinite(half) else 6
    )
    return tuple(f"{v:{sign}.{digits}f}" for v in (value, low, high))  # type: ignore[return-value]
