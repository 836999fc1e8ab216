"""Long tables: reading anchors from a file; writing measurements and anchors as tables."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from aoabench.devices.table import Table, header
from aoabench.errors import BadValue
from aoabench.maths.geometry import Array, euler, euler_of
from aoabench.types import Anchors, Batch

if TYPE_CHECKING:
    import pandas as pd


def read_anchors(key: str, path: str) -> tuple[list[str], Anchors]:
    """Return ids and anchors (1, 1, B, ...) from the columns id, x_m, y_m and, 0 by default, z_m,
    facing_deg, pitch_deg, roll_deg.

    Rz(facing) Ry(pitch) Rx(roll) turns the global axes into the anchor's. With facing alone, local
    x points along the facing direction, y to the left, z up, as in `plan.read_anchors`.
    """
    present = header(key, path)
    columns = ("id", "x_m", "y_m", "z_m", "facing_deg", "pitch_deg", "roll_deg")
    for name in columns:
        if present.count(name) > 1 or (name in columns[:3] and name not in present):
            raise BadValue(
                key,
                path,
                f"a file with the columns {', '.join(columns[:3])}, each once; "
                f"it has {', '.join(present)}",
            )
    table = Table.read(key, path, {name: name for name in columns if name in present})
    code, ids = table.texts("id")
    again = np.ones(len(code), dtype=bool)
    again[np.unique(code, return_index=True)[1]] = False
    table.check("id", again, "each id once")
    n = len(code)
    x, y, z, *turns = (
        table.numbers(c, empty=False) if c in present else np.zeros(n) for c in columns[1:]
    )
    axes = [euler(turn).T for turn in np.deg2rad(np.stack(turns[::-1], axis=-1))]
    return ids, Anchors(np.stack([x, y, z], axis=-1), np.stack(axes))


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
