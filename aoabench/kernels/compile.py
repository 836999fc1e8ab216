"""Compilation of kernels before their first use, with a disk cache that notices every change.

Functions that kernels share are inlined into each kernel, so that loops around them vectorise:
`inlined` by LLVM, with the function's own options, and `spliced` by numba, with the options of the
kernel.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numba
from numba import njit, types
from numba.extending import typeof_impl

from aoabench.kernels import cache

config: Any = numba.config  # numba sets its attributes at import
# contract: fused multiply-add; reassoc, nsz: sums in vector lanes; infinities and NaN occur, so
# ninf and nnan are not allowed
OPTIONS: dict[str, Any] = {"fastmath": {"contract", "reassoc", "nsz"}, "error_model": "numpy"}
ORDERED: dict[str, Any] = {"fastmath": {"contract"}, "error_model": "numpy"}  # sums as written

_one_at_a_time = threading.RLock()  # a kernel may need another

inlined = njit(forceinline=True, **OPTIONS)
inlined_ordered = njit(forceinline=True, **ORDERED)
called = njit(**OPTIONS)
spliced = njit(inline="always", **ORDERED)


class Kernel:
    """A function compiled for one signature, or loaded from the disk cache, when it is first used:
    called, by Python or by another kernel, or asked for by `ready`.
    """

    def __init__(self, function: Callable[..., Any], signature: Any, options: Any) -> None:
        self.module, self.name = function.__module__, function.__name__
        self.kept = cache.kept(config.CACHE_DIR, self.module)
        self.py_func, self._signature, self._compiled = function, signature, None
        with _cache_folder(self.kept.folder):
            cached = self.kept.folder is not None
            self._dispatcher = njit(cache=cached, nogil=True, **options)(function)

    @property
    def noted(self) -> bool:
        """Whether a process noted in the cache folder that it compiled the kernel."""
        return cache.noted(self.kept.folder, self.name)

    def ready(self) -> Any:
        """numba's dispatcher with the compiled function; other processes that need it wait."""
        with _one_at_a_time:
            if self._compiled is None:
                with cache.alone(self.kept.folder, self.name):
                    self._dispatcher.compile(self._signature)
                self._dispatcher.disable_compile()
                self._compiled = self._dispatcher
        return self._compiled

    def __call__(self, *arguments: Any) -> Any:
        return (self._compiled or self.ready())(*arguments)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.ready(), name)


@typeof_impl.register(Kernel)
def _type_in_kernels(kernel: Kernel, _context: Any) -> types.Type:
    return types.Dispatcher(kernel.ready())


def kernel(
    signature: Any, options: dict[str, Any] = OPTIONS
) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Decorator that makes a function a Kernel for `signature`; with NUMBA_DISABLE_JIT it stays a
    function in Python.
    """

    def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
        return function if config.DISABLE_JIT else Kernel(function, signature, options)

    return compiled


def given(dimensions: int, dtype: Any = types.float64) -> types.Array:
    """The type of an array, by default of doubles, that is only read."""
    return types.Array(dtype, dimensions, "C", readonly=True)


class InFolder:
    """Where numba keeps a kernel: in the folder that stands for its source, so that a second clone
    or a new installation finds it.
    """

    def __init__(self, folder: str) -> None:
        self.folder = folder

    @classmethod
    def from_function(cls, _function: Any, _file: str) -> InFolder:
        """The place of a function that is decorated now."""
        return cls(config.CACHE_DIR)

    def ensure_cache_path(self) -> None:
        """Create the folder if it is missing."""
        Path(self.folder).mkdir(parents=True, exist_ok=True)

    def get_cache_path(self) -> str:
        """The folder."""
        return self.folder

    def get_source_stamp(self) -> str:
        """The folder's name, which holds a hash of the source."""
        return Path(self.folder).name

    def get_disambiguator(self) -> str:
        """A part of the file's name; a module has one kernel of a name."""
        return "kernel"


@contextmanager
def _cache_folder(folder: Any) -> Iterator[None]:
    """numba caches functions decorated in this context in `folder`, afterwards where it did."""
    with _one_at_a_time:
        own = {"CACHE_DIR": str(folder), "CACHE_LOCATOR_CLASSES": f"{__name__}.InFolder"}
        before = {name: getattr(config, name) for name in own if folder is not None}
        try:
            for name in before:
                setattr(config, name, own[name])
            yield
        finally:
            for name, value in before.items():
                setattr(config, name, value)
