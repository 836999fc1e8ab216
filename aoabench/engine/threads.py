"""One thread for matrix products, whose bits depend on the number of threads."""

from __future__ import annotations

import sys
from contextlib import AbstractContextManager
from functools import lru_cache
from typing import Any

from threadpoolctl import ThreadpoolController


def one_thread() -> AbstractContextManager[Any]:
    """A context in which BLAS and OpenMP libraries use one thread."""
    limit: AbstractContextManager[Any] = _controller(len(sys.modules)).limit(limits=1)
    return limit


@lru_cache(1)
def _controller(_modules: int) -> ThreadpoolController:
    """The libraries that are loaded; to find them takes a millisecond, and imports load more."""
    return ThreadpoolController()
