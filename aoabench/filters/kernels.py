"""Which filters run as compiled kernels, and getting them ready; without numba everything runs in NumPy.

A measurement model says by its own class attribute `kernel` which kernel computes what its methods do. A subclass does
not inherit that: it may change what the kernel would not know of.
"""

from __future__ import annotations

import importlib
import threading
from collections.abc import Callable
from functools import cache
from types import ModuleType
from typing import Any

import numpy as np

KINDS = ("unit_vector", "azel", "azel_adaptive")  # as numbered in the kernels' files
ENGINES = ("auto", "numpy")


def kind_of(measurement: Any, engine: str = "auto") -> int | None:
    """The number of the kernel that this measurement model names in its own class, or None."""
    name = vars(type(measurement)).get("kernel")
    return KINDS.index(name) if engine == "auto" and name in KINDS else None


def variances(measurement: Any) -> np.ndarray:
    """Variances (181, 2) rad^2 of azimuth and elevation at -90, -89 ... 90 degrees, for a model that has them."""
    return measurement.variances() if hasattr(measurement, "variances") else np.ones((181, 2))


@cache
def load(name: str) -> ModuleType | None:
    """The module aoabench.filters.`name`, compiled or from the cache on disk; None where numba is missing."""
    try:
        importlib.import_module("numba")
    except ImportError:
        return None
    return importlib.import_module(f"aoabench.filters.{name}")


def prepare(name: str, say: Callable[[str], None]) -> None:
    """`load`, telling what takes long or what is missing; once per process."""
    waiting = threading.Timer(1.5, say, ["compiling kernels for this machine (once, about half a minute) ..."])
    waiting.start()
    try:
        found = load(name)
    finally:
        waiting.cancel()
    if found is None:
        say("numba is not installed: filters run in NumPy, particle filters some 50 times slower; pip install numba")
