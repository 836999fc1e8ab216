"""The committed notebooks: outputs kept, public names alone, and a gallery of all of them."""

import ast
import base64
import json
import re
from pathlib import Path

import pytest

import aoabench

FOLDER = Path(__file__).parents[2] / "results" / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))


def cells(notebook, kind):
    found = json.loads(notebook.read_text(encoding="utf-8"))["cells"]
    return [cell for cell in found if cell["cell_type"] == kind]


def tree(notebook):
    """The syntax tree of all code, without IPython's own lines."""
    lines = "".join(f"{''.join(cell['source'])}\n" for cell in cells(notebook, "code"))
    return ast.parse(re.sub(r"^%.*$", "", lines, flags=re.MULTILINE))


def pictures(notebook):
    outputs = [output for cell in cells(notebook, "code") for output in cell["outputs"]]
    texts = [output.get("data", {}).get("image/png") for output in outputs]
    return [base64.b64decode(text) for text in texts if text]


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda n: n.stem)
def test_a_notebook_is_executed_from_top_to_bottom_and_keeps_its_pictures(notebook):
    code = cells(notebook, "code")
    assert [cell["execution_count"] for cell in code] == list(range(1, len(code) + 1))
    outputs = [output for cell in code for output in cell["outputs"]]
    assert not [output for output in outputs if output["output_type"] == "error"]
    assert pictures(notebook)


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda n: n.stem)
def test_a_notebook_uses_no_private_name(notebook):
    for node in ast.walk(tree(notebook)):
        names = [node.attr] if isinstance(node, ast.Attribute) else []
        if isinstance(node, ast.Import | ast.ImportFrom):
            names = [part for alias in node.names for part in alias.name.split(".")]
            names += (node.module or "").split(".") if isinstance(node, ast.ImportFrom) else []
        private = [name for name in names if name.startswith("_")]
        assert not private, (notebook.name, private)


def test_explore_needs_nothing_but_the_public_functions():
    found = tree(FOLDER / "explore.ipynb")
    modules = {a.name for n in ast.walk(found) if isinstance(n, ast.Import) for a in n.names}
    modules |= {n.module for n in ast.walk(found) if isinstance(n, ast.ImportFrom)}
    assert modules == {"aoabench", "pandas", "pathlib"}
    uses = [n for n in ast.walk(found) if isinstance(n, ast.Attribute)]
    used = {n.attr for n in uses if isinstance(n.value, ast.Name) and n.value.id == "aoabench"}
    assert used == {"run", "compare", "plot"}
    assert used <= set(aoabench.__all__)


def test_the_gallery_shows_every_notebook():
    text = (FOLDER / "README.md").read_text(encoding="utf-8")
    shown = re.findall(r"\[!\[[^]]{20,}\]\(([^)]+)\)\]\((\w+\.ipynb)\)", text)
    assert sorted(target for _, target in shown) == [notebook.name for notebook in NOTEBOOKS]
    for picture, _ in shown:
        assert (FOLDER / picture).is_file(), picture
    assert (FOLDER / "explore.png").read_bytes() == pictures(FOLDER / "explore.ipynb")[0]
