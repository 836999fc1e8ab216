"""The definitions of a module's source: what each computes, and the names that it uses.

Text for people does not count: docstrings, annotations, the arguments of exceptions, printed lines;
in aoabench itself also checks of parameters, `__repr__` and every text of several words.
"""

from __future__ import annotations

import ast
import copy
import functools
import hashlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

from aoabench import loaded

_ERRORS = ("BadValue", "UserError", "RunError", "Unfit")
_PRINTS = ("print", "warn", "say")
_KEPT = ("ClassVar", "InitVar", "KW_ONLY")  # annotations that change what a dataclass is
# names that make a result depend on what no key can hold
_RUNS_TEXT = ("exec", "eval", "__import__", "importlib", "pkgutil", "runpy", "ctypes", "subprocess")
_ENVIRONMENT = ("environ", "environb", "getenv", "getenvb")
_READS = (
    *("open", "__file__", "read_text", "read_bytes", "load", "loadtxt", "genfromtxt", "fromfile"),
    *("memmap", "read_csv", "read_parquet", "read_json", "read_excel", "read_table", "read_pickle"),
    *("loadmat", "imread", "urlopen"),
)


@dataclass(frozen=True)
class Use:
    """A name that a definition uses, with the attributes taken from it: np.linalg.norm."""

    name: str
    attributes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Imported:
    """The origin of an imported name: a module, or `name` in a module."""

    module: str
    name: str | None = None


@dataclass(frozen=True)
class Definition:
    """A function, a class, or the assignments to one name, at the top level of a module.

    imports: the names that it imports itself. texts: its strings of one word. unseen: reasons why
    no key can hold everything that it depends on; `reads` are those that a list of files removes.
    nodes: its statements.
    """

    digest: str
    uses: tuple[Use, ...]
    imports: Mapping[str, Imported]
    texts: tuple[str, ...]
    unseen: tuple[str, ...]
    reads: tuple[str, ...]
    nodes: tuple[ast.stmt, ...]


