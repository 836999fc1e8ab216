"""The table of `compare` as text."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import pandas as pd
from aoabench.store.compare import COLUMNS, IDENTITY, LEVEL


def lines(table: pd.DataFrame) -> Iterator[str]:
    """The table of `compare` as text, a paragraph for each cell."""
    known = [*IDENTITY, *COLUMNS, "verdict", "needed", "text"]
    varied = [c for c in table.columns if c not in known]
    for cell, rows in table.groupby("cell", sort=False):
        first = rows.iloc[0]
        where = "".join(f" {c}={first[c]}" for c in varied)
        by = next(
            (
                f", clustered by {u} positions"
                for u, b in zip(rows["units"], rows["by"])
                if b == "position"
            ),
            "",
        )
        yield ""
        level = (
            ""
            if math.isnan(first["baseline_mean"])
            else f", {first['baseline']} = {first['baseline_mean']:.4g}"
        )
        yield (
            f"{first['scenario']} {first['noise']}{where} (cell {cell}), "
            f"{first['metric']}{level}{by}"
        )
        yield from (f"  {text}" for text in rows["text"])
    if table.attrs["left_out"]:
        yield ""
        yield from (
            f"cell {cell}: nothing to compare, {why} here"
            for cell, why in table.attrs["left_out"].items()
        )
    m = table.attrs["comparisons"]
    if m:
        among = (
            "comparisons"
            if m == np.isfinite(table["p"]).sum()
            else "pairs, as the data picked what to compare with"
        )
        yield ""
        yield f"95 % intervals, each by itself; p by Holm's method over the {m} {among}."
        yield (
            f"A difference is claimed where p < {LEVEL:g}; "
            "what would show one does so with probability 0.8."
        )
