"""Imports go downward only, heavy ones only where used, and rooms stay small."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[2] / "aoabench"

# top to bottom; a module may import from its own room and from rooms below
LAYERS = [
    ("cli", "bench"), ("reproducing", "replaying", "comparing"), ("runner",), ("workers",), ("montecarlo",), ("scenarios",), ("noise",), ("models",),
    ("filters",), ("estimators",), ("bounds",), ("metrics",), ("composing",), ("config",), ("report",), ("tables",), ("store",), ("statistics",), ("intervals",), ("kernels",),
    ("types",), ("directional",), ("geometry",), ("streams",),
]  # fmt: skip
RANK = {room: i for i, rooms in enumerate(LAYERS) for room in rooms}
MODULES = sorted(PACKAGE.rglob("*.py"))


def imported(tree):
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield alias.name
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "absolute imports only"
            yield node.module
            if node.module == "aoabench":
                for alias in node.names:
                    yield f"aoabench.{alias.name}"


@pytest.mark.parametrize(
    "file",
    [f for f in MODULES if f.name != "__init__.py"],
    ids=lambda f: str(f.relative_to(PACKAGE)),
)
def test_imports_go_downward(file):
    room = file.relative_to(PACKAGE).parts[0].removesuffix(".py")
    assert room in RANK, f"{room} needs a place in LAYERS"
    for name in imported(ast.parse(file.read_text())):
        parts = name.split(".")
        if parts[0] == "aoabench" and len(parts) > 1 and parts[1] in RANK:
            assert parts[1] == room or RANK[parts[1]] > RANK[room], f"{file.name} imports {name}"


def test_only_composing_knows_hydra():
    for file in MODULES:
        names = set(imported(ast.parse(file.read_text())))
        if file.name != "composing.py":
            assert not {n for n in names if n and n.startswith(("hydra", "omegaconf"))}, file


def test_the_report_never_imports_a_filter():
    for file in (PACKAGE / "report").glob("*.py"):
        for name in imported(ast.parse(file.read_text())):
            assert not name.startswith(
                ("aoabench.filters", "aoabench.models", "aoabench.montecarlo", "aoabench.runner")
            ), file


@pytest.mark.parametrize(("code", "absent"), [
    ("import aoabench", ["pandas", "matplotlib", "scipy", "pyarrow", "hydra", "joblib", "numba", "rich"]),
    ("import aoabench.cli", ["pandas", "matplotlib", "scipy", "pyarrow", "hydra", "joblib", "numba", "rich"]),
    ("from aoabench.cli import dispatch; dispatch(['list'])", ["pandas", "matplotlib", "scipy", "pyarrow", "hydra", "joblib", "numba"]),
])  # fmt: skip
def test_heavy_imports_only_where_used(code, absent):
    script = f"{code}\nimport sys\nprint('LOADED', *[m for m in {absent!r} if m in sys.modules])"
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines()[-1].split() == ["LOADED"]


def test_no_pickle_and_no_eval():
    for file in MODULES:
        tree = ast.parse(file.read_text())
        assert not {"pickle", "cloudpickle", "dill"} & set(imported(tree)), file
        calls = {
            n.func.id
            for n in ast.walk(tree)
            if isinstance(n, ast.Call) and isinstance(n.func, ast.Name)
        }
        assert not calls & {"eval", "exec", "compile", "__import__"}, file
