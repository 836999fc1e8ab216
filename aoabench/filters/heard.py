"""Batches of the anchors heard at each step, from batches of all anchors."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from aoabench.maths.places import at_places, numbers_of
from aoabench.types import Anchors, Batch

MEASURED = ("azimuth", "elevation", "delay", "azimuth_sigma", "elevation_sigma", "delay_sigma")


def heard_alone(batch: Batch) -> Batch:
    """The batch with those anchors only that a replication heard at the step, without rssi.

    It is the batch itself if it is one of heard anchors, or if all anchors are heard at some step.
    """
    if batch.known is not None:
        return batch
    each = [a for a in (batch.azimuth, batch.elevation, batch.delay) if a is not None]
    heard = np.any([np.isfinite(a).any(axis=0) for a in each], axis=0)
    numbers = numbers_of(heard)[None]
    if numbers.shape[2] == batch.anchors.count:
        return batch
    some, given = np.maximum(numbers, 0), batch.anchors.arrays.items()
    anchors = Anchors(**{name: at_places(a, some, np.nan) for name, a in given})
    arrays = {name: getattr(batch, name) for name in MEASURED}
    found: dict[str, Any] = {
        n: None if a is None else at_places(a, numbers, np.nan) for n, a in arrays.items()
    }
    return replace(
        batch, anchors=anchors, anchor_id=numbers, known=batch.anchors, rssi=None, **found
    )
