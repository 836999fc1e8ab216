"""The error of every fix of an estimator in a cell, and its course over the steps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from aoabench.maths.intervals import Array, by_replication, share_interval
from aoabench.store.fixes import each_part
from aoabench.store.folder import noted_parts
from aoabench.store.parts import intact_parts
from aoabench.types import Outcome

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class FixErrors:
    """Errors (R, T) m of every fix, NaN without a position, and whether a replication has `tried`
    the fix (R, T).

    place (T,): the number of each fix's position, where all replications share their positions.
    counts (R,): the numbers of the replications' fixes if they differ; then the other arrays are
    (F,), one replication after the other.
    """

    error: Array
    tried: np.ndarray
    place: np.ndarray | None = None
    counts: np.ndarray | None = None

    @property
    def replications(self) -> int:
        return len(self.error if self.counts is None else self.counts)

    def share_band(self, x: Array, confidence: float = 0.95) -> tuple[Array, Array]:
        """Pointwise limits (K,) of the share of fixes with an error of at most x (K,), ascending,
        from replications, or the positions that they share, as independent units; NaN for less than
        two. The limits do not decrease, as the share does not.
        """
        all_ = by_replication(self.tried, self.counts)
        hits = (by_replication(self.error <= limit, self.counts) for limit in x)
        ends = [share_interval(hit, all_, self.place, confidence) for hit in hits]
        low, high = np.array(ends, dtype=float).reshape(-1, 2).T
        return np.maximum.accumulate(low), np.minimum.accumulate(high[::-1])[::-1]


def fix_errors(
    out: Path, entry: Mapping[str, Any], axis: str, replications: Sequence[int] | None = None
) -> FixErrors | None:
    """The errors of a recorded estimator on an axis: 3d, xy, or z without sign, in all or some
    replications; None if neither its fixes nor its steps are stored.
    """
    parts = intact_parts(out, entry["key"])
    wanted = None if replications is None else np.array(replications)
    errors, tried, places = [], [], []
    for one, place in each_part(out, entry, parts, wanted):
        z = np.sqrt(np.maximum(one.error_3d_m**2 - one.error_xy_m**2, 0))
        error = {"3d": one.error_3d_m, "xy": one.error_xy_m, "z": z}[axis]
        errors.append(np.where(one.accepted, error, np.nan))
        tried.append(one.outcome >= 0)
        places.append(place)
    if errors:
        return FixErrors(np.concatenate(errors), np.concatenate(tried), places[0])
    if not entry["steps"]:
        return None
    column = f"error_{axis}_m"
    tables = list(noted_parts(out, entry, "steps", ["replication", column, "outcome"], parts))
    number, error, outcome = (
        np.concatenate([table[n].to_numpy(zero_copy_only=False) for table in tables])
        for n in ("replication", column, "outcome")
    )
    error = np.where(np.isin(outcome, _WITHOUT), np.nan, np.abs(error))
    if wanted is not None:
        number, error = (values[np.isin(number, wanted)] for values in (number, error))
    counts = np.unique(number, return_counts=True)[1]
    if (counts != counts[0]).any():
        return FixErrors(error, np.ones(len(error), dtype=bool), counts=counts)
    whole = error.reshape(len(counts), -1)
    return FixErrors(whole, np.ones(whole.shape, dtype=bool))


_WITHOUT = [Outcome.FAILED.name.lower(), Outcome.REJECTED.name.lower()]


def errors_over_time(out: Path, entry: Mapping[str, Any], axis: str) -> pd.DataFrame:
    """A row for each step of a recorded estimator with stored steps: replication, step, time_s (NaN
    where simulated) and its error on an axis (as in `fix_errors`), NaN without a position.
    """
    import pyarrow as pa

    names = ["replication", "step", "time_s", f"error_{axis}_m", "outcome"]
    frame: pd.DataFrame = pa.concat_tables(noted_parts(out, entry, "steps", names)).to_pandas()
    error = frame.pop(names[3]).abs().mask(frame.pop("outcome").isin(_WITHOUT))
    return frame.assign(error=error)
