"""Inputs of the particle filter's kernel: normals, and measurements as coefficients."""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np

from aoabench.filters.compiled import KINDS
from aoabench.maths.geometry import Array
from aoabench.roles import Measurement
from aoabench.types import Anchors

SHARED_BYTES = 2**27  # the normals of one replication are kept for the next filter up to this size


class _Shared(threading.local):
    """The last normals drawn by this thread, shared by the filters of one tile of replications."""

    kind: tuple[Any, ...] = ()
    held: list[int] = []  # the replications whose normals fill the first rows of memory
    memory = np.empty((0, 0, 3, 0), dtype=np.float32)


_shared = _Shared()


def shared_normals(
    compiled: ModuleType,
    key: tuple[int, int],
    replication: int,
    planes: int,
    particles: int,
    tile: int = 1,
) -> Any:
    """Standard normals (planes, 3, M), float32, of one replication, with M = `particles` rounded up
    to whole tiles; those of `tile` replications are kept.

    If the normals need more than SHARED_BYTES, the result is a buffer (1, 3, M) that the kernel
    fills step by step.
    """
    M = -(-particles // compiled.TILE) * compiled.TILE
    kept = 12 * planes * M * tile <= SHARED_BYTES
    kind = (key, tile, planes, M) if kept else (M,)
    if _shared.kind != kind:
        _shared.kind, _shared.held = kind, []
        shape = (tile, planes, 3, M) if kept else (1, 1, 3, M)
        _shared.memory = _shared.memory if _shared.memory.shape == shape else aligned(shape)
    if not kept:
        return _shared.memory[0]
    if replication not in _shared.held:
        if len(_shared.held) == tile:
            _shared.held = []
        compiled.draw(_shared.memory[len(_shared.held)], replication, *key)
        _shared.held = [*_shared.held, replication]
    return _shared.memory[_shared.held.index(replication)]


def aligned(shape: tuple[int, ...]) -> Any:
    """An array of float32, not filled, that begins at a multiple of 64 bytes."""
    memory = np.empty(math.prod(shape) + 16, dtype=np.float32)
    begin = -memory.ctypes.data % 64 // 4
    return memory[begin : begin + math.prod(shape)].reshape(shape)


@dataclass
class KernelDraws:
    """The kernel's draws in the order of the reference's calls."""

    compiled: ModuleType
    key: tuple[int, int]
    replication: int
    normals: int = 0
    turns: int = 0

    def standard_normal(self, shape: tuple[int, int]) -> Array:
        """The next plane of normals, (N, 3)."""
        plane = np.empty(
            (3, -(-shape[0] // self.compiled.TILE) * self.compiled.TILE), dtype=np.float32
        )
        self.compiled.normals(plane, self.normals, self.replication, *self.key)
        self.normals += 1
        return plane[:, : shape[0]].T.astype(float)

    def random(self) -> float:
        """The next step's uniform number."""
        self.turns += 1
        return self.compiled.turn(self.turns, self.replication, *self.key)


def terms(kind: int, Y: Array, quality: Array, anchors: Anchors, origin: Array) -> np.ndarray:
    """The kernel's coefficients (R, T, B, 15), float32, of measurements Y (R, T, m) with nominal
    variances (R, T, m), for positions relative to `origin` (R, 3).

    See `kernels.particle_likelihood.loglik`; a value that is not measured (NaN) gets the weight 0.
    """
    R = anchors.rotation
    shape = (*Y.shape[:2], anchors.count)
    y, r = Y.reshape(*shape, -1), quality.reshape(*shape, -1)
    c = np.zeros((*shape, 15))
    c[..., :3] = anchors.position - origin[:, None, None]
    known = ~np.isnan(y)
    y = np.where(known, y, 0.0)
    if kind == KINDS.index("unit_vector"):
        c[..., 3:6] = (y[..., None, :] @ R)[..., 0, :]
        c[..., 6] = np.where(known.all(-1), 0.5 / r[..., 0], 0.0)
        return c.astype(np.float32)
    cosine, sine = np.cos(y[..., :1]), np.sin(y[..., :1])
    c[..., 3:6] = cosine * R[..., 0, :] + sine * R[..., 1, :]
    c[..., 6:9] = cosine * R[..., 1, :] - sine * R[..., 0, :]
    c[..., 9:12] = R[..., 2, :]
    c[..., 12] = y[..., 1]
    c[..., 13:15] = known * (0.5 / r if kind == KINDS.index("azel") else 1.0)
    return c.astype(np.float32)


def weights_table(measurement: Measurement, kind: int) -> np.ndarray:
    """Table (724,), float32, of w = 1 / (2 variance) of azimuth and elevation and log(w) / 2 of
    both, at -90, -89 ... 90 degrees; empty for a `kind` that needs none.
    """
    if kind != KINDS.index("azel_adaptive"):
        return np.empty(0, dtype=np.float32)
    w = 0.5 / measurement.variances()
    return np.concatenate([w, 0.5 * np.log(w)], axis=1).astype(np.float32).ravel()