class Module:
    """The parsed source of a module; `stars` are the modules that it imports everything from."""

    def __init__(self, name: str, source: loaded.Source) -> None:
        self.name, self.source = name, source
        self.shipped = name.partition(".")[0] == "aoabench"
        self.package = name if source.path.name == "__init__.py" else name.rpartition(".")[0]
        self._nodes: dict[str, list[ast.stmt]] = {}
        self._rest: list[ast.stmt] = []
        self._known: dict[str | None, Definition] = {}
        for node in ast.parse(source.content).body:
            self._sort(node)
        self.imports = dict(self._imported(self._rest))
        self.stars = [i.module for name, i in self.imports.items() if name.startswith("*")]

    def _sort(self, node: ast.stmt) -> None:
        """Enter a statement of the module's top level under the names that it defines."""
        names: list[str] = []
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            names = [node.name]
        elif isinstance(node, ast.Assign | ast.AnnAssign | ast.AugAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            flat = [n for t in targets for n in (t.elts if isinstance(t, ast.Tuple) else [t])]
            if all(isinstance(n, ast.Name) for n in flat):
                names = [n.id for n in flat if isinstance(n, ast.Name)]
        for name in names:
            self._nodes.setdefault(name, []).append(node)
        if not names and not _for_checkers(node):
            self._rest.append(node)

    @property
    def names(self) -> list[str]:
        """Names defined at the top level."""
        return list(self._nodes)

    def nodes(self, name: str) -> list[ast.stmt]:
        """The statements that define a name."""
        return self._nodes[name]

    def definition(self, name: str | None) -> Definition:
        """A definition by its name; None: all statements of the module that define no name."""
        if name not in self._known:
            self._known[name] = self._analysed(self._rest if name is None else self._nodes[name])
        return self._known[name]

    def _analysed(self, nodes: list[ast.stmt]) -> Definition:
        if nodes is self._rest:
            nodes = [n for n in nodes if not isinstance(n, ast.Import | ast.ImportFrom)]
        whole = tuple(map(_outline, nodes))
        bare = _Bare(self.shipped)
        stripped = [s for node in nodes if (s := bare.visit(node)) is not None]
        everything = [n for node in stripped for n in ast.walk(node)]
        names = {n.id for n in everything if isinstance(n, ast.Name)}
        attributes = {n.attr for n in everything if isinstance(n, ast.Attribute)}
        texts = {n.value for n in everything if isinstance(n, ast.Constant)}
        content = "\n".join(map(ast.dump, stripped))
        unseen, reads = ((), ()) if self.shipped else _concerns(names, attributes)
        return Definition(
            hashlib.blake2b(content.encode(), digest_size=16).hexdigest(),
            tuple(sorted(set(_uses(stripped)), key=repr)),
            dict(self._imported(stripped)),
            tuple(sorted(t for t in texts if isinstance(t, str) and t.strip())),
            unseen,
            reads,
            whole,
        )

    def _imported(self, nodes: Iterable[ast.stmt]) -> Iterator[tuple[str, Imported]]:
        """The names that statements import, wherever in them, with their origin."""
        for node in (n for top in nodes for n in ast.walk(top)):
            if isinstance(node, ast.Import):
                for alias in node.names:
                    bound = alias.asname or alias.name.partition(".")[0]
                    yield bound, Imported(alias.name if alias.asname else bound)
                    if not alias.asname and "." in alias.name:  # a module that is imported with it
                        yield f"{alias.name} ", Imported(alias.name)
            elif isinstance(node, ast.ImportFrom):
                base = self._absolute(node)
                for alias in node.names:
                    if alias.name == "*":
                        yield f"* {base}", Imported(base)
                    else:
                        yield alias.asname or alias.name, Imported(base, alias.name)

    def _absolute(self, node: ast.ImportFrom) -> str:
        parts = self.package.split(".") if node.level else []
        parts = parts[: len(parts) + 1 - node.level] if node.level else []
        return ".".join([*parts, *filter(None, [node.module])])


def parsed(name: str, source: loaded.Source) -> Module | None:
    """The parsed source of a module; None if it is no Python."""
    return _parsed(name, source.digest, source)


@functools.lru_cache(maxsize=512)
def _parsed(name: str, _digest: str, source: loaded.Source) -> Module | None:
    try:
        return Module(name, source)
    except (SyntaxError, ValueError):
        return None


def _outline(node: ast.stmt) -> ast.stmt:
    """A copy of a statement whose assignments keep their text; the code of functions is shared."""
    if isinstance(node, ast.ClassDef):
        node = copy.copy(node)
        node.body = [_outline(inner) for inner in node.body]
        return node
    return copy.deepcopy(node) if isinstance(node, ast.Assign | ast.AnnAssign) else node


def _for_checkers(node: ast.stmt) -> bool:
    """Whether a statement is there for people and type checkers: a docstring, TYPE_CHECKING."""
    if isinstance(node, ast.Expr):
        return isinstance(node.value, ast.Constant)
    return isinstance(node, ast.If) and ast.unparse(node.test).endswith("TYPE_CHECKING")


def _uses(nodes: Iterable[ast.stmt]) -> Iterator[Use]:
    """The names that statements use, each with the attributes taken from it."""
    todo: list[ast.AST] = list(nodes)
    while todo:
        node = todo.pop()
        attributes: list[str] = []
        inner: ast.AST = node
        while isinstance(inner, ast.Attribute):
            attributes.append(inner.attr)
            inner = inner.value
        if isinstance(inner, ast.Name):
            yield Use(inner.id, tuple(reversed(attributes)))
        elif inner is not node:
            todo.append(inner)
        else:
            todo += ast.iter_child_nodes(node)


def _concerns(names: set[str], attributes: set[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Why no key can hold everything that code with these names depends on: reasons that stay, and
    those that a list of files removes.
    """
    unseen = [f"uses {name}" for name in sorted(names & set(_RUNS_TEXT))]
    found = sorted((names | attributes) & set(_ENVIRONMENT))
    unseen += [f"reads environment variables ({name})" for name in found]
    reads = [f"reads a file ({name})" for name in sorted((names | attributes) & set(_READS))]
    return tuple(unseen), tuple(reads)


class _Bare(ast.NodeTransformer):
    """Removes what computes nothing; `shipped`: aoabench's own code."""

    def __init__(self, shipped: bool) -> None:
        self.shipped = shipped

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST | None:
        return None if self.shipped and node.name == "__repr__" else self._function(node)

    def visit_AsyncFunctionDef(self, node: ast.AsyncFunctionDef) -> ast.AST:
        return self._function(node)

    def _function(self, node: ast.FunctionDef | ast.AsyncFunctionDef) -> ast.AST:
        node.returns = None
        return self.visit_ClassDef(node)

    def visit_ClassDef(self, node: ast.AST) -> ast.AST:
        first = next(iter(node.body), None)  # type: ignore[attr-defined]
        if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant):
            node.body = node.body[1:]  # type: ignore[attr-defined]
        return self.generic_visit(node)

    def visit_arg(self, node: ast.arg) -> ast.AST:
        node.annotation = None
        return node

    def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.AST:
        text = ast.unparse(node.annotation)
        if not any(word in text for word in _KEPT):
            node.annotation = ast.Constant(None)
        return self.generic_visit(node)

    def visit_Raise(self, node: ast.Raise) -> ast.AST:
        if isinstance(node.exc, ast.Call):
            node.exc = node.exc.func
        return self.generic_visit(node)

    def visit_Expr(self, node: ast.Expr) -> ast.AST | None:
        called = _called(node.value)
        if called in _PRINTS or (self.shipped and called.startswith("check_")):
            return None
        return self.generic_visit(node)

    def visit_Call(self, node: ast.Call) -> ast.AST:
        if _called(node) in _ERRORS:
            node.args, node.keywords = [], []
        return self.generic_visit(node)

    def visit_Constant(self, node: ast.Constant) -> ast.AST:
        wordy = isinstance(node.value, str) and len(node.value.split()) > 1
        return ast.Constant("") if self.shipped and wordy else node

    def visit_JoinedStr(self, node: ast.JoinedStr) -> ast.AST:
        parts = [v.value for v in node.values if isinstance(v, ast.Constant)]
        wordy = any(any(c.isspace() for c in str(part)) for part in parts)
        return ast.Constant("") if self.shipped and wordy else self.generic_visit(node)


def _called(node: ast.AST) -> str:
    """The last name of the function that a node calls; "" for another node."""
    function = node.func if isinstance(node, ast.Call) else None
    if isinstance(function, ast.Attribute):
        return function.attr
    return function.id if isinstance(function, ast.Name) else ""
