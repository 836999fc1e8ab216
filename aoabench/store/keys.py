"""Keys of parts: hashes of everything that the numbers of a part depend on.

A key names the code and the data files that this process has loaded, not those that lie on the disk
now. It covers scenario, noise, this estimator's parameters, seed, data files, source code and the
versions of the libraries that the code uses, and nothing else. Where a result may depend on more,
its key is unique: it is computed anew in each run, and a note says why.
"""

from __future__ import annotations

import uuid
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass
from functools import partial
from pathlib import Path
from types import FunctionType, MethodType
from typing import Any

from aoabench import loaded
from aoabench.cell import Cell
from aoabench.errors import RunError, UserError
from aoabench.loaded import DataFile
from aoabench.maths.digest import digest
from aoabench.params import CheckedParams
from aoabench.resources import version
from aoabench.roles import PlainEstimator
from aoabench.store.live import NotPlain, changes, function_in, plain
from aoabench.store.reach import Reach, Root, reach

_BLOCK: Root = ("aoabench.engine.block", "run_block")


@dataclass(frozen=True)
class Origin:
    """Code and data that the numbers of a cell come from; every worker must have the same.

    sources: digest of each module's source file. libraries: versions of installed libraries.
    files: the data files, as they were read.
    """

    sources: Mapping[str, str]
    libraries: Mapping[str, str | None]
    files: tuple[DataFile, ...]

    def differences(self) -> Iterator[tuple[str, str]]:
        """What this process has loaded, or would load now, that is different: its name, and since
        when. A data file that is missing is no difference: another machine may not have it.
        """
        for module, known in self.sources.items():
            source = loaded.source(module)
            if source is None or source.digest != known or source.changed:
                yield str(source.path if source else module), "it was imported"
        for name, wanted in self.libraries.items():
            if version(name) != wanted:
                yield name, "the run began"
        for file in self.files:
            if file.changed and file.path.exists():
                yield str(file.path), "it was read"

    def check(self) -> None:
        """Raise RunError if code or data differ in this process or have changed on the disk."""
        for name, since in self.differences():
            raise RunError(f"{name} was changed after {since}; start again")


@dataclass(frozen=True)
class _Code:
    """The code behind some objects: its digest, and why it may not be all."""

    digest: str
    reach: Reach
    unseen: tuple[str, ...]
    reads: tuple[str, ...]


@dataclass(frozen=True)
class RunKeys:
    """The keys of a run by cell: of its draws, of its parts by estimator, and what they come from.

    notes: lines about results that are computed anew, and why.
    """

    draws: Mapping[str, str]
    parts: Mapping[str, Mapping[str, str]]
    origins: Mapping[str, Origin]
    notes: tuple[str, ...]

    @classmethod
    def of(cls, cells: Iterable[Cell]) -> RunKeys:
        """The keys of some cells.

        Raises UserError for a module or a data file that was changed after it was loaded.
        """
        keys, draws, parts, origins = _Keys(), {}, {}, {}
        for cell in cells:
            draws[cell.id] = keys.draws(cell)
            parts[cell.id] = {n: keys.part(cell, n, draws[cell.id]) for n in cell.estimators}
            origins[cell.id] = keys.origin(cell)
        return cls(draws, parts, origins, tuple(keys.notes))


