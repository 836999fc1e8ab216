"""The table of `compare` as text."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from aoabench.report.text import NON_CAUSAL
from aoabench.store.compare import COLUMNS, IDENTITY
from aoabench.store.comparison import FAILURES, LEVEL, NONE_SEEN
from aoabench.store.swept import differing

if TYPE_CHECKING:
    import pandas as pd


def lines(table: pd.DataFrame) -> Iterator[str]:
    """The table of `compare` as text, a paragraph for each cell."""
    free = [c for c in table.columns if c not in (*IDENTITY, *COLUMNS)]
    varied = [c for c in differing(table, ["scenario", "noise", *free]) if c in free]
    for _, rows in table.groupby("cell", sort=False):
        yield ""
        yield _head(rows, varied)
        yield from (f"  {text}" for text in rows["text"])
    left_out = table.attrs["left_out"]
    if left_out:
        yield ""
    for cell, why in left_out.items():
        yield f"cell {cell}: nothing to compare, {why}"
    if table.attrs["non_causal"]:
        yield ""
        yield f"non-causal: {', '.join(table.attrs['non_causal'])}; their {NON_CAUSAL}"
    if table.attrs["comparisons"]:
        yield ""
        yield from _method(table)


def _head(rows: pd.DataFrame, varied: Sequence[str]) -> str:
    """Heading of a cell: its parameters among those that vary, the metric with the baseline's mean,
    and the clustering of the intervals.
    """
    first = rows.iloc[0]
    where = "".join(f" {c}={first[c]}" for c in varied)
    known = not math.isnan(first["baseline_mean"])
    level = f" of {first['baseline']} = {first['baseline_mean']:.4g}" if known else ""
    name = first["metric"] if first["metric"] == FAILURES else f"mean {first['metric']}"
    units = rows["units"][rows["by"] == "position"]
    by = f", clustered by {units.iloc[0]} positions" if len(units) else ""
    cell = f"{first['scenario']} {first['noise']}{where} (cell {first['cell']})"
    return f"{cell}, {name}{level}{by}"


def _method(table: pd.DataFrame) -> Iterator[str]:
    """Lines that explain the intervals and p-values."""
    m = table.attrs["comparisons"]
    printed = m == np.isfinite(table["p"]).sum()
    among = "comparisons" if printed else "pairs of estimators, as the data picked the baseline"
    yield f"95 % intervals for each comparison alone; p by Holm's method over the {m} {among}."
    unseen = (table["verdict"] == NONE_SEEN) & np.isfinite(table["needed"])
    more = "; a number that suffices to detect one detects it with probability 0.8"
    yield f"A difference is claimed where p < {LEVEL:g}{more if unseen.any() else ''}."
