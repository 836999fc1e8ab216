"""Packets: what a log holds, a row for each measurement of one tag by one anchor."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from aoabench.devices.table import Table
from aoabench.maths.geometry import Array


@dataclass(frozen=True)
class Packets:
    """N packets in the order of the log's rows, in aoabench's conventions.

    anchor (N,): the anchor's number in the file of anchors, from 0. values: arrays (N,) under the
    names of Measurements, in rad, s and dBm; NaN = not measured. tag (N,): numbers in `tags`, the
    tags' names in order of appearance; one tag, "", in a log without tags. fix (N,): numbers in
    `fixes`, the names of fixes that the log states, or None. time (N,) s, or None in a log without
    times. sequence (N,): the device's sequence numbers, or None. truth (N, 3) m, NaN = unknown.
    table: the rows, for messages.
    """

    anchor: np.ndarray
    values: Mapping[str, Array]
    tag: np.ndarray
    tags: tuple[str, ...]
    fix: np.ndarray | None
    fixes: tuple[str, ...]
    time: Array | None
    sequence: np.ndarray | None
    truth: Array
    table: Table
