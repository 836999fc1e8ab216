"""The structure: imports go downward only, dynamic ones included; rooms and functions stay small.

A room is a file or folder of `aoabench/`; `experiments` and `benchmarks` are rooms too.
"""

import ast
import io
import subprocess
import sys
import tokenize
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "aoabench"

# from top to bottom; a file imports from its own room and from rooms on lines below
WINGS = [
    ("cli", "benchmarks"),
    ("studies",),
    ("experiments",),
    ("__init__",),
    ("deployment", "testing"),
    ("engine",),
    ("config",),
    ("filters", "estimators", "scenarios", "noise", "report"),
    ("models", "devices", "store", "bounds", "kernels"),
    ("cell",),
    ("roles",),
    ("params",),
    ("types", "errors"),
    ("streams",),
    ("maths", "resources", "columns", "loaded"),
]
RANK = {room: rank for rank, rooms in enumerate(WINGS) for room in rooms}

# the same within `aoabench/devices`
DEVICES = [("plans", "tracks"), ("anchors", "longtable"), ("locators", "geodesy"), ("readers",)]

# what a file imports by a name that is only known when it runs, and how many such calls it has
DYNAMIC = {
    "aoabench/config/plugins.py": (2, ("scenarios", "noise", "models", "filters", "estimators")),
    "aoabench/studies/study.py": (2, ("experiments",)),
    "aoabench/kernels/loading.py": (2, ("kernels",)),
    "aoabench/engine/dask.py": (1, ()),  # the modules of plug-ins, on the scheduler
}
MOST_ROOMS = 27
FILES = sorted(
    file
    for folder in ("aoabench", "experiments", "benchmarks")
    for file in (ROOT / folder).rglob("*.py")
)
NAMES = [file.relative_to(ROOT).as_posix() for file in FILES]


@cache
def tree_of(file):
    return ast.parse(file.read_text(encoding="utf-8"))


def module_of(file):
    parts = list(file.relative_to(ROOT).with_suffix("").parts)
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_of(file): file for file in FILES}


def room_of(module):
    """The room that a module of ours lies in; None for other modules."""
    head, *rest = module.split(".")
    if head in ("experiments", "benchmarks"):
        return head
    return (rest[0] if rest else "__init__") if head == "aoabench" else None


def imported(file):
    """Full names of the modules that a file imports, wherever in the file."""
    package = module_of(file).split(".")[: None if file.name == "__init__.py" else -1]
    for node in ast.walk(tree_of(file)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = [*package[: len(package) + 1 - node.level], *filter(None, [node.module])]
            name = ".".join(base) if node.level else node.module
            inner = [f"{name}.{alias.name}" for alias in node.names]
            found = [one for one in inner if one in MODULES]
            yield from found
            if len(found) < len(inner):
                yield name


def test_every_room_has_a_place_and_there_are_not_too_many():
    rooms = {room_of(module) for module in MODULES}
    assert rooms == set(RANK)
    assert len(rooms - {"experiments", "benchmarks"}) <= MOST_ROOMS


@pytest.mark.parametrize("file", FILES, ids=NAMES)
def test_imports_go_downward(file):
    mine = room_of(module_of(file))
    dynamic = DYNAMIC.get(file.relative_to(ROOT).as_posix(), (0, ()))[1]
    for room in (*filter(None, map(room_of, imported(file))), *dynamic):
        if room != mine and not (mine == "config" and room in dynamic):
            assert RANK[room] > RANK[mine], f"{file.relative_to(ROOT)} imports {room}"
    for room in dynamic:
        assert RANK[room] > RANK[mine] or room == mine


def test_imports_within_devices_go_downward():
    rank = {place: rank for rank, places in enumerate(DEVICES) for place in places}
    inside = {tuple(m.split(".")[2:]): f for m, f in MODULES.items() if room_of(m) == "devices"}
    assert {place for place, *_ in filter(None, inside)} == set(rank)
    for (mine, *_), file in ((place, file) for place, file in inside.items() if place):
        for name in imported(file):
            if room_of(name) == "devices" and (other := name.split(".")[2]) != mine:
                assert rank[other] > rank[mine], f"{file.relative_to(ROOT)} imports {other}"


def test_no_file_imports_itself_by_a_detour():
    arrows = {module: set(imported(file)) & set(MODULES) for module, file in MODULES.items()}
    while leaves := {module for module, targets in arrows.items() if not targets}:
        arrows = {m: targets - leaves for m, targets in arrows.items() if m not in leaves}
    assert not arrows, f"circle among {sorted(arrows)}"


def test_dynamic_imports_are_declared():
    found = {}
    for name, file in zip(NAMES, FILES):
        calls = [n.func for n in ast.walk(tree_of(file)) if isinstance(n, ast.Call)]
        texts = [ast.unparse(function) for function in calls]
        dynamic = ("import_module", "spec_from_file_location", "exec_module", "__import__")
        texts = [text for text in texts if text != "super().exec_module"]  # of a loader
        count = sum(text.rpartition(".")[2] in dynamic for text in texts)
        if count:
            found[name] = count
    assert found == {name: count for name, (count, _) in DYNAMIC.items()}


def test_only_one_wing_knows_hydra():
    for file in FILES:
        if room_of(module_of(file)) != "config":
            hydra = [n for n in imported(file) if n.split(".")[0] in ("hydra", "omegaconf")]
            assert not hydra, file


@pytest.mark.parametrize("file", FILES, ids=NAMES)
def test_files_and_functions_stay_small(file):
    """300 lines a file, 40 lines of code a function (docstring, comments and blank lines apart);
    350 and 80 for kernels.
    """
    lines, code = (350, 80) if "kernels" in file.parts else (300, 40)
    text = file.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= lines
    skipped = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT}
    used = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in skipped:
            used |= set(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef):
            own = set(range(node.lineno, node.end_lineno + 1))
            if ast.get_docstring(node):
                own -= set(range(node.body[0].lineno, node.body[0].end_lineno + 1))
            assert len(own & used) <= code, f"{node.name}: {len(own & used)} lines of code"


HEAVY = ["pandas", "matplotlib", "scipy", "pyarrow", "hydra", "joblib", "numba"]


@pytest.mark.parametrize(
    ("code", "absent"),
    [
        ("import aoabench", [*HEAVY, "rich"]),
        ("import aoabench.cli.main", [*HEAVY, "rich"]),
        ("from aoabench.cli.main import dispatch; dispatch(['list'])", HEAVY),
    ],
)
def test_heavy_imports_only_where_used(code, absent):
    script = f"{code}\nimport sys\nprint('LOADED', *[m for m in {absent!r} if m in sys.modules])"
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines()[-1].split() == ["LOADED"]


def test_no_pickle_and_no_eval():
    """Only the tests of plug-ins pickle, an object of this process on its way to a copy of it."""
    for file in FILES:
        may = file == PACKAGE / "testing" / "copies.py"
        assert may or not {"pickle", "cloudpickle", "dill"} & set(imported(file)), file
        calls = [n.func for n in ast.walk(tree_of(file)) if isinstance(n, ast.Call)]
        names = {function.id for function in calls if isinstance(function, ast.Name)}
        allowed = {"compile"} if file.name == "loaded.py" else set()  # to compare, not to run
        assert not names & {"eval", "exec", "compile", "__import__"} - allowed, file
