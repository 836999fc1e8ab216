"""Results of a finished run and of the studies, as text and as JSON from the same tables."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from aoabench.cell import Cell
from aoabench.cli.outcomes import not_ok, not_ok_text
from aoabench.cli.tags import tags, tags_text, told
from aoabench.columns import SUMMARY
from aoabench.report import tails
from aoabench.report.text import NON_CAUSAL, interval_text, metric_title, shown_name
from aoabench.store.swept import cell_names, differing

if TYPE_CHECKING:
    import pandas as pd

    from aoabench.engine.runner import RunReport
    from aoabench.studies.reproduce import Drawn

_MOST_ROWS = 60
_RMSE = ("rmse_pooled_3d_m", "rmse_mean_3d_m", "rmse_q50_3d_m", "rmse_pooled_xy_m")


@dataclass(frozen=True)
class Finished:
    """The results of a finished run for the cells and estimators of this command.

    `summary` has the rows of summary.parquet, `parameters` are its columns of the cells'
    parameters; `errors` has one error message for each replication with an error.
    """

    report: RunReport
    cells: Mapping[str, Cell]
    summary: pd.DataFrame
    parameters: list[str]
    errors: list[str]


def finished(report: RunReport, cells: Sequence[Cell]) -> Finished:
    """Read the tables of a run, without the cells and estimators that other commands computed."""
    from aoabench.store import tables

    shown = tables.shown(report.out, "summary", "failures")
    summary, failures = (_asked(shown[name], cells) for name in ("summary", "failures"))
    parameters = [c for c in summary.columns if c not in SUMMARY]
    return Finished(
        report=report,
        cells={cell.id: cell for cell in cells},
        summary=summary,
        parameters=parameters,
        errors=list(failures["error"].dropna()),
    )


def _asked(frame: pd.DataFrame, cells: Sequence[Cell]) -> pd.DataFrame:
    """The rows of the cells' own estimators."""
    asked = {(cell.id, name) for cell in cells for name in cell.estimators}
    return frame.loc[[pair in asked for pair in zip(frame["cell"], frame["estimator"])]]


def run_text(found: Finished) -> Iterator[str]:
    """A finished run as lines for a terminal."""
    report = found.report
    out, count = report.out, len(found.cells)
    rate = f", {report.computed / report.seconds:,.0f}/s" if report.computed else ""
    yield (
        f"{count} cell{'s' if count != 1 else ''}: {report.computed} replications x estimators "
        f"computed, {report.reused} reused, {report.seconds:.1f} s{rate}"
    )
    scored = _scored(found)
    if len(scored):
        yield _table(found, scored)
        clustered = (scored["se_by"] == "position").any()
        yield (
            "pooled: over all fixes; mean, median: of the replications' RMSE, mean as in compare; "
            f"[95 % interval{', clustered by position but of the median' if clustered else ''}]"
        )
    if not found.summary["causal"].all():
        yield f"non-causal: {NON_CAUSAL}"
    yield from tags_text(told(tags(out, found.cells)))
    yield from tails.lines(found.summary)
    yield from not_ok_text(not_ok(found.summary), cell_names(found.summary))
    if found.errors:
        yield (
            f"exceptions and NaN in {len(found.errors)} replications, e.g. {found.errors[0]}; "
            f"see {out}/failures.parquet"
        )
    if report.precision:
        yield from _precision(report.precision)
    steps = ",steps" if (out / "steps.parquet").exists() else ""
    yield (
        f"tables: {out}/{{tidy,replications,cells,summary,timing{steps}}}.parquet    "
        f"in Python: aoabench.load({str(out)!r})"
    )


def _scored(found: Finished) -> pd.DataFrame:
    """The rows of the summary, without those of recordings that have no ground truth."""
    unknown = [c for c, cell in found.cells.items() if not _has_truth(cell)]
    return found.summary[~found.summary["cell"].isin(unknown)]


def _has_truth(cell: Cell) -> bool:
    tracks = cell.scenario.tracks
    return tracks is None or bool(np.isfinite(tracks.truth[:, :2]).all(axis=1).any())


