"""Every command and every piece of Python in README.md and docs/ runs, page by page and in order.

A block under the comment `<!-- not run: WHY -->` is only parsed: its commands and options exist, and
the overrides of `aoabench run` compose.
"""

import re
import sys
from collections import defaultdict
from types import ModuleType

import pytest

from tests.docs import snippets

WITH_BLOCKS = [page for page in snippets.PAGES if any(snippets.blocks(page))]


def names(pages):
    return [page.relative_to(snippets.ROOT).as_posix() for page in pages]


def check(command, call):
    snippets.check(command)
    words = snippets.simple(command)
    if words and words[0] in snippets.AOABENCH and words[1] == "run":
        status, _, error = call(*snippets.arguments(words[1:]))
        assert status == 0, error


@pytest.mark.parametrize("page", WITH_BLOCKS, ids=names(WITH_BLOCKS))
def test_a_page_runs_from_top_to_bottom(page, call, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("joblib.cpu_count", lambda: 1)  # no processes to start
    module = ModuleType("snippets_of_the_page")
    monkeypatch.setitem(sys.modules, module.__name__, module)
    for block in snippets.blocks(page):
        where = f"{page.name}:{block.line}"
        assert block.kind in snippets.KINDS, f"{where}: a block of the kind {block.kind!r}"
        if block.kind in snippets.SHELL:
            for command in block.commands:
                if block.not_run:
                    check(command, call)
                else:
                    run(command, call, tmp_path, where)
        elif block.kind == "python" and not block.not_run:
            file = tmp_path / f"line_{block.line}.py"
            file.write_text(block.text, encoding="utf-8")
            exec(compile(block.text, str(file), "exec"), vars(module))
            file.unlink()
        else:
            snippets.check_text(block)
    if page.name == "README.md":  # whose reader stands in a checkout
        made = {path.name for folder in (".", "results") for path in (tmp_path / folder).iterdir()}
        assert made <= {"results", ".venv", "raw", "quick", "draft"}, (
            "files that git does not ignore"
        )


def run(command, call, folder, where):
    words = snippets.simple(command)
    if words and words[0] in snippets.AOABENCH:
        status, out, error = call(*words[1:])
        assert status == 0, f"{where}: {command}\n{out}{error}"
    elif words and words[0] == "make":
        pytest.fail(f"{where}: `{command}` needs the comment `not run`")
    else:
        snippets.shell(command, folder)


def test_pages_share_a_folder_only_for_the_same_run():
    """A reader who follows several pages has the tables and pictures that each of them describes."""
    runs = defaultdict(set)
    for page in WITH_BLOCKS:
        mine = defaultdict(set)
        for block in snippets.blocks(page):
            for command in block.commands if block.kind in snippets.SHELL else ():
                words = [
                    w for w in command.partition(" #")[0].split() if not w.startswith("--worst")
                ]
                for word in words:
                    if word.startswith("runner.out=results/"):
                        mine[word[11:]].add(" ".join(words).removeprefix(".venv/bin/"))
            for call in re.findall(r"aoabench\.run\((.*?)\)\n", block.text, re.S):
                for out in re.findall(r'out="(results/\S*)"', call):
                    mine[out].add("".join(call.split()))
        for out, commands in mine.items():
            runs[out].add(frozenset(commands))
    assert len(runs) > 10
    assert {out: found for out, found in runs.items() if len(found) > 1} == {}
