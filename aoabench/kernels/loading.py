"""Loading of compiled kernels; without numba all estimators run in NumPy."""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from contextvars import ContextVar
from functools import cache
from types import ModuleType
from typing import Any, ClassVar

from aoabench.kernels.cache import Kept
from aoabench.kernels.helpers import helping
from aoabench.params import param
from aoabench.types import Anchors

# those with kernels that estimators call, the ones that more of them call first
_MODULES = (
    "kalman",
    "particle",
    "snapshot",
    "access_nodes",
    "centroid",
    "vmf",
    "lines",
    "robust",
    "discrepancy",
    "smoother",
)
Say = Callable[[str], None]
_waited_s = [0.0]  # in this process, see waited_s
_collected: ContextVar[list[Any] | None] = ContextVar("collected", default=None)


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
    entries: ClassVar[tuple[str, ...]] = ()  # the kernels of the module that are called; (): all

    def prepare(self, say: Say) -> None:
        """Compile or load the kernels before workers run in parallel; `say` prints a line."""
        if self.engine == "auto":
            prepare(self.kernels, say, self.entries)

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


def prepare(name: str, say: Say, entries: Sequence[str] = ()) -> None:
    """Compile or load kernels of the module aoabench.`name`: those named in `entries`, or all.
    `say` prints a line when numba starts to compile, or if numba is missing.

    Kernels from the disk cache are loaded without compiling, and no line is printed. In the context
    `together`, nothing is compiled before its end.
    """
    module = load(name)
    if module is None:
        say(
            "numba is not installed: estimators run in NumPy, particle filters about 50 times "
            "slower; to install it: pip install numba"
        )
        return
    kernels = kernels_of(module, entries)
    collected = _collected.get()
    if collected is None:
        _compile(kernels, say)
    else:
        collected += kernels


@contextmanager
def together(say: Say) -> Iterator[None]:
    """At the end of this context, compile or load all kernels that `prepare` was called for in it;
    those that the disk cache lacks are compiled on several processors at once.
    """
    kernels: list[Any] = []
    token = _collected.set(kernels)
    try:
        yield
    finally:
        _collected.reset(token)
    _compile(list(dict.fromkeys(kernels)), say)


@contextmanager
def ahead() -> Iterator[None]:
    """Let other processes compile all kernels that the disk cache lacks while this context lasts;
    whoever needs one of them meanwhile compiles it or waits until it is compiled.
    """
    modules = [module for name in _MODULES if (module := load(f"kernels.{name}"))]
    kernels = [kernel for module in modules for kernel in kernels_of(module)]
    missing = [k for k in dict.fromkeys(kernels) if k.kept.folder is not None and not k.noted]
    with helping([(k.module, k.name) for k in missing]):
        yield


def kernels_of(module: ModuleType, entries: Sequence[str] = ()) -> list[Any]:
    """The kernels of a module with the names `entries`, or all; none if numba compiles nothing."""
    from aoabench.kernels.compile import Kernel

    names = entries or vars(module)
    return [k for name in names if isinstance(k := getattr(module, name), Kernel)]


def waited_s() -> float:
    """Seconds that `prepare` and `together` have taken in this process, to compile or load."""
    return _waited_s[0]


def _compile(kernels: Sequence[Any], say: Say) -> None:
    """Compile or load kernels, with the help of other processes if several were never compiled."""
    if not kernels:
        return
    begin = time.perf_counter()
    missing = [kernel for kernel in kernels if not kernel.noted]
    if missing:
        say(_compiling(missing[0].kept))
    others = [(k.module, k.name) for k in missing[1:] if k.kept.folder is not None]
    with helping(others[::-1]), nullcontext() if missing else _reporting(say, kernels):
        for kernel in kernels:
            kernel.ready()
    _waited_s[0] += time.perf_counter() - begin


def _compiling(kept: Kept) -> str:
    """The line printed when numba compiles; it names a cache folder other than the usual one."""
    often = "once" if kept.folder else "each time"
    place = f"; {kept.refused} cannot be written" if kept.refused else ""
    if place and kept.folder:
        place += f", the kernels are stored in {kept.folder.parent}"
    return f"compiling kernels for this machine ({often}, a quarter of a minute{place}) ..."


@contextmanager
def _reporting(say: Say, kernels: Sequence[Any]) -> Iterator[None]:
    """Print the line of `_compiling` when numba compiles although all kernels are in the cache: for
    another processor, say, or another version of numba.
    """
    from numba.core import event

    class Listener(event.Listener):
        reported = False

        def on_start(self, event: object) -> None:
            if not self.reported:
                self.reported = True
                say(_compiling(kernels[0].kept))

        def on_end(self, event: object) -> None:
            pass

    with event.install_listener("numba:compile", Listener()):
        yield