def _table(found: Finished, mine: pd.DataFrame) -> str:
    """A line for each cell and estimator, with the parameters that differ between cells."""
    swept = [c for c in differing(mine, ["scenario", "noise", *found.parameters]) if "." in c]
    shown = mine[["scenario", "noise", *swept, "estimator", "replications"]].copy()
    shown["estimator"] = [shown_name(*row) for row in zip(mine["estimator"], mine["causal"])]
    for name in _RMSE:
        three = zip(mine[name], mine[f"{name}_low"], mine[f"{name}_high"])
        shown[f"{metric_title(name)} [m]"] = [interval_text(*values) for values in three]
    named = {name: f"fixes {name}" for name in ("failed", "ok", "unmeasured", "imprecise")}
    for name, title in named.items():
        share = mine[f"share_{name}"]
        if name in ("failed", "ok") or (share > 0).any():
            shown[title] = [f"{v:.2%}" for v in share]
    return str(shown.to_string(index=False, max_rows=_MOST_ROWS))


def _precision(rows: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """Lines about the precision that until.* requires, and the estimators that did not reach it."""
    first, short = rows[0], [row for row in rows if not row["reached"]]
    wanted = [f"{first['wanted_se']:g}"] if first["wanted_se"] else []
    wanted += (
        [f"{first['wanted_relative_se']:.3g} of the mean"] if first["wanted_relative_se"] else []
    )
    yield (
        f"{first['metric']}: standard error of the mean at most {' and '.join(wanted)}: reached by "
        f"{len(rows) - len(short)} of {len(rows)} estimators (precision.parquet)"
    )
    for row in short[:20]:
        yield (
            f"  not reached: cell {row['cell']} {row['estimator']}: mean {row['mean']:.4g}, "
            f"s.e. {row['se']:.2g} after {row['replications']} replications"
        )


def run_json(found: Finished) -> dict[str, Any]:
    """A finished run as the object that `aoabench run --json` prints."""
    report = found.report
    return {
        "out": report.out,
        "seconds": report.seconds,
        "computed": report.computed,
        "reused": report.reused,
        "damaged": report.damaged,
        "cells": [
            {
                "cell": cell.id,
                "experiment": cell.experiment,
                "scenario": cell.scenario_name,
                "noise": cell.noise_name,
                "seed": cell.seed,
                "replications": cell.reps,
                "config": cell.config,
                "left_out": cell.left_out,
            }
            for cell in found.cells.values()
        ],
        "summary": found.summary.to_dict("records"),
        "tags": tags(report.out, found.cells),
        "heavy_tails": tails.heavy_tails(found.summary),
        "not_ok": not_ok(found.summary),
        "errors": {"replications": len(found.errors), "first": next(iter(found.errors), None)},
        "precision": report.precision,
    }


def worst(found: Finished, n: int) -> list[dict[str, Any]]:
    """The n worst replications: those without a position first, then by their RMSE.

    Each has cell, noise, estimator, replication, rmse_3d_m, times_median (of its estimator),
    outcome and the command that replays it.
    """
    from aoabench.store import folder, tables

    out = found.report.out
    frame = _asked(tables.load(out), list(found.cells.values()))
    median = frame.groupby(["cell", "estimator"])["rmse_3d_m"].transform("median")
    frame = frame.assign(times_median=frame["rmse_3d_m"] / median)
    frame = frame.sort_values("rmse_3d_m", ascending=False, na_position="first", kind="stable")
    keys = ("cell", "noise", "estimator", "replication", "rmse_3d_m", "times_median", "outcome")
    rows = []
    for row in frame.head(n).to_dict("records"):
        cell = found.cells[row["cell"]]
        again = folder.replay_command(
            out, cell.id, row["estimator"], row["replication"], cell.config, cell.plugins
        )
        rows.append({key: row[key] for key in keys} | {"replay": again})
    return rows


def worst_text(rows: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """The worst replications as lines for a terminal."""
    yield f"the {len(rows)} worst replications, by their RMSE 3-D:"
    for row in rows:
        rmse, times = row["rmse_3d_m"], row["times_median"]
        error = "no position" if rmse != rmse else f"{rmse:.4g} m"
        more = f", {times:.3g} times its estimator's median" if times == times else ""
        yield (
            f"  {row['noise']} {row['estimator']} replication {row['replication']}: "
            f"{error}{more}, {row['outcome']}"
        )
        yield f"    {row['replay']}"


def studies_json(drawn: Drawn, results: Path) -> dict[str, Any]:
    """Verdicts and files of the studies, as `reproduce` and `report` print them with --json."""
    return {
        "results": results,
        "verdicts": drawn.verdicts.claims.to_dict("records"),
        "readings": drawn.verdicts.readings.to_dict("records"),
        "not_computed": [
            {"study": study, "item": item, "reason": problem}
            for (study, item), problem in drawn.problems.items()
            if problem
        ],
        "page": drawn.page,
    }
