"""Changes of the world after which an estimator has to find the same, or the same in new axes.

Each function takes a batch and returns the changed one.
"""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np

from aoabench.maths.geometry import Array, wrap
from aoabench.roles import NEEDS
from aoabench.types import Anchors, Batch

MEASURED = tuple(
    f.name
    for f in fields(Batch)
    if f.name not in ("anchors", "known", "prior_mean", "prior_cov", "time", "anchor_id")
)

QUANTITIES = frozenset(need for need, (group, _) in NEEDS.items() if group == "noise")


def measured(batch: Batch) -> dict[str, Array]:
    """The arrays (R, T, B) that are not None."""
    return {n: a for n, a in batch.arrays.items() if n in MEASURED and a is not None}


def without(batch: Batch, absent: np.ndarray | bool, *names: str) -> Batch:
    """The batch in which the measurements `names`, or all, are NaN where `absent` (R, T, B) or what
    broadcasts to it.
    """
    some = {n: a for n, a in measured(batch).items() if n in names or not names}
    return replace(batch, **{n: np.where(absent, np.nan, a) for n, a in some.items()})  # type: ignore[arg-type]


def other(batch: Batch, quantity: str) -> Batch:
    """The batch with other measurements, or without, of one of the QUANTITIES."""
    if quantity == "elevation":
        return without(batch, True, "elevation", "elevation_sigma")
    names = ("azimuth_sigma", "elevation_sigma") if quantity == "stated_sigma" else (quantity,)
    drawn = np.random.default_rng(7).uniform(0.05, 0.2, batch.azimuth.shape)
    changed = dict.fromkeys(names, drawn)
    if quantity == "delay":
        changed = {"delay": 1e-7 * drawn, "delay_sigma": 1e-8 * drawn}
    return replace(batch, **changed)  # type: ignore[arg-type]


def steps(batch: Batch, some: slice) -> Batch:
    """The batch of some of the steps; the anchors of those steps where they move."""
    arrays = {name: array[:, some] for name, array in measured(batch).items()}
    index = np.arange(batch.azimuth.shape[1])[some]
    time = batch.time if batch.time is None else batch.time[:, some]
    return replace(batch, anchors=batch.anchors.at(index), time=time, **arrays)  # type: ignore[arg-type]


def permuted(batch: Batch, order: np.ndarray) -> Batch:
    """The anchors (B,) in another order."""
    arrays = {name: array[..., order] for name, array in measured(batch).items()}
    return replace(batch, anchors=batch.anchors.those(order), **arrays)  # type: ignore[arg-type]


def shifted(batch: Batch, by: Array) -> Batch:
    """Anchors and prior moved by (3,) m."""
    anchors = replace(batch.anchors, position=batch.anchors.position + by)
    if batch.prior_mean is None:
        return replace(batch, anchors=anchors)
    mean = batch.prior_mean.copy()
    mean[:, :3] += by
    return replace(batch, anchors=anchors, prior_mean=mean)


def rotated(batch: Batch, turn: Array) -> Batch:
    """Everything turned by the rotation (3, 3); the state consists of vectors in space."""
    at = batch.anchors
    anchors = replace(at, position=at.position @ turn.T, rotation=at.rotation @ turn.T)
    if batch.prior_mean is None or batch.prior_cov is None:
        return replace(batch, anchors=anchors)
    whole = blocks(turn, batch.prior_mean.shape[1])
    mean, cov = batch.prior_mean @ whole.T, whole @ batch.prior_cov @ whole.T
    return replace(batch, anchors=anchors, prior_mean=mean, prior_cov=cov)


def blocks(turn: Array, n: int) -> Array:
    """The rotation (n, n) of a state of n / 3 vectors."""
    return np.asarray(np.kron(np.eye(n // 3), turn), dtype=float)


def across_the_jump(batch: Batch) -> Batch:
    """The frame of each anchor turned about its own z axis so that its azimuth at a step in the
    middle is pi, and those around it jump between pi and -pi. No direction changes.
    """
    middle = batch.azimuth[0, batch.azimuth.shape[1] // 2]
    angle = np.where(np.isfinite(middle), middle, 0.0) - np.pi
    c, s, zero, one = np.cos(angle), np.sin(angle), np.zeros_like(angle), np.ones_like(angle)
    turn = np.stack([c, s, zero, -s, c, zero, zero, zero, one], axis=-1).reshape(-1, 3, 3)
    anchors = replace(batch.anchors, rotation=turn @ batch.anchors.rotation)
    return replace(batch, anchors=anchors, azimuth=wrap(batch.azimuth - angle))


def at_poles(batch: Batch) -> Batch:
    """The first anchor measures the elevations 90 and -90 deg in turn, at azimuth 0."""
    azimuth, elevation = batch.azimuth.copy(), batch.elevation.copy()
    known = np.isfinite(azimuth[..., 0])
    sign = np.where(np.arange(azimuth.shape[1]) % 2, -1.0, 1.0)
    azimuth[..., 0] = np.where(known, 0.0, np.nan)
    elevation[..., 0] = np.where(known, sign * np.pi / 2, np.nan)
    return replace(batch, azimuth=azimuth, elevation=elevation)


def moving(batch: Batch) -> Batch:
    """The anchors, repeated for every step."""
    T = batch.azimuth.shape[1]
    arrays = {n: np.repeat(a, T // a.shape[1], axis=1) for n, a in batch.anchors.arrays.items()}
    return replace(batch, anchors=Anchors(**arrays))
