"""Names of the methods, the fixes of a run, and statistics over campaigns (R, T)."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TypeVar

import numpy as np
import yaml
from joblib import cpu_count

from aoabench.cell import Cell
from aoabench.maths import statistics
from aoabench.maths.estimate import Estimate
from aoabench.store.fixes import Fixes
from aoabench.types import Outcome

X, Y = TypeVar("X"), TypeVar("Y")
Runs = Iterable[tuple[Cell, Mapping[str, Fixes]]]  # a cell and the fixes of each of its estimators
METHODS = (
    "single_anchor_1",
    "single_anchor_2",
    "single_anchor_3",
    "best_anchor",
    "rssi_anchor",
    "anchor_mean",
    "ls_lines",
    "ls_anchor_discarding",
    "vmf_ml",
)
# methods whose score measures the disagreement of the anchors
SCORED = ("anchor_mean", "ls_lines", "ls_anchor_discarding", "vmf_ml")
ERRORS = np.round(np.arange(0.0, 6.01, 0.05), 2)  # m, grid of the distribution functions


def in_threads(f: Callable[[X], Y], each: Iterable[X]) -> list[Y]:
    """The values of f in the order of its arguments, computed by a thread per processor; each of
    them depends on its argument alone.
    """
    with ThreadPoolExecutor(cpu_count()) as pool:
        return list(pool.map(f, each))


def printed_grids() -> dict[str, np.ndarray]:
    """Printed medians (42,) m of Figure 8, in the order of the scenario's points."""
    nodes = yaml.safe_load((Path(__file__).parents[1] / "grids.yaml").read_text(encoding="utf-8"))
    return {name: np.array(rows)[::-1].ravel() for name, rows in nodes.items()}


def columns(**estimates: Estimate) -> dict[str, float]:
    """Columns NAME and NAME_se of each estimate."""
    found = {}
    for name, estimate in estimates.items():
        found |= estimate.columns(name)
    return found


def error(f: Fixes) -> np.ndarray:
    """Horizontal errors (R, T) m; NaN for a step without a fix."""
    return f.error_xy_m.astype(float)


def within(e: np.ndarray, limit_m: float = 1.0) -> Estimate:
    """Share of the given fixes (R, T) whose error is at most `limit_m`."""
    return statistics.ratio((e <= limit_m).sum(axis=1), np.isfinite(e).sum(axis=1))


def difference(a: np.ndarray, b: np.ndarray, limit_m: float = 1.0) -> Estimate:
    """P(error <= limit_m) of the errors a minus that of the errors b (R, T), paired over
    campaigns.
    """
    hits, given = zip(*(((e <= limit_m).sum(axis=1), np.isfinite(e).sum(axis=1)) for e in (a, b)))
    return statistics.ratio_difference(hits[0], given[0], hits[1], given[1])


def rms(e: np.ndarray) -> float:
    """Root mean square of the given errors."""
    return float(np.sqrt(np.nanmean(e**2)))


def rmse(e: np.ndarray) -> Estimate:
    """Root mean square of the given errors (R, ...), with its standard error over campaigns."""
    return statistics.jackknife(squares(e), root_mean_square)


def squares(e: np.ndarray) -> np.ndarray:
    """Each campaign's sum of the squares of the given errors (R, ...), and their number: (R, 2)."""
    each = e.reshape(len(e), -1)
    return np.stack([np.nansum(each**2, axis=1), np.isfinite(each).sum(axis=1)], axis=1)


def root_mean_square(sums: np.ndarray) -> float:
    """Root mean square of the errors of all campaigns from their `squares` (R, 2)."""
    total, count = sums.sum(axis=0)
    return float(np.sqrt(total / count))


def tail(e: np.ndarray) -> float:
    """The 99 % quantile of the given errors over their median."""
    return float(np.divide(*np.nanquantile(e, [0.99, 0.5])))


def rejected(f: Fixes) -> tuple[np.ndarray, np.ndarray]:
    """Rejected fixes and all fixes with a measurement, both (R,)."""
    tried = f.outcome != Outcome.FAILED
    return (f.outcome == Outcome.REJECTED).sum(axis=1), tried.sum(axis=1)


def lost(f: Fixes) -> Estimate:
    """R_d: the share of rejected fixes among the fixes with a measurement."""
    return statistics.ratio(*rejected(f))


def unused(f: Fixes, without_vote: Fixes) -> tuple[np.ndarray, np.ndarray]:
    """Measurements that no fix uses and all measurements, both (R,).

    `without_vote` are the fixes that use every measurement.
    """
    measured = without_vote.anchors_used.sum(axis=1)
    return measured - np.nan_to_num(f.anchors_used).sum(axis=1), measured


def discarded(f: Fixes, without_vote: Fixes) -> Estimate:
    """The other reading of R_d: the share of measurements that no fix uses."""
    return statistics.ratio(*unused(f, without_vote))


def medians(e: np.ndarray, points: int) -> np.ndarray:
    """Each campaign's median error (R, P) m at each point; NaN where all its fixes are rejected."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        return np.nanmedian(e.reshape(len(e), points, -1), axis=2)


def filters(fixes: Mapping[str, Fixes], kind: str = "boxes") -> dict[float, Fixes]:
    """The discrepancy filters of a run by R_sigma; df_boxes_04 is that of 0.4."""
    names = [name for name in fixes if name.startswith(f"df_{kind}_")]
    return {int(name[-2:]) / 10: fixes[name] for name in names}


def only(runs: Runs) -> tuple[Cell, Mapping[str, Fixes]]:
    """The one cell of a run."""
    return next(iter(runs))
