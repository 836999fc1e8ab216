"""Freed memory that the C library keeps for the next arrays."""

from __future__ import annotations

import functools

import numpy as np

_KEPT = 31 * 2**20  # bytes; glibc adapts up to 32 MiB


@functools.cache
def keep_freed_memory() -> None:
    """Let the C library keep freed arrays of up to 31 MiB, and up to 62 MiB at the end of the heap,
    in this process.

    By default, glibc gives each freed array of more than 128 kB back to the kernel, whose pages the
    next array has to fault in again: for a block of few replications, a sixth of its time. glibc
    raises this threshold to the size of the largest array that was freed (mallopt(3),
    M_MMAP_THRESHOLD). Other C libraries are not affected.
    """
    np.empty(_KEPT, dtype=np.uint8)
