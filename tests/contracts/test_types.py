"""Types instead of attributes: nobody asks our objects what they have."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FILES = sorted((ROOT / "aoabench").rglob("*.py"))
# of other libraries' exceptions and modules
FOREIGN = {
    ("config/nodes.py", "full_key"),
    ("config/messages.py", "missing_cfg_file"),
    ("config/messages.py", "options"),
    ("engine/faults.py", "strerror"),
    ("devices/readers/foreign.py", "strerror"),
    ("store/live.py", "py_func"),
    ("cli/main.py", None),  # signals that a platform lacks
    ("cli/stopping.py", None),
}


@pytest.mark.parametrize("file", FILES, ids=lambda f: f.relative_to(ROOT).as_posix())
def test_nobody_probes_objects_of_ours(file):
    """`getattr(x, "literal", ...)` and `hasattr` stand in `adopt` alone, which looks at users'
    objects.
    """
    name = file.relative_to(ROOT / "aoabench").as_posix()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Name):
            continue
        if node.func.id in ("getattr", "hasattr") and name != "config/adopt.py":
            literal = node.args[1].value if isinstance(node.args[1], ast.Constant) else None
            asked = literal is not None or node.func.id == "hasattr"
            assert not asked or (name, literal) in FOREIGN, f"{name}:{node.lineno}"


@pytest.mark.parametrize("folder", ["aoabench", "experiments", "benchmarks"])
def test_scenarios_and_cells_have_types(folder):
    for file in (ROOT / folder).rglob("*.py"):
        assert not re.search(r"\b(scenario|cell): Any\b", file.read_text(encoding="utf-8")), file
