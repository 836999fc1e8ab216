"""What each method gives for each tag of a recording, as text and as JSON."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from aoabench.cell import Cell
from aoabench.report.text import shown_name

_MOST_LINES = 40


def tags(out: Path, cells: Mapping[str, Cell]) -> list[dict[str, Any]]:
    """An object for each tag, method and cell of recordings: cell, estimator, causal, and the
    fields of store.tracks.by_tag.
    """
    from aoabench.store.tracks import by_tag

    return [
        {"cell": cell.id, "estimator": name, "causal": estimator.causal, **row}
        for cell in cells.values()
        if cell.scenario.tracks is not None
        for name, estimator in cell.estimators.items()
        for row in by_tag(out, cell.id, name)
    ]


def told(rows: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """The objects of `tags` that the table of errors does not tell: those without ground truth, and
    those of cells with several tags or tracks.
    """
    several = {
        cell: sum(r["tracks"] for r in rows if (r["cell"], r["estimator"]) == (cell, name)) > 1
        for cell, name in {(row["cell"], row["estimator"]) for row in rows}
    }
    return [row for row in rows if several[row["cell"]] or row["rmse_xy_m"] != row["rmse_xy_m"]]


def tags_text(rows: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """The objects of `told` as lines for a terminal."""
    import pandas as pd

    if not rows:
        return
    frame = pd.DataFrame(rows[:_MOST_LINES])
    names = [shown_name(*row) for row in zip(frame["estimator"], frame["causal"])]
    shown = pd.DataFrame({"estimator": names})
    if frame["cell"].nunique() > 1:
        shown.insert(0, "cell", frame["cell"])
    if frame["tag"].notna().any():
        shown["tag"] = frame["tag"].fillna("-")
    if (frame["tracks"] > 1).any():
        shown["tracks"] = frame["tracks"]
    shown["fixes"] = frame["fixes"]
    counted = {"given": "given", "ok": "ok"}
    counted |= {n: f"fixes {n}" for n in ("unmeasured", "imprecise") if frame[n].any()}
    for name, title in counted.items():
        both = zip(frame[name], frame["fixes"])
        shown[title] = [f"{n} ({100 * n / of:.4g} %)" for n, of in both]
    titles = {
        "rmse_xy_m": "RMSE xy [m]",
        "median_error_xy_m": "median error xy [m]",
        "score": "median score",
        "anchors_used": "median anchors used",
        "sigma_xy_m": "median sigma xy [m]",
    }
    for name, title in titles.items():
        if frame[name].notna().any():
            shown[title] = ["-" if v != v else f"{v:.4g}" for v in frame[name]]
    yield str(shown.to_string(index=False))
    if len(rows) > _MOST_LINES:
        yield f"and {len(rows) - _MOST_LINES} more, see steps.parquet"
