"""The fixes that are not ok in a finished run, and the commonest reason, as text and as JSON."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from aoabench.types import SENTENCES, Outcome, Reason

if TYPE_CHECKING:
    import pandas as pd

_MOST_LINES = 20


def not_ok(summary: pd.DataFrame) -> list[dict[str, Any]]:
    """An object for each row of the summary with fixes that are not ok, largest share first.

    Each has cell, noise, estimator; the shares of all fixes that are not ok, that each outcome has
    and that the commonest reason has; the reason and its sentence (None in tables of schema 1).
    """
    rows = []
    for row in summary[summary["share_ok"] < 1].to_dict("records"):
        known = isinstance(row["reason"], str)
        rows.append(
            {
                **{key: row[key] for key in ("cell", "noise", "estimator")},
                "share_not_ok": 1 - row["share_ok"],
                **{name: row[name] for name in _SHARES},
                "reason": row["reason"] if known else None,
                "share_reason": row["share_reason"],
                "sentence": SENTENCES[Reason[row["reason"].upper()]] if known else None,
            }
        )
    return sorted(rows, key=lambda row: -row["share_not_ok"])


_SHARES = [f"share_{outcome.name.lower()}" for outcome in Outcome if outcome]


def not_ok_text(rows: list[dict[str, Any]], names: Mapping[str, str]) -> Iterator[str]:
    """The objects of `not_ok` as lines for a terminal; `names` of cells if there are several."""
    if rows:
        yield "fixes that are not ok, with the commonest reason:"
    for row in rows[:_MOST_LINES]:
        cell = f"{names[row['cell']]} " if names else ""
        shares = [f"{_percent(row[n])} {n.removeprefix('share_')}" for n in _SHARES if row[n] > 0]
        yield f"  {cell}{row['estimator']}: {', '.join(shares)}: {_why(row)}"
    if len(rows) > _MOST_LINES:
        yield f"  and {len(rows) - _MOST_LINES} more, see reason in summary.parquet"


def _why(row: dict[str, Any]) -> str:
    """The commonest reason, with its share where there are others."""
    if row["sentence"] is None:
        return "the tables of this run hold no reasons"
    if row["share_reason"] >= (1 - 1e-9) * row["share_not_ok"]:
        return str(row["sentence"])
    return f"{row['sentence']} ({_percent(row['share_reason'])})"


def _percent(share: float) -> str:
    """A share in percent to three digits; never 0 % of a positive share."""
    return f"{100 * share:.3g} %"
