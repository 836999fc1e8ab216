"""How kernels are compiled: ahead of their first call, with a cache on disk that sees every change.

Pieces that kernels share are compiled into each kernel that uses them, so that loops around them
vectorise: `inlined` by LLVM, with the piece's own options, and `spliced` by numba, with the options
of the kernel.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numba
from numba import njit, types

from aoabench.kernels.cache import kept

config: Any = numba.config  # its names are made when numba starts
KEPT = kept(config.CACHE_DIR)
# contract: fused multiply-add; reassoc, nsz: sums in lanes; no flag may assume that infinities do
# not occur
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
    """Compile a function for `signature` at once, or take it from the cache on disk."""

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
    """Let numba keep what is decorated in this context in the folder KEPT; False where there is
    none. The folder that numba uses for other functions is restored.
    """
    with _one_at_a_time:
        before = config.CACHE_DIR
        config.CACHE_DIR = str(KEPT.folder or before)
        try:
            yield KEPT.folder is not None
        finally:
            config.CACHE_DIR = before
