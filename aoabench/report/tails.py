"""The estimators whose RMSE a few units decide, as text and as JSON."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from aoabench.report.text import interval_text
from aoabench.store.swept import cell_names

if TYPE_CHECKING:
    import pandas as pd

_MOST_LINES = 10


def lines(summary: pd.DataFrame) -> Iterator[str]:
    """The heavy tails of a summary as lines for a terminal, with the names of cells."""
    yield from heavy_tails_text(heavy_tails(summary), cell_names(summary))


def heavy_tails(summary: pd.DataFrame) -> list[dict[str, Any]]:
    """An object for each row of the summary with a heavy tail, largest share first.

    Each has cell, estimator, by (replication or position), largest_share, and the median: of the
    fixes in the plane (CEP50) where every fix is known, else of the replications' RMSE; median_of
    names its column, median_low and median_high are its 95 % interval. Empty for tables of an
    earlier version, which do not know.
    """
    if "heavy_tail" not in summary:
        return []
    rows = []
    for row in summary[summary["heavy_tail"]].to_dict("records"):
        name = "cep50_m" if row["cep50_m"] == row["cep50_m"] else "rmse_q50_3d_m"
        found = {key: row[key] for key in ("cell", "estimator", "largest_share")}
        found |= {"by": row["se_by"], "median_of": name, "median": row[name]}
        rows.append(found | {f"median_{end}": row[f"{name}_{end}"] for end in ("low", "high")})
    return sorted(rows, key=lambda row: -row["largest_share"])


def heavy_tails_text(rows: Sequence[dict[str, Any]], names: Mapping[str, str]) -> Iterator[str]:
    """The objects of `heavy_tails` as lines for a terminal; `names` of cells, where there are
    several.
    """
    if rows:
        yield (
            "heavy tails: a few large errors decide these RMSE, whose intervals may be too narrow; "
            "use the median:"
        )
    for row in rows[:_MOST_LINES]:
        cell = f"{names[row['cell']]} " if names else ""
        median = interval_text(row["median"], row["median_low"], row["median_high"])
        what = "CEP50" if row["median_of"] == "cep50_m" else "median RMSE 3-D"
        yield (
            f"  {cell}{row['estimator']}: the largest {row['by']} holds "
            f"{100 * row['largest_share']:.3g} % of the sum of squares; {what} {median} m"
        )
    if len(rows) > _MOST_LINES:
        yield f"  and {len(rows) - _MOST_LINES} more, see heavy_tail in summary.parquet"
