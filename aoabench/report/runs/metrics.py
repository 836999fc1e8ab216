"""The metrics that figures of a run show: their names, labels, and means with intervals."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from aoabench.columns import SUMMARY, unit_of
from aoabench.errors import UserError, did_you_mean
from aoabench.maths import intervals, statistics
from aoabench.report.runs.source import Source
from aoabench.store.clusters import CLUSTERED
from aoabench.store.compare import METRICS
from aoabench.store.comparison import FAILURES
from aoabench.store.fixes import clusters
from aoabench.store.summary import means

if TYPE_CHECKING:
    import pandas as pd

ERRORS = ("error_3d_m", "error_xy_m", "error_z_m")  # of every fix
# columns of the summary with a 95 % interval, one number for a cell and estimator
SUMMARIES = tuple(c for c in SUMMARY if f"{c}_low" in SUMMARY and c not in METRICS)
NAMES = (*METRICS, *ERRORS, *SUMMARIES)
_MEANS = {f"rmse_{axis}_m": f"rmse_mean_{axis}_m" for axis in ("3d", "xy", "z")}
_AXES = {"3d": "3-D", "xy": "in the plane", "z": "in z"}
_WORDS = {
    FAILURES: "share of failed or diverged replications",
    "availability": "share of fixes that are ok",
    "nees": "NEES",
    "iterations": "iterations",
}


def check_metric(metric: str) -> None:
    """Raise UserError for a metric that no kind of figure shows."""
    if metric not in NAMES:
        hint = did_you_mean(metric, NAMES) or f"; allowed: {', '.join(NAMES)}"
        raise UserError(f"metric={metric}: no such metric{hint}")


def label(name: str) -> str:
    """The name of a metric or parameter with its unit, for an axis."""
    if name in _WORDS:
        return _WORDS[name]
    unit, stem = unit_of(name), name.rpartition("_")[0]
    first, _, axis = stem.rpartition("_")
    if name in ERRORS:
        return f"error {_AXES[axis]} [m]"
    if first.startswith("rmse"):
        word = first.removeprefix("rmse").strip("_").replace("q50", "median")
        return f"{word} RMSE {_AXES[axis]} [m]".lstrip()
    if name.startswith("cep"):
        return f"{name[:5].upper()}, error in the plane [m]"
    return f"{stem} [{unit}]" if unit else name


def mean_label(metric: str) -> str:
    """The label of the number that `estimates` gives."""
    return label(metric) if metric in (*SUMMARIES, FAILURES) else f"mean {label(metric)}"


def estimates(source: Source, metric: str) -> pd.DataFrame:
    """A row for each cell and estimator: cell, estimator, value of the metric with its 95 %
    interval low, high; n of `of` replications have a value.

    The value is the mean over replications, or the metric's own column of the summary. Intervals
    are those of the summary and of `compare`: clustered by position where replications share them.
    From a frame alone they are over replications. Raises UserError for a metric that a frame does
    not hold.
    """
    import pandas as pd

    stored: dict[Any, Any] = {}
    if source.summary is not None:
        keys = zip(source.summary["cell"], source.summary["estimator"])
        stored = dict(zip(keys, source.summary.to_dict("records")))
    elif metric in SUMMARIES:
        why = "it is one number for all tags; allowed: a figure that does not tell tags apart"
        why = why if source.tracks else "a frame does not hold it; allowed: a run's folder"
        raise UserError(f"metric={metric}: {why}")
    rows = []
    for (cell, name), mine in source.frame.groupby(["cell", "estimator"], sort=False):
        three = _three(source, metric, stored.get((cell, name)), mine)
        known = int(mine[metric].notna().sum()) if metric in mine else len(mine)
        rows.append((cell, name, *three, known if math.isfinite(three[0]) else 0, len(mine)))
    columns = ["cell", "estimator", "value", "low", "high", "n", "of"]
    return pd.DataFrame(rows, columns=columns)


def _three(
    source: Source, metric: str, row: Mapping[str, Any] | None, rows: pd.DataFrame
) -> tuple[float, float, float]:
    """The value of a metric and the ends of its interval, of one estimator in one cell: its `row`
    of the summary if known, and its replications.
    """
    column = _MEANS.get(metric, metric)
    if row is not None and f"{column}_low" in row:
        return row[column], row[f"{column}_low"], row[f"{column}_high"]
    if metric in SUMMARIES:  # tables of an earlier version
        return math.nan, math.nan, math.nan
    values = rows[metric]
    if metric == FAILURES:
        count, n = float(values.sum()), len(values)
        return count / n, *intervals.rate_interval(count, n)
    shared = row is not None and row["se_by"] == "position"
    if metric in CLUSTERED and shared and source.out is not None:
        found = means(rows, clusters(source.out, rows["cell"].iloc[0], rows["estimator"].iloc[0]))[
            "iterations_mean"
        ]
    else:
        found = statistics.mean(values)
    low, high = found.interval()
    return found.value, max(low, 0.0) if metric in _MEANS else low, high
