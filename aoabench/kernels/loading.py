"""Loading of compiled kernels; without numba all estimators run in NumPy."""

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
    """The parameter `engine` of an estimator with kernels; `more`: further choices and meanings."""
    meanings = {"auto": "compiled kernels if available", "numpy": "NumPy alone", **more}
    help = "; ".join(f"{name}: {meaning}" for name, meaning in meanings.items())
    return param("auto", help, choices=tuple(meanings))


class Compiled:
    """Mixin of estimators: compiled kernels for the engine `auto`, NumPy for `numpy`."""

    engine: str
    kernels: ClassVar[str]  # the module that holds them
    per_step: ClassVar[bool] = False  # whether they take anchors that differ from step to step

    def prepare(self, say: Callable[[str], None]) -> None:
        """Compile or load the kernels before workers run in parallel; `say` prints a line."""
        if self.engine == "auto":
            prepare(self.kernels, say)

    def compiled(self, anchors: Anchors) -> ModuleType | None:
        """The module of the kernels; None if NumPy is used, as it is for anchors that move and
        kernels that are not `per_step`.
        """
        fit = self.per_step or not anchors.moving
        return load(self.kernels) if self.engine == "auto" and fit else None


@cache
def load(name: str) -> ModuleType | None:
    """The module aoabench.`name`, compiled or from the disk cache; None if numba is missing."""
    try:
        importlib.import_module("numba")
    except ImportError:
        return None
    return importlib.import_module(f"aoabench.{name}")


def prepare(name: str, say: Callable[[str], None]) -> None:
    """Load the module aoabench.`name`; `say` prints a line when numba starts to compile it, or if
    numba is missing.

    Kernels from the disk cache are loaded without compiling, and no line is printed.
    """
    with _reporting(say):
        found = load(name)
    if found is None:
        say(
            "numba is not installed: estimators run in NumPy, particle filters about 50 times "
            "slower; to install it: pip install numba"
        )


def _compiling() -> str:
    """The line printed when numba compiles; it names a cache folder other than the usual one."""
    from aoabench.kernels.compile import KEPT

    often = "once" if KEPT.folder else "each time"
    place = f"; {KEPT.refused} cannot be written" if KEPT.refused else ""
    place += f", the kernels are stored in {KEPT.folder}" if place and KEPT.folder else ""
    return f"compiling kernels for this machine ({often}, about half a minute{place}) ..."


@contextmanager
def _reporting(say: Callable[[str], None]) -> Iterator[None]:
    """Print the line of `_compiling` when numba first starts to compile in this context."""
    try:
        from numba.core import event
    except ImportError:
        yield
        return

    class Listener(event.Listener):
        reported = False

        def on_start(self, event: object) -> None:
            if not self.reported:
                self.reported = True
                say(_compiling())

        def on_end(self, event: object) -> None:
            pass

    with event.install_listener("numba:compile", Listener()):
        yield
