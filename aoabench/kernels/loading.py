"""Getting compiled kernels ready; without numba everything runs in NumPy."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
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
    """`load`; `say` gets a line once numba compiles something, and where numba is missing.

    What comes from the cache on disk is not compiled.
    """
    with _reporting(say):
        found = load(name)
    if found is None:
        say(
            "numba is not installed: filters run in NumPy, "
            "particle filters some 50 times slower; pip install numba"
        )


def _compiling() -> str:
    """The line that numba compiles, and where the result goes if that is not the usual folder."""
    from aoabench.kernels.compile import KEPT

    often = "once" if KEPT.folder else "each time"
    place = f"; {KEPT.refused} cannot be written" if KEPT.refused else ""
    place += f", they are kept in {KEPT.folder}" if place and KEPT.folder else ""
    return f"compiling kernels for this machine ({often}, about half a minute{place}) ..."


@contextmanager
def _reporting(say: Callable[[str], None]) -> Iterator[None]:
    """Say `_compiling` when numba starts to compile for the first time in this context."""
    try:
        from numba.core import event
    except ImportError:
        yield
        return

    class Listener(event.Listener):
        told = False

        def on_start(self, event: object) -> None:
            if not self.told:
                self.told = True
                say(_compiling())

        def on_end(self, event: object) -> None:
            pass

    with event.install_listener("numba:compile", Listener()):
        yield
