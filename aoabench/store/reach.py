"""All code that some classes and functions depend on: definitions by name, across modules.

A definition reaches the names that it uses: in its own module, in modules that it imports from, and
through attributes of modules. At an installed library the search ends with the library's version.
"""

from __future__ import annotations

import builtins
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib import metadata
from pathlib import Path
from types import FunctionType

from aoabench import loaded
from aoabench.maths.digest import digest
from aoabench.resources import version
from aoabench.store.definitions import Definition, Imported, Module, parsed

# aoabench's modules for messages, checks and machinery, which compute no number of a result
_ASIDE = (
    *("errors", "params", "resources", "columns", "loaded", "cell", "config", "cli", "report"),
    *("studies", "store", "kernels.loading", "kernels.cache", "engine.timing", "engine.faults"),
)
Root = tuple[str, str | None]

_COMPILED_WITH = {"numba": ("llvmlite",)}


@dataclass
class Reach:
    """Definitions, by module and name, that some roots depend on; name None: the statements of a
    module that define no name.

    sources: digest of each module's source file. libraries: versions of the installed libraries
    that the code uses; missing: those that are not installed. values: names that the code uses and
    no statement defines. unseen: reasons why this is not all; `reads` are those that a list of data
    files removes.
    """

    definitions: dict[Root, Definition] = field(default_factory=dict)
    sources: dict[str, str] = field(default_factory=dict)
    libraries: dict[str, str | None] = field(default_factory=dict)
    missing: set[str] = field(default_factory=set)
    values: set[Root] = field(default_factory=set)
    unseen: list[str] = field(default_factory=list)
    reads: dict[str, None] = field(default_factory=dict)

    @property
    def digest(self) -> str:
        """Hash of the code, without the libraries."""
        found = [(m, n or "", d.digest) for (m, n), d in self.definitions.items()]
        return digest([sorted(found), sorted(self.missing)])


def reach(roots: Iterable[Root], plugins: Iterable[str] = ()) -> Reach:
    """The code that the definitions `roots` (module, name) depend on; `plugins` are packages that
    count as code even if they are installed libraries.
    """
    return _Search(tuple(plugins)).run(roots)


