"""The table of a run that `export` writes: which rows and columns of its summary, and in words."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from aoabench.columns import IDENTITY, SUMMARY, TIMING, unit_of
from aoabench.errors import UserError, did_you_mean
from aoabench.report.text import interval_parts, metric_title, number_text
from aoabench.store import tables
from aoabench.store.swept import differing

if TYPE_CHECKING:
    import pandas as pd

# exported without --metric, as far as the run has them; the second where it has no 3-D errors
DEFAULT = ("rmse_mean_3d_m", "rmse_q50_3d_m", "availability")
IN_THE_PLANE = ("rmse_mean_xy_m", "availability")
ALL = "all"
_ENDS = ("_low", "_high", "_se")
_TIMES = ("seconds_per_step", "seconds_per_replication")
_NUMBERS = [n for n, kind in (SUMMARY | TIMING).items() if kind == "double"]
METRICS = tuple(name for name in _NUMBERS if not name.endswith(_ENDS))


@dataclass(frozen=True)
class Metric:
    """A column of numbers, its name in words, its unit, and the columns of its errors, if it has
    them: the ends of its 95 % interval, or else its standard error.
    """

    name: str
    title: str
    unit: str
    low: str | None
    high: str | None
    se: str | None

    @classmethod
    def of(cls, name: str, columns: Iterable[str]) -> Metric:
        """The metric of a column of a table with these columns."""
        low, high, se = (
            name + end if name + end in columns else None for end in ("_low", "_high", "_se")
        )
        return cls(name, metric_title(name), unit_of(name), low, high, se)

    @property
    def columns(self) -> list[str]:
        """The metric's columns: the number, the ends of its interval, its standard error."""
        return [c for c in (self.name, self.low, self.high, self.se) if c is not None]

    def texts(self, frame: pd.DataFrame, digits: int) -> list[tuple[str, str]]:
        """The number and its error in each row as texts, rounded so that the interval's half-width
        or the standard error has `digits` significant digits; "" where there is none.
        """
        if self.low and self.high:
            three = zip(frame[self.name], frame[self.low], frame[self.high])
            return [interval_parts(*row, digits=digits) for row in three]
        se = frame[self.se] if self.se else [math.nan] * len(frame)
        each = [number_text(*row, digits=digits) for row in zip(frame[self.name], se)]
        parts = [text.partition(" ± ") for text in each]
        return [
            (number.strip("-") and number, mark.lstrip() + error) for number, mark, error in parts
        ]


@dataclass(frozen=True)
class Exported:
    """A run's table: a row for each cell and estimator.

    frame: all columns that identify a row (`keys`), `replications`, `causal` and those of the
    metrics. varied: the keys that tell the rows apart, `estimator` last. fixed: the keys with one
    value, and that value.
    """

    run: Path
    frame: pd.DataFrame
    keys: list[str]
    varied: list[str]
    metrics: list[Metric]

    @property
    def fixed(self) -> dict[str, Any]:
        same = [k for k in self.keys if k not in ("cell", "estimator")]
        same = [k for k in same if self.frame[k].nunique(dropna=False) == 1]
        first = self.frame.iloc[0]
        return {k: first[k] for k in same if first[k] == first[k] and first[k] not in ("", None)}

    def shown(self, by: str | None = None) -> list[str]:
        """The columns that name the rows of a table for readers, with columns for each value of
        `by`; the number of replications among them, if it differs between the rows.
        """
        differ = by is None and self.frame["replications"].nunique() > 1
        return [key for key in self.varied if key != by] + ["replications"] * differ

    @property
    def replications(self) -> str:
        """The number of replications, or the smallest and largest, in words."""
        low, high = self.frame["replications"].min(), self.frame["replications"].max()
        many = "s" if high > 1 else ""
        return (f"{low}" if low == high else f"{low} to {high}") + f" replication{many}"


def exported(run: Path, metrics: Sequence[str] = ()) -> Exported:
    """The table of the run in folder `run` with these metrics: names of METRICS, or ALL; without
    any, those of DEFAULT or IN_THE_PLANE that the run has.

    Raises UserError for an unknown metric, and for a folder without a run.
    """
    names = list(dict.fromkeys(metrics))
    for name in names:
        if name not in (*METRICS, ALL):
            hint = did_you_mean(name, METRICS) or f"; allowed: {', '.join((*METRICS, ALL))}"
            raise UserError(f"--metric={name}: unknown metric{hint}")
    shown = tables.shown(run, "summary", "cells", "timing")
    summary, cells, timing = (shown[name] for name in ("summary", "cells", "timing"))
    parameters = [c for c in summary.columns if c not in SUMMARY]
    frame = summary.merge(cells[["cell", "seed"]], on="cell", how="left", validate="m:1")
    times = timing[["cell", "estimator", *_TIMES]]
    frame = frame.merge(times, on=["cell", "estimator"], how="left", validate="1:1")
    frame["experiment"] = frame["experiment"].fillna("")
    keys = ["cell", *IDENTITY[1:4], "seed", *parameters, "estimator"]
    if ALL in names:
        names = list(METRICS)
    if not names:
        default = DEFAULT if frame[DEFAULT[0]].notna().any() else IN_THE_PLANE
        names = [name for name in default if frame[name].notna().any()]
    chosen = [Metric.of(name, frame.columns) for name in names]
    columns = [c for metric in chosen for c in metric.columns]
    some = frame[[*keys, "replications", "causal", *columns]]
    return Exported(run, some, keys, _varied(some, keys), chosen)


def _varied(frame: pd.DataFrame, keys: Sequence[str]) -> list[str]:
    """The keys that tell the rows apart: those with several values, and the estimator; the cell's
    id only if the others do not suffice.
    """
    some = [*differing(frame, [k for k in keys if k not in ("cell", "estimator")]), "estimator"]
    return ["cell", *some] if frame.duplicated(some).any() else some


def by_value(table: Exported, by: str) -> list[tuple[Any, pd.DataFrame]]:
    """The rows of each value of the key `by`, in the order of the values, with the same rows in the
    same order: those that a value lacks are NaN.

    Raises UserError for a key that has one value only or is unknown.
    """
    rest = [key for key in table.varied if key != by]
    if by not in table.varied or not rest:
        known = [key for key in table.varied if len(table.varied) > 1]
        hint = did_you_mean(by, known) or f"; allowed: {', '.join(known) or 'nothing here'}"
        raise UserError(f"--by={by}: no key with several values in this run{hint}")
    frame = table.frame
    rows = frame.drop_duplicates(rest).reset_index(drop=True)
    found = []
    for value in frame[by].drop_duplicates():
        mine = frame[frame[by].isna()] if value != value else frame[frame[by] == value]
        columns = [c for metric in table.metrics for c in metric.columns]
        joined = rows[[*rest, "causal"]].merge(mine[[*rest, *columns]], on=rest, how="left")
        found.append((value, joined))
    return found


def plain(value: Any) -> str:
    """The value of a parameter as text: numbers without trailing zeros, "-" if missing."""
    if value is None or value != value:
        return "-"
    if isinstance(value, bool | np.bool_):
        return str(bool(value)).lower()
    if isinstance(value, int | float | np.integer | np.floating):
        return f"{value:.12g}"
    return str(value)
