"""Getting compiled kernels ready; without numba everything runs in NumPy."""

from __future__ import annotations

import importlib
import threading
from collections.abc import Callable
from functools import cache
from types import ModuleType
from typing import Any, ClassVar

from aoabench.params import param
from aoabench.types import Anchors


def engine_param(**more: str) -> Any:
    """The parameter `engine` of an estimator with kernels; `more` choices and their meanings."""
    meanings = {"auto": "compiled kernels where there are some", "numpy": "none", **more}
    help = "; ".join(f"{name}: {meaning}" for name, meaning in meanings.items())
    return param("auto", help, choices=tuple(meanings))


class Compiled:
    """Part of an estimator: compiled kernels for the engine `auto`, NumPy for `numpy`."""

    engine: str
    kernels: ClassVar[str]  # the module that holds them

    def prepare(self, say: Callable[[str], None]) -> None:
        """Compile or load the kernels, once, before others work in parallel."""
        if self.engine == "auto":
            prepare(self.kernels, say)

    def compiled(self, anchors: Anchors) -> ModuleType | None:
        """The kernels; None where NumPy computes. Kernels take anchors that do not move."""
        return load(self.kernels) if self.engine == "auto" and not anchors.moving else None


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
