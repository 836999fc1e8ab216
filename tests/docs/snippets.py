"""The commands and Python code that README.md, CONTRIBUTING.md and docs/ show."""

import ast
import importlib.util
import os
import re
import shlex
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import yaml
from markdown_it import MarkdownIt

from aoabench.cli.main import cli

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
SHELL = ("console", "sh")
KINDS = (*SHELL, "python", "yaml", "text")
NOT_RUN = re.compile(r"<!-- not run: (.+?) -->\s*$")
AOABENCH = ("aoabench", ".venv/bin/aoabench")
MAKEFILE = (ROOT / "Makefile").read_text(encoding="utf-8")


@dataclass(frozen=True)
class Block:
    """A fenced block: its kind, text and line in the page, and why it is not run, if it is not."""

    kind: str
    text: str
    line: int
    not_run: str = ""

    @property
    def commands(self):
        """The commands of a block for a shell: with a prompt in a console, else every line."""
        lines = re.sub(r"\\\n\s*", "", self.text).splitlines()
        if self.kind == "console":
            return [line[2:] for line in lines if line.startswith("$ ")]
        return [line for line in lines if line.strip() and not line.startswith("#")]


def tokens(page):
    return MarkdownIt("commonmark").enable("table").parse(page.read_text(encoding="utf-8"))


def blocks(page):
    """The fenced blocks of a page."""
    before = ""
    for token in tokens(page):
        if token.type == "fence":
            found = NOT_RUN.match(before)
            yield Block(token.info, token.content, token.map[0] + 1, found[1] if found else "")
        before = token.content if token.type == "html_block" else ""


def inline(page):
    """The commands of aoabench and make that a page's sentences and tables show."""
    for token in tokens(page):
        for child in token.children or []:
            if child.type == "code_inline" and child.content.startswith(("aoabench ", "make ")):
                yield child.content


def words_of(command):
    """The words of a command as a shell has them; operators such as > are words of their own."""
    lexer = shlex.shlex(command, posix=True, punctuation_chars=True)
    lexer.whitespace_split = True
    return list(lexer)


def simple(command):
    """The words of a command that needs no shell, or None."""
    plain = re.sub(r"'[^']*'", "", command.partition(" #")[0])
    return None if re.search(r"[|<>;&*$`~()]", plain) else words_of(command)


def check(command):
    """Assert that a command could run: its parts exist, and what it composes to does too."""
    parts, part = [], []
    for word in [*words_of(command), ";"]:
        if re.fullmatch(r"[|;&<>()]+", word):
            parts.append(part)
            part = []
        else:
            part.append(word)
    for words in filter(None, parts):
        if words[0] in AOABENCH:
            check_aoabench(words[1:])
        elif words[0] == "make":
            check_make(words[1:])
        elif words[0].endswith("python") and words[1:2] == ["-m"]:
            assert importlib.util.find_spec(words[2]), command
    subprocess.run(["bash", "-n", "-c", command], check=True)


def check_aoabench(words):
    """Assert that command and options exist."""
    name = next((word for word in words if not word.startswith("-")), None)
    flags = [word.partition("=")[0] for word in words if re.match(r"--?[a-zA-Z]", word)]
    known = {flag for p in cli.params for flag in p.opts} | {"-h", "--help"}
    if name is not None and not name.isupper():
        assert name in cli.commands, f"aoabench {name}: no such command"
        known |= {flag for p in cli.commands[name].params for flag in p.opts}
    assert set(flags) <= known, f"aoabench {' '.join(words)}: {set(flags) - known}"


def arguments(words):
    """The arguments with which `run` is called to print what it composes to, and computes nothing."""
    return [*(word for word in words if word != "..."), "--cfg", "job"]


def check_make(words):
    targets = re.search(r"^\.PHONY: (.*)$", MAKEFILE, re.MULTILINE)[1].split()
    for word in words:
        name, is_variable, _ = word.partition("=")
        wanted = rf"\b{name}\b" if is_variable else None
        assert name in targets if wanted is None else re.search(wanted, MAKEFILE), f"make {word}"


def check_text(block):
    """Assert that a block which is not run can be read."""
    if block.kind == "python":
        ast.parse(block.text)
    elif block.kind == "yaml":
        yaml.safe_load(block.text)


def shell(command, folder):
    """Run a command in a shell in a folder in which .venv/bin has aoabench and python."""
    binaries = folder / ".venv" / "bin"
    if not binaries.exists():
        binaries.mkdir(parents=True)
        for name, words in (("aoabench", "-m aoabench.cli "), ("python", "")):
            (binaries / name).write_text(f'#!/bin/sh\nexec "{sys.executable}" {words}"$@"\n')
            (binaries / name).chmod(0o755)
    path = f"{binaries}{os.pathsep}{os.environ['PATH']}"
    places = [str(ROOT), os.environ.get("PYTHONPATH", "")]
    environment = {**os.environ, "PATH": path, "PYTHONPATH": os.pathsep.join(filter(None, places))}
    done = subprocess.run(
        ["bash", "-ec", command], cwd=folder, env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, f"{command}\n{done.stdout}{done.stderr}"
