"""Getting compiled kernels ready; without numba everything runs in NumPy."""

from __future__ import annotations

import importlib
import threading
from collections.abc import Callable
from functools import cache
from types import ModuleType

from aoabench.errors import check_choice

ENGINES = ("auto", "numpy")


def check_engine(engine: str, more: tuple[str, ...] = ()) -> None:
    """Raise BadValue unless it is one: `auto` takes a kernel where there is one, `numpy` never
    does.
    """
    check_choice("engine", engine, (*ENGINES, *more))


@cache
def load(name: str) -> ModuleType | None:
    """The module aoabench.`name`, compiled or from the disk cache; None where numba is missing."""
    try:
        importlib.import_module("numba")
    except ImportError:
        return None
    return importlib.import_module(f"aoabench.{name}")


def prepare(name: str, say: Callable[[str], None]) -> None:
    """`load`, telling what takes long or what is missing."""
    waiting = threading.Timer(
        1.5, say, ["compiling kernels for this machine (once, about half a minute) ..."]
    )
    waiting.start()
    try:
        found = load(name)
    finally:
        waiting.cancel()
    if found is None:
        say(
            "numba is not installed: filters run in NumPy, "
            "particle filters some 50 times slower; pip install numba"
        )
