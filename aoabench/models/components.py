"""Layout of measurement components and state derivatives, shared by the measurement models."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from aoabench.maths.geometry import Array
from aoabench.params import param
from aoabench.types import Batch

UNSTATED_DEG = (6.0, 12.0)  # what Bluetooth arrays do in rooms, errors that persist included
LEAST_VARIANCE = 1e-32  # rad^2: angles themselves are rounded to some 1e-16 rad


def unstated_param() -> Any:
    """The parameter of deviations where a device states none."""
    return param(
        UNSTATED_DEG,
        "standard deviations of azimuth and elevation for measurements that do not state them",
        unit="deg",
        shape=(2,),
        above=0,
        most=180,
    )


def stated_deviations(batch: Batch, unstated_deg: Sequence[float]) -> tuple[Array, Array]:
    """Deviations (R|1, T|1, B) rad of azimuths and elevations: the stated ones, or `unstated_deg`
    for both or for elevations where the measurements state none.
    """
    own = np.deg2rad(np.asarray(unstated_deg, dtype=float))
    each = np.ones((1, 1, batch.azimuth.shape[2]))
    stated = batch.azimuth_sigma, batch.elevation_sigma
    azimuth, elevation = (own[i] * each if s is None else s for i, s in enumerate(stated))
    return azimuth, elevation


def with_deviations(batch: Batch, unstated_deg: Sequence[float]) -> Batch:
    """The batch with the deviations of `stated_deviations` (R, T, B); itself if it states them."""
    if batch.azimuth_sigma is not None and batch.elevation_sigma is not None:
        return batch
    shape = batch.azimuth.shape
    azimuth, elevation = stated_deviations(batch, unstated_deg)
    return replace(
        batch,
        azimuth_sigma=np.broadcast_to(azimuth, shape),
        elevation_sigma=np.broadcast_to(elevation, shape),
    )


def interleave(parts: Sequence[Array]) -> Array:
    """Combine d arrays (..., B), one per type of component, into one (..., B d) in anchor order."""
    out = np.empty((*parts[0].shape, len(parts)))
    for i, part in enumerate(parts):
        out[..., i] = part
    return out.reshape(*parts[0].shape[:-1], -1)


def into_state(block: Array, n: int) -> Array:
    """Return derivatives (..., B d, n) by the state from derivatives (..., B, d, 3) by the
    position, which is the first three components of the state.
    """
    J = block.reshape(*block.shape[:-3], -1, 3)
    return J if n == 3 else np.concatenate([J, np.zeros((*J.shape[:-1], n - 3))], axis=-1)


def per_step(quality: Array, x: Array) -> Array:
    """Return one step's values (R, m) with axes of length 1 to broadcast with x (R, ..., n)."""
    return quality.reshape(quality.shape[0], *(1,) * (x.ndim - 2), quality.shape[1])


def over_measured(terms: Array, y: Array, x: Array) -> Array:
    """Sum (R, ...) of log-likelihood terms (R, ..., k) over the components of y (R, k) that are
    measured (not NaN).
    """
    missing = np.isnan(y)
    return (np.where(per_step(missing, x), 0.0, terms) if missing.any() else terms).sum(axis=-1)


def with_quality(y: Array, r: Array) -> tuple[Array, Array]:
    """Values and variances (R, T, m) from values (R, T, m) and variances (R|1, T|1, m); a value
    whose variance is not finite or not positive counts as not measured, and a variance below
    LEAST_VARIANCE as that. Variances that are the same in all replications or steps are stored
    once, in a view.
    """
    if not (r.min() >= LEAST_VARIANCE and r.max() < np.inf):  # false for NaN
        usable = np.isfinite(r) & (r > 0)
        r = np.maximum(np.where(usable, r, 1.0), LEAST_VARIANCE)
        y = np.where(usable, y, np.nan)
    return y, np.broadcast_to(r, y.shape)
