"""The state of code and data files as this process has taken them in.

A module's source is recorded when the module is imported, a data file's digest when the file is
read. Both may differ from the files on the disk, which can change at any time; keys of results are
made from these records. Importing this module starts the recording.
"""

from __future__ import annotations

import functools
import hashlib
import importlib.util
import sys
import sysconfig
from collections.abc import Callable, Hashable, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from pathlib import Path
from types import CodeType, ModuleType, NoneType
from typing import Any, TypeVar
from weakref import WeakKeyDictionary

_T = TypeVar("_T")
_LIBRARIES = ("site-packages", "dist-packages")
_STANDARD = tuple(Path(p) for n in ("stdlib", "platstdlib") if (p := sysconfig.get_path(n)))


@dataclass(frozen=True)
class DataFile:
    """A file that was read, with the digest of its content at that time."""

    path: Path
    digest: str

    @property
    def changed(self) -> bool:
        """Whether the file's content is another one now, or cannot be read any more."""
        return _digest_now(self.path) != self.digest


@dataclass(frozen=True)
class Source:
    """The source of a module, as it was when the module was imported.

    certain: whether the bytes were recorded at the import itself; otherwise they were read later.
    """

    path: Path
    content: bytes
    digest: str
    certain: bool

    @property
    def changed(self) -> bool:
        """Whether the file holds something else now, or cannot be read any more."""
        return _digest_now(self.path) != self.digest


_sources: dict[str, Source] = {}  # as recorded at the import
_read_later: WeakKeyDictionary[ModuleType, Source] = WeakKeyDictionary()
_being_read: ContextVar[dict[Path, tuple[bytes, DataFile]]] = ContextVar("being_read")
_made: ContextVar[dict[object, Any]] = ContextVar("made")
_watched = {"aoabench"}  # packages that are recorded even if they are installed libraries


def digest_of(content: bytes) -> str:
    return hashlib.blake2b(content, digest_size=16).hexdigest()


def read(path: Path) -> tuple[bytes, DataFile]:
    """The content of a data file, and the record of this content; within `reading`, a file is read
    once.
    """
    place, before = path.resolve(), _being_read.get({})
    if place not in before:
        content = path.read_bytes()
        before[place] = content, DataFile(place, digest_of(content))
    return before[place]


def once(key: Hashable, make: Callable[[], _T]) -> _T:
    """The value of `make()`; within `reading`, made once for each key."""
    before = _made.get({})
    if key not in before:
        before[key] = make()
    found: _T = before[key]
    return found


@contextmanager
def reading() -> Iterator[Callable[[], tuple[DataFile, ...]]]:
    """Yield a function that returns the records of all data files read in this context."""
    found: dict[Path, tuple[bytes, DataFile]] = {}
    token, made = _being_read.set(found), _made.set({})
    try:
        yield lambda: tuple(file for _, file in found.values())
    finally:
        _being_read.reset(token)
        _made.reset(made)


def watch(packages: Iterable[str]) -> None:
    """Record the source of these packages when they are imported, wherever they lie."""
    _watched.update(packages)


def source(module: str) -> Source | None:
    """The source of a module as imported, or as it is now if it is not imported yet; None for one
    without a source file of its own, such as a compiled extension.
    """
    live, known = sys.modules.get(module), _sources.get(module)
    if live is not None and live in _read_later:
        known = _read_later[live]
    spec = live.__spec__ if live is not None else None
    if known and spec is not None and spec.origin == str(known.path):
        return known
    path = source_path(module)
    if path is None:
        return None
    if known and known.path == path:
        return known
    try:
        content = path.read_bytes()
    except OSError:
        return None
    found = Source(path, content, digest_of(content), certain=False)
    if live is not None:
        _read_later[live] = found
    return found


def source_path(module: str) -> Path | None:
    """The source file of a module; None if it has none or cannot be found."""
    if module == "__main__":
        name = vars(sys.modules["__main__"]).get("__file__")
        return Path(name).resolve() if name and Path(name).is_file() else None
    spec = spec_of(module)
    origin = spec.origin if spec else None
    return Path(origin) if origin and origin.endswith(".py") else None


def spec_of(module: str) -> ModuleSpec | None:
    """The module's place on the import path; None if it cannot be found."""
    live = sys.modules.get(module)
    if live is not None and live.__spec__ is not None:
        return live.__spec__
    return _found(module, tuple(sys.path))


def forget_places() -> None:
    """Look modules that are not imported yet up again, as files may have come or gone."""
    _found.cache_clear()


