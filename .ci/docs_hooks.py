"""Hooks of the documentation site: parts of pages that are made from the code, and links that lead
out of docs/.

A page holds a line `<!-- generated: NAME -->`, after which the site has what `PARTS[NAME]` returns.
A file outside docs/ that a page links to is copied to repository/, Markdown as a page of the site.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Iterable, Sequence
from html import escape
from pathlib import Path
from typing import Any

import click
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files, InclusionLevel
from mkdocs.structure.pages import Page

import aoabench
from aoabench import columns
from aoabench.cli.main import cli
from aoabench.config import catalogue
from aoabench.config.presets import options
from aoabench.studies import sections, stored, study

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
SEARCH = ROOT / ".ci" / "search_from_files.js"
COPIED = "repository"  # the folder of the site with files from outside docs/

_FENCE = re.compile(r"(^ *```.*?^ *```[^\n]*$)", re.MULTILINE | re.DOTALL)
_LINK = re.compile(r"(\]\()([^)\s#:]+)((?:#[^)\s]*)?\))")
_SHIM = re.compile(r'<script src="https://unpkg\.com/iframe-worker/[^"]*"></script>')
_PART = re.compile(r"^<!-- generated: (\w+) -->$", re.MULTILINE)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the files outside docs/ that pages link to, and those that these link to."""
    waiting = [DOCS / file.src_uri for file in files.documentation_pages()]
    while waiting:
        page = waiting.pop()
        for target in _targets(page):
            uri = _uri(target)
            if not target.is_relative_to(DOCS) and target.is_file() and uri not in files.src_uris:
                file = File.generated(
                    config, uri, abs_src_path=str(target), inclusion=InclusionLevel.NOT_IN_NAV
                )
                files.append(file)
                if target.suffix == ".md":
                    waiting.append(target)
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Fill the generated parts of a page, and turn links out of docs/ to the copies."""
    source = Path(page.file.abs_src_path or "")
    here = os.path.dirname(page.file.src_uri)
    texts = _FENCE.split(markdown)
    texts[::2] = [_LINK.sub(lambda found: _turned(found, source, here), one) for one in texts[::2]]
    return _PART.sub(lambda found: PARTS[found[1]](), "".join(texts))


def _targets(page: Path) -> Iterable[Path]:
    """The files in the repository that a page links to."""
    for text in _FENCE.split(page.read_text(encoding="utf-8"))[::2]:
        for found in _LINK.finditer(text):
            target = (page.parent / found[2]).resolve()
            if target.is_relative_to(ROOT):
                yield target


def on_post_page(output: str, page: Page, config: MkDocsConfig) -> str:
    """The page of the site with our own script for its search from files (see `_searched`)."""
    return _searched(output)


def on_post_template(output_content: str, template_name: str, config: MkDocsConfig) -> str:
    """The same for 404.html."""
    return _searched(output_content) if template_name.endswith(".html") else output_content


def _searched(html: str) -> str:
    """A page of the plugin `offline` with the script SEARCH inside, in place of the one that
    the plugin loads from another server.
    """
    own = f"<script>\n{SEARCH.read_text(encoding='utf-8')}</script>"
    return _SHIM.sub(lambda _found: own, html)


def _turned(found: re.Match[str], source: Path, here: str) -> str:
    """The link of a page whose file is `source` and whose folder in the site is `here`."""
    target = (source.parent / found[2]).resolve()
    if not target.is_relative_to(ROOT) or not target.exists():
        return found[0]  # which the build reports
    return f"{found[1]}{os.path.relpath(_uri(target), here or '.')}{found[3]}"


def _uri(target: Path) -> str:
    """The place in the site of a file in the repository."""
    inside = target.is_relative_to(DOCS)
    return (
        target.relative_to(DOCS if inside else ROOT).as_posix()
        if inside
        else (f"{COPIED}/{target.relative_to(ROOT).as_posix()}")
    )


def commands() -> str:
    """The help of each command, as `aoabench COMMAND --help` prints it."""
    shown = []
    for name, command in cli.commands.items():
        if not command.hidden:
            with click.Context(
                command,
                info_name=f"aoabench {name}",
                max_content_width=100,
                terminal_width=100,
                help_option_names=["-h", "--help"],
            ) as ctx:
                shown.append(f"## {name}\n\n```text\n{command.get_help(ctx)}\n```\n")
    return "\n".join(shown)


def presets() -> str:
    """The presets of each group with their parameters."""
    shown = []
    for group in ("scenario", "noise", "filter", "estimator"):
        shown.append(f"## {group}\n")
        for name, text in options(group).items():
            shown.append(f"### {name}\n\n{text}.\n")
            rows = [
                (f"`{one.key}`", _value(one.value), one.unit, one.allowed, one.help)
                for one in catalogue.parameters(name)
            ]
            shown.append(_table(("key", "value", "unit", "allowed", "meaning"), rows))
    for group in ("runner", "experiment"):
        rows = [(f"`{group}={name}`", text) for name, text in options(group).items()]
        shown.append(f"## {group}\n\n{_table(('preset', 'meaning'), rows)}")
    return "\n".join(shown)


def tables() -> str:
    """The columns of each stored table."""
    shown = []
    for title, found in columns.TABLES.items():
        rows = [
            (f"`{name}`", kind, columns.unit_of(_statistic(name)), columns.meaning(name))
            for name, kind in found.items()
        ]
        shown.append(f"### {title}\n\n{_table(('column', 'type', 'unit', 'meaning'), rows)}")
    return "\n".join(shown)


def python() -> str:
    """The public functions and classes, for mkdocstrings."""
    return "\n\n".join(f"::: aoabench.{name}" for name in aoabench.__all__)


def errata() -> str:
    """What each study found wrong in print."""
    shown = []
    for name in study.names():
        one = study.load(name)
        if one.errata:
            head = ("id", "where", "printed", "correct", "effect")
            rows = [
                (e["id"], e["where"], e["printed"], e["correct"], e["effect_text"])
                for e in sections.errata(one, _values(one))
            ]
            shown.append(f"## {one.title}\n\n{_table(head, rows)}")
    return "\n".join(shown)


def _values(one: study.Study) -> dict[str, Any]:
    """The numbers of a study's committed tables by their ids."""
    read = (stored.read(one, item, ROOT / "results").values for item in one.items)
    return {key: value for values in read for key, value in values.items()}


PARTS: dict[str, Callable[[], str]] = {
    "commands": commands,
    "presets": presets,
    "tables": tables,
    "python": python,
    "errata": errata,
}


def _value(value: object) -> str:
    """A value of a preset as code, cut where it is long."""
    text = json.dumps(value)
    return f"`{text}`" if len(text) <= 60 else f"`{text[:56]} ...`"


def _statistic(column: str) -> str:
    """The statistic of which a column holds the standard error or an end of the interval."""
    return re.sub(r"_(se|low|high)$", "", column)


def _table(head: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    """A Markdown table."""
    if not rows:
        return ""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(map(_cell, line))} |" for line in lines) + "\n"


def _cell(value: object) -> str:
    """A text as a table's cell: code stands between backquotes, and nothing else is markup."""
    parts = re.split(r"(`[^`]+`)", " ".join(str(value).split()))
    parts[::2] = [re.sub(r"([*_\[])", r"\\\1", escape(part, quote=False)) for part in parts[::2]]
    return "".join(parts).replace("|", "\\|")
