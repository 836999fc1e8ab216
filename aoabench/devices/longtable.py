"""Long tables: measurements and anchors as tables, in the form that `recorded` reads."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from aoabench.maths.geometry import Array, euler_of
from aoabench.types import Batch

if TYPE_CHECKING:
    import pandas as pd


def as_tables(batch: Batch, truth: Array) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return the measurements of one replication (R = 1) as a long table, and its anchors.

    The first table has a row per fix and anchor that measured, with the true position from `truth`
    (T, n) m. The second table has the known anchors at the first step.
    """
    import pandas as pd

    fix, anchor = (a.ravel() for a in np.indices(batch.azimuth.shape[1:]))
    angles = {
        "azimuth_deg": batch.azimuth,
        "elevation_deg": batch.elevation,
        "azimuth_sigma_deg": batch.azimuth_sigma,
        "elevation_sigma_deg": batch.elevation_sigma,
    }
    given = {name: np.rad2deg(a[0].ravel()) for name, a in angles.items() if a is not None}
    given |= {} if batch.rssi is None else {"rssi_dbm": batch.rssi[0].ravel()}
    given |= {f"{axis}_m": truth[fix, k] for k, axis in enumerate("xyz")}
    heard = np.isfinite(batch.azimuth[0]) | np.isfinite(batch.elevation[0])
    heard[:, 0] |= ~heard.any(axis=1)  # a fix without any measurement keeps one row
    rows = pd.DataFrame({"fix": fix, "anchor": anchor + 1, **given})[heard.ravel()]
    position, rotation = (a[0] for a in batch.anchors.at(0).frames)
    turned = np.rad2deg([euler_of(R.T) for R in rotation]) + 0.0  # no -0.0
    known = {f"{axis}_m": position[:, k] for k, axis in enumerate("xyz")}
    known |= {f"{name}_deg": turned[:, 2 - k] for k, name in enumerate(("facing", "pitch", "roll"))}
    return rows, pd.DataFrame({"id": np.arange(1, len(position) + 1), **known})