class _Keys:
    """Makes keys; code and files are looked up once."""

    def __init__(self) -> None:
        self.notes: dict[str, None] = {}
        self._codes: dict[frozenset[Root], _Code] = {}
        self._files: dict[Path, DataFile] = {}
        self._parts: dict[int, tuple[Any, list[Any]]] = {}  # by id of the objects, which are kept
        loaded.forget_places()

    def draws(self, cell: Cell) -> str:
        """Hash of everything that the simulated truth and measurements of one cell, and the metrics
        computed from them, depend on.
        """
        found = []
        for group, obj in (("scenario", cell.scenario), ("noise", cell.noise)):
            node = cell.config[group]
            found.append([node, self._content(group, obj, node, cell.plugins, {_BLOCK})])
        return digest([cell.seed, found])

    def part(self, cell: Cell, estimator: str, draws: str) -> str:
        """Hash of everything that one estimator's rows in one cell depend on; `draws` is the hash
        of the cell's draws.
        """
        obj = cell.estimators[estimator]
        node = _presets(cell).get(estimator)
        name = repr(estimator)
        stated = self._stated(name, obj) if node is None else node
        return digest([draws, stated, self._content(name, obj, node, cell.plugins)])

    def origin(self, cell: Cell) -> Origin:
        """Code and data that the cell's numbers come from."""
        presets = _presets(cell)
        objects = [(cell.scenario, cell.config["scenario"]), (cell.noise, cell.config["noise"])]
        objects += [(obj, presets.get(name)) for name, obj in cell.estimators.items()]
        roots = {_BLOCK, *(root for obj, _ in objects for root in _roots(self._parts_of(obj)))}
        found = self._code(frozenset(roots), cell.plugins).reach
        files = tuple(file for obj, node in objects for file in self._files_of(obj, node))
        sources = {m: d for m, d in found.sources.items() if m != "__main__"}
        return Origin(sources, found.libraries, files)

    def _content(
        self, name: str, obj: Any, node: Any, plugins: Iterable[str], more: Iterable[Root] = ()
    ) -> list[Any]:
        """Hashes of the code and the data files of an object; unique if there may be more."""
        parts = self._parts_of(obj)
        code = self._code(frozenset([*more, *_roots(parts)]), plugins)
        files = self._files_of(obj, node)
        vouched = _cache_key(obj)
        reasons = code.unseen if vouched is None else ()
        if vouched is None and not any(map(_stated_files, parts)):
            reasons += tuple(r for r in code.reads if not files or "__file__" in r)
        unique = self._unique(name, reasons[0]) if reasons else None
        return [code.digest, code.reach.libraries, [f.digest for f in files], vouched, unique]

    def _code(self, roots: frozenset[Root], plugins: Iterable[str]) -> _Code:
        """The code behind some definitions, looked up once in a run."""
        if roots not in self._codes:
            found, unseen, values = reach(roots, plugins), [], []
            try:
                values = changes(found)
            except NotPlain as error:
                unseen.append(str(error))
            for module in found.sources:
                source = loaded.source(module)
                if source and source.changed and module != "__main__":
                    raise UserError(f"{source.path} was changed after it was imported; start again")
            total = digest([found.digest, values])
            unseen += [f"its code {concern}" for concern in found.unseen]
            reads = tuple(f"its code {concern}" for concern in found.reads)
            self._codes[roots] = _Code(total, found, tuple(unseen), reads)
        return self._codes[roots]

    def _stated(self, name: str, obj: Any) -> Any:
        """The content of an object that was given as it is, or its own statement of it."""
        if (own := _cache_key(obj)) is not None:
            return ["cache_key", own]
        try:
            return plain(obj.function if isinstance(obj, PlainEstimator) else obj, name)
        except NotPlain as error:
            return self._unique(name, str(error))

    def _files_of(self, obj: Any, node: Any) -> list[DataFile]:
        """The data files of an object: those that it names, and those that its parameters name."""
        found: dict[Path, DataFile] = {}
        for one in self._parts_of(obj):
            for file in _stated_files(one):
                known = file if isinstance(file, DataFile) else self._read(Path(file))
                found[known.path] = known
        parts = [] if node is not None else self._parts_of(obj)
        texts = [*_texts(node), *(text for part in parts for text in _fields(part))]
        for path in map(Path, texts):
            if _is_file(path) and path.resolve() not in found:
                found[path.resolve()] = self._read(path)
        for known in found.values():
            if known.changed:
                raise UserError(f"{known.path} was changed after it was read; start again")
        return list(found.values())

    def _parts_of(self, obj: Any) -> list[Any]:
        """An object, and the dataclasses and callables in it; cells share objects."""
        if id(obj) not in self._parts:
            self._parts[id(obj)] = obj, list(_parts(obj))
        return self._parts[id(obj)][1]

    def _read(self, path: Path) -> DataFile:
        """The record of a file that an object names without having read it."""
        place = path.resolve()
        if place not in self._files:
            try:
                self._files[place] = loaded.read(place)[1]
            except OSError as error:
                raise UserError(f"{path} cannot be read: {error.strerror}") from None
        return self._files[place]

    def _unique(self, name: str, reason: str) -> str:
        """A text that no other key holds; note why it is needed."""
        advice = "a method cache_key() that returns what its numbers depend on allows reuse"
        self.notes[f"{name} is computed anew, not reused: {reason}; {advice}"] = None
        return uuid.uuid4().hex


def _presets(cell: Cell) -> dict[str, Any]:
    """The plain configs of the cell's filters and estimators by name."""
    return {**(cell.config.get("filter") or {}), **(cell.config.get("estimator") or {})}


def _parts(value: Any) -> Iterator[Any]:
    """An object and the dataclasses and callables nested in its fields."""
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, list | tuple):
        for item in value:
            yield from _parts(item)
    elif isinstance(value, MethodType):
        yield from _parts([value.__self__, value.__func__])
    elif isinstance(value, partial):
        yield from _parts([value.func, value.args, value.keywords])
    elif not isinstance(value, type) and (is_dataclass(value) or callable(value)):
        yield value
        if is_dataclass(value):
            yield from _parts([getattr(value, f.name) for f in fields(value)])


def _roots(parts: Iterable[Any]) -> Iterator[Root]:
    """The definitions of the classes and functions of the parts of an object."""
    for value in parts:
        inner = function_in(value)
        owner = inner if isinstance(inner, FunctionType) else type(value)
        yield owner.__module__, owner.__qualname__.partition(".")[0]


def _cache_key(obj: Any) -> Any:
    """An object's own statement of what its numbers depend on; None without one."""
    inner = obj.function if isinstance(obj, PlainEstimator) else obj
    own = inner.cache_key() if isinstance(inner, CheckedParams) else obj.cache_key()
    try:
        return None if own is None else plain(own, f"{type(inner).__qualname__}.cache_key()")
    except NotPlain as error:
        raise UserError(f"{error}; allowed: numbers, texts, arrays, lists of them") from None


def _stated_files(obj: Any) -> Iterable[Path | DataFile]:
    return obj.files if isinstance(obj, CheckedParams) else ()


def _texts(node: Any) -> Iterator[str]:
    """The texts in a plain config."""
    if isinstance(node, dict):
        node = list(node.values())
    if isinstance(node, list):
        for item in node:
            yield from _texts(item)
    elif isinstance(node, str):
        yield node


def _fields(obj: Any) -> Iterator[str]:
    """The texts and paths in the fields of an object."""
    values = [getattr(obj, f.name) for f in fields(obj)] if is_dataclass(obj) else []
    yield from (str(v) for v in values if isinstance(v, str | Path))


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False
