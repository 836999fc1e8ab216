"""The docs: each test that they name exists."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = sorted(
    page for page in (ROOT / "docs").rglob("*.md") if "`test_" in page.read_text(encoding="utf-8")
)


def named(page):
    """(file, test, case) of each test that a page names; a table's head names the file, or the test
    itself does.
    """
    file = None
    for line in page.read_text(encoding="utf-8").splitlines():
        if head := re.search(r"test in `(tests/[\w/]+\.py)`", line):
            file = head[1]
        for found in re.finditer(r"`((?:tests/)?[\w/]+\.py::)?(test_\w+)(?:\[([^\]]+)\])?`", line):
            yield found[1].removesuffix("::") if found[1] else file, found[2], found[3]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_each_test_that_a_page_names_exists(page):
    tests = list(named(page))
    assert len(tests) > 10
    for file, test, case in tests:
        path = ROOT / file if file.startswith("tests/") else ROOT / "tests" / file
        text = path.read_text(encoding="utf-8")
        functions = {n.name for n in ast.walk(ast.parse(text)) if isinstance(n, ast.FunctionDef)}
        assert test in functions, f"{file}::{test}"
        assert case is None or f'"{case}"' in text, f"{file}::{test}[{case}]"
