"""Compilation of kernels before their first call, with a disk cache that notices every change.

Functions that kernels share are inlined into each kernel, so that loops around them vectorise:
`inlined` by LLVM, with the function's own options, and `spliced` by numba, with the options of the
kernel.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numba
from numba import njit, types

from aoabench.kernels.cache import kept

config: Any = numba.config  # numba sets its attributes at import
KEPT = kept(config.CACHE_DIR)
# contract: fused multiply-add; reassoc, nsz: sums in vector lanes; infinities and NaN occur, so
# ninf and nnan are not allowed
OPTIONS: dict[str, Any] = {"fastmath": {"contract", "reassoc", "nsz"}, "error_model": "numpy"}
ORDERED: dict[str, Any] = {"fastmath": {"contract"}, "error_model": "numpy"}  # sums as written

_one_at_a_time = threading.Lock()

inlined = njit(forceinline=True, **OPTIONS)
inlined_ordered = njit(forceinline=True, **ORDERED)
called = njit(**OPTIONS)
spliced = njit(inline="always", **ORDERED)


def kernel(
    signature: Any, options: dict[str, Any] = OPTIONS
) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Decorator that compiles a function for `signature` or loads it from the disk cache."""

    def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
        with _cache_folder() as cache:
            dispatcher = njit(cache=cache, nogil=True, **options)(function)
        if config.DISABLE_JIT:
            return function
        dispatcher.compile(signature)
        dispatcher.disable_compile()
        return dispatcher

    return compiled


def given(dimensions: int, dtype: Any = types.float64) -> types.Array:
    """The type of an array, by default of doubles, that is only read."""
    return types.Array(dtype, dimensions, "C", readonly=True)


@contextmanager
def _cache_folder() -> Iterator[bool]:
    """Yield whether KEPT has a folder; numba caches functions decorated in this context in it.

    Afterwards numba uses its previous cache folder again.
    """
    with _one_at_a_time:
        before = config.CACHE_DIR
        config.CACHE_DIR = str(KEPT.folder or before)
        try:
            yield KEPT.folder is not None
        finally:
            config.CACHE_DIR = before
