"""The stored steps of a recording: every fix of its tracks, one track after the other."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from aoabench.errors import UserError
from aoabench.store.folder import noted_parts
from aoabench.store.index import entry_of

if TYPE_CHECKING:
    import pandas as pd


def track_steps(
    out: str | os.PathLike[str], cell: str, estimator: str, columns: Sequence[str]
) -> pd.DataFrame:
    """The replication and some other columns (see columns.STEPS) of each step of one estimator in
    one cell of the run in `out`; UserError if none are stored.
    """
    import pyarrow as pa

    root = Path(out)
    entry = entry_of(root, cell, estimator)
    if entry is None or not entry["steps"]:
        raise UserError(f"{out}: no steps of {estimator!r} in cell {cell!r}; set store.steps=true")
    names = list(dict.fromkeys(["replication", *columns]))
    frame: pd.DataFrame = pa.concat_tables(noted_parts(root, entry, "steps", names)).to_pandas()
    return frame


_OF_TAG = ("outcome", "score", "anchors_used", "error_xy_m", "sigma_x_m", "sigma_y_m", "tag")
_FLAGS = ("n_unmeasured", "imprecise")


def by_tag(out: str | os.PathLike[str], cell: str, estimator: str) -> list[dict[str, Any]]:
    """An object for each tag of a recording, in the order of the tracks: one estimator's fixes.

    Each has tag (None without a name), tracks, fixes; of them given (with a position), ok,
    unmeasured, imprecise; rmse_xy_m and median_error_xy_m of the fixes with a known error; the
    medians of score, anchors_used and sigma_xy_m (the root of the sum of the variances of x and y)
    over the fixes with a position; NaN where nothing is known.
    """
    frame = track_steps(out, cell, estimator, _OF_TAG + _FLAGS)
    frame["tag"] = frame["tag"].fillna("")
    rows = []
    for tag, mine in frame.groupby("tag", sort=False):
        given = mine[~mine["outcome"].isin(["failed", "rejected"])]
        error = given["error_xy_m"]
        sigma = np.hypot(given["sigma_x_m"].to_numpy(), given["sigma_y_m"].to_numpy())
        medians = given.assign(sigma=sigma)[["score", "anchors_used", "sigma"]].median()
        rows.append(
            {
                "tag": tag or None,
                "tracks": int(mine["replication"].nunique()),
                "fixes": len(mine),
                "given": len(given),
                "ok": int((mine["outcome"] == "ok").sum()),
                "unmeasured": int(mine["n_unmeasured"].sum()),
                "imprecise": int(mine["imprecise"].sum()),
                "rmse_xy_m": float((error**2).mean() ** 0.5),
                "median_error_xy_m": float(error.median()),
                "score": float(medians["score"]),
                "anchors_used": float(medians["anchors_used"]),
                "sigma_xy_m": float(medians["sigma"]),
            }
        )
    return rows