@functools.lru_cache(maxsize=4096)
def _found(module: str, _path: tuple[str, ...]) -> ModuleSpec | None:
    """The place of a module that is not imported yet; no package is imported to find it."""
    package = module.rpartition(".")[0]
    try:
        if not package:
            return importlib.util.find_spec(module)
        around = spec_of(package)
        folders = around.submodule_search_locations if around else None
        return None if folders is None else PathFinder.find_spec(module, list(folders))
    except (ImportError, AttributeError, ValueError):
        return None


def is_library(file: Path) -> bool:
    """Whether a file belongs to Python's standard library or to an installed library."""
    return in_site(file) or any(file.is_relative_to(folder) for folder in _STANDARD)


def is_standard(code: CodeType) -> bool:
    """Whether a function comes from Python's standard library."""
    file = Path(code.co_filename)
    return not in_site(file) and any(file.is_relative_to(folder) for folder in _STANDARD)


def in_site(file: Path) -> bool:
    """Whether a file lies among the installed libraries."""
    return any(name in file.parts for name in _LIBRARIES)


def differs_from_source(module: str, code: CodeType) -> bool:
    """Whether a loaded function of a module is not the one in the module's source as recorded.

    Only for modules whose source was not recorded at the import itself.
    """
    known = source(module)
    spec = None if module == "__main__" else spec_of(module)
    loader = spec.loader if spec else None
    if known is None or known.certain or not isinstance(loader, SourceFileLoader | NoneType):
        return False  # pytest's loader, for one, changes functions
    place = code.co_qualname, code.co_firstlineno
    return _codes(known).get(place) != _essence(code)


@functools.lru_cache(maxsize=64)
def _codes(known: Source) -> dict[tuple[str, int], Any]:
    """All functions of a module's source, by qualified name and first line."""
    found: dict[tuple[str, int], Any] = {}
    todo = [compile(known.content, str(known.path), "exec", dont_inherit=True)]
    while todo:
        code = todo.pop()
        found[code.co_qualname, code.co_firstlineno] = _essence(code)
        todo += [const for const in code.co_consts if isinstance(const, CodeType)]
    return found


def _essence(code: CodeType) -> tuple[Any, ...]:
    """Instructions, names and constants of a function, without its places in the file."""
    constants = [
        _essence(c) if isinstance(c, CodeType) else (type(c), repr(c)) for c in code.co_consts
    ]
    return code.co_code, code.co_names, code.co_varnames, code.co_freevars, tuple(constants)


def _digest_now(path: Path) -> str | None:
    """The digest of a file's present content; None if it cannot be read."""
    try:
        status = path.stat()
    except OSError:
        return None
    return _digest_at(path, status.st_mtime_ns, status.st_ctime_ns, status.st_size, status.st_ino)


@functools.lru_cache(maxsize=4096)
def _digest_at(path: Path, *_state: int) -> str | None:
    try:
        return digest_of(path.read_bytes())
    except OSError:
        return None


class _Loader(SourceFileLoader):
    """Loads a module from the bytes that it records.

    Python's own loader compares time stamps in whole seconds to find out whether compiled code is
    up to date. That is not enough for files that users edit: they are always compiled.
    """

    content: bytes | None = None

    def exec_module(self, module: ModuleType) -> None:
        self.content = super().get_data(self.path)
        path, name = Path(self.path), module.__name__
        _sources[name] = Source(path, self.content, digest_of(self.content), certain=True)
        super().exec_module(module)

    def get_data(self, path: str) -> bytes:
        return self.content if self.content and path == self.path else super().get_data(path)

    def get_code(self, fullname: str) -> CodeType | None:
        if self.content is None or fullname.partition(".")[0] == "aoabench":
            return super().get_code(fullname)
        code: CodeType = self.source_to_code(self.content, self.path)
        return code


class _Finder:
    """Finds modules as Python does, and lets `_Loader` load those outside installed libraries."""

    @classmethod
    def find_spec(
        cls, name: str, path: Any = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        spec = PathFinder.find_spec(name, path, target)
        if spec is not None and type(spec.loader) is SourceFileLoader and spec.origin:
            own = any(name == p or name.startswith(f"{p}.") for p in _watched)
            if own or not is_library(Path(spec.origin)):
                spec.loader = _Loader(name, spec.origin)
        return spec


def _record_imports() -> None:
    """Record the source of all modules that are imported from now on, and of the running script."""
    if not any(isinstance(f, type) and f.__name__ == _Finder.__name__ for f in sys.meta_path):
        place = sys.meta_path.index(PathFinder) if PathFinder in sys.meta_path else 0
        sys.meta_path.insert(place, _Finder)
    for module in ("__main__", __name__, __package__):
        if module in sys.modules:
            source(module)


_record_imports()
