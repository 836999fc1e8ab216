"""Long tables: measurements and anchors as tables, in the form that `recorded` reads."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from aoabench.maths.geometry import Array, euler_of
from aoabench.types import Batch

if TYPE_CHECKING:
    import pandas as pd


def as_tables(
    batch: Batch, truth: Array, tag: str | None = None, names: np.ndarray | None = None
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return the measurements of one replication (R = 1) as a long table, and its anchors.

    The first table has a row per fix and packet of an anchor that measured, with the true position
    from `truth` (T, n) m, and the tag, the names (T,) of the fixes and the time of a recording, and
    where anchors move with their poses. The second table has the known anchors at the first step.
    """
    import pandas as pd

    fix, place = (a.ravel() for a in np.indices(batch.azimuth.shape[1:]))
    number = np.broadcast_to(batch.numbers[0], batch.azimuth.shape[1:])
    identity = {} if tag is None else {"tag": np.full(len(fix), tag)}
    identity["fix"] = fix if names is None else names[fix]
    if names is not None and batch.time is not None:
        identity["time_s"] = batch.time[0][fix]
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
    rows = pd.DataFrame({**identity, "anchor": number.ravel() + 1, **given})[heard.ravel()]
    ids, first, place = np.unique(number[0], return_index=True, return_inverse=True)
    position, rotation = (a[0][first] for a in batch.anchors.at(0).frames)
    for name, value in _poses(batch, position[place], rotation[place]).items():
        rows[name] = value[heard.ravel()]
    turned = np.rad2deg([euler_of(R.T) for R in rotation]) + 0.0  # no -0.0
    known = {f"{axis}_m": position[:, k] for k, axis in enumerate("xyz")}
    known |= {f"{name}_deg": turned[:, 2 - k] for k, name in enumerate(("facing", "pitch", "roll"))}
    return rows, pd.DataFrame({"id": ids + 1, **known})


def _poses(batch: Batch, position: Array, rotation: Array) -> dict[str, Array]:
    """The columns (T B,) of the poses of anchors that move; {} if all stay at the positions (B, 3)
    m and rotations (B, 3, 3).
    """
    at, R = batch.anchors.position[0], batch.anchors.rotation[0]
    if (at == position).all() and (rotation == R).all():
        return {}
    shape = batch.azimuth.shape[1:]
    facing = np.rad2deg(np.arctan2(R[..., 0, 1], R[..., 0, 0]))
    given = {f"anchor_{axis}_m": at[..., k] for k, axis in enumerate("xyz")}
    given |= {"anchor_facing_deg": facing}
    return {name: np.broadcast_to(value, shape).ravel() for name, value in given.items()}