class _Search:
    def __init__(self, plugins: tuple[str, ...]) -> None:
        self.own = ("aoabench", *plugins)
        self.found = Reach()
        self.todo: list[Root] = []
        self.seen: set[Root] = set()

    def run(self, roots: Iterable[Root]) -> Reach:
        self.todo = sorted(roots, key=str)
        while self.todo:
            module, name = self.todo.pop()
            if (module, name) in self.seen or _is_aside(module):
                continue
            self.seen.add((module, name))
            if (known := self._module(module)) is not None:
                self._enter(known, name)
        return self.found

    def _outside(self, name: str) -> bool:
        """Whether a module belongs to Python or to an installed library; enter its version."""
        top = name.partition(".")[0]
        if name == "__main__" or any(name == p or name.startswith(f"{p}.") for p in self.own):
            return False
        if top in sys.builtin_module_names or top in sys.stdlib_module_names:
            return True
        spec = loaded.spec_of(top)
        place = spec.origin or next(iter(spec.submodule_search_locations or ()), "") if spec else ""
        if spec is not None and not (loaded.in_site(Path(place)) and _distributions(top)):
            return False
        for library in (top, *_COMPILED_WITH.get(top, ())):
            self.found.libraries |= {name: version(name) for name in _distributions(library)}
        if spec is None:  # one day it may be installed
            self.found.missing.add(top)
        return True

    def _module(self, name: str) -> Module | None:
        """The parsed source of a module of ours or of the user; None for one of a library, and for
        one without source.
        """
        if self._outside(name):
            return None
        source = loaded.source(name)
        known = parsed(name, source) if source else None
        if source and known:
            self.found.sources[name] = source.digest
        elif name == "__main__":
            self._note("is defined interactively")
        elif (spec := loaded.spec_of(name)) is None:
            self._note(f"imports {name}, which cannot be found")
        elif spec.origin is not None:
            self._note(f"uses {name}, which has no Python source")
        return known

    def _enter(self, module: Module, name: str | None) -> None:
        """Enter a definition of a module, and what it uses."""
        if name is not None and name not in module.names:
            self.found.values.add((module.name, name))
            self.todo += self._elsewhere(module, name)
            return
        definition = module.definition(name)
        self.found.definitions[module.name, name] = definition
        where = f" in {module.source.path.name}"
        for concern in definition.unseen:
            self._note(concern + where)
        self.found.reads |= dict.fromkeys(concern + where for concern in definition.reads)
        imports = {**module.imports, **definition.imports}
        for use in definition.uses:
            if use.name in module.names and use.name not in definition.imports:
                self.todo.append((module.name, use.name))
            elif use.name in imports:
                self.todo += self._imported(imports[use.name], use.attributes)
            elif not module.shipped:
                self.todo += self._unbound(module, use.name)
        if module.shipped:
            self.todo += _kernels(definition.texts)
        else:
            self._side_effects(module, imports.values())

    def _side_effects(self, module: Module, imports: Iterable[Imported]) -> None:
        """Enter the statements that run when the user's module is imported: its own, those of the
        packages around it, and those of modules that it imports.

        A script runs anyway; only its functions and the values that they use count.
        """
        if module.name != "__main__":
            parts = module.name.split(".")
            self.todo += [(".".join(parts[:n]), None) for n in range(1, len(parts) + 1)]
        names = [one.module for one in imports if one.module.partition(".")[0] != "aoabench"]
        self.todo += [(name, None) for name in names if not self._outside(name)]

    def _imported(self, origin: Imported, attributes: Sequence[str]) -> Iterator[Root]:
        """The definitions behind an imported name and the attributes taken from it."""
        inner = origin.module
        names = [*([origin.name] if origin.name else []), *attributes]
        if self._outside(inner):
            return
        for name in names:
            if not _is_module(f"{inner}.{name}"):
                yield inner, name
                return
            inner = f"{inner}.{name}"
        yield from self._whole(inner)

    def _whole(self, module: str) -> Iterator[Root]:
        """All definitions of a module that is used as a value."""
        known = None if _is_aside(module) else self._module(module)
        yield from ((module, name) for name in (known.names if known else ()))

    def _unbound(self, module: Module, name: str) -> Iterator[Root]:
        """The definition behind a name that a user's module neither defines nor imports by name: a
        builtin or a local variable has none.
        """
        for star in module.stars:
            known = None if self._outside(star) else self._module(star)
            if known is not None and (name in known.names or name in known.imports):
                yield star, name
        live = sys.modules.get(module.name)
        if live is not None and name in vars(live) and name not in vars(builtins):
            yield module.name, name

    def _elsewhere(self, module: Module, name: str) -> Iterator[Root]:
        """The definition behind a name that a module imports, or makes when it is imported."""
        if name in module.imports:
            yield from self._imported(module.imports[name], ())
            return
        value = getattr(sys.modules.get(module.name, builtins), name, None)  # lazy ones too
        if isinstance(value, type | FunctionType) and value.__module__ != module.name:
            yield value.__module__, value.__qualname__.partition(".")[0]
        elif not module.shipped:
            yield module.name, None

    def _note(self, text: str) -> None:
        if text not in self.found.unseen:
            self.found.unseen.append(text)


def _is_aside(module: str) -> bool:
    inner = module.removeprefix("aoabench.")
    return inner != module and any(inner == a or inner.startswith(f"{a}.") for a in _ASIDE)


def _kernels(texts: Iterable[str]) -> Iterator[Root]:
    """The entry points of kernel modules that texts name as `kernels.loading` takes them."""
    for text in texts:
        name = f"aoabench.{text}"
        if text.startswith("kernels.") and (source := loaded.source(name)):
            module = parsed(name, source)
            yield from ((name, one) for one in (module.names if module else ()))


def _is_module(name: str) -> bool:
    return loaded.spec_of(name) is not None


@cache
def _distributions(top: str) -> tuple[str, ...]:
    """The installed distributions that hold an importable name."""
    if version(top) is not None:
        return (top,)
    return tuple(sorted(set(_all_distributions().get(top, ()))))


@cache
def _all_distributions() -> dict[str, list[str]]:
    return dict(metadata.packages_distributions())
