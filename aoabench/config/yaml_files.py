"""YAML files of configs, read as Hydra reads them, within bounds that are checked beforehand."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from aoabench.errors import shorten

MOST_BYTES = 250_000  # of a file
MOST_NODES = 10_000  # values of a file, each alias counted as what it stands for
MOST_LEVELS = 30  # of nested lists and mappings, aliases too
MOST_REFERENCES = 20  # interpolations ${...} in one text
LONGEST_OPEN = 1_000  # characters of a text with interpolations

_PLAIN = (bool, int, float, str, type(None))
_KINDS = "texts, numbers, true, false, null, lists and mappings"


class Unreadable(Exception):
    """A file is no config; the text is the reason."""


def load(file: Path) -> Any:
    """The nodes of a YAML file, {} for an empty one; Unreadable if Hydra could not compose them, or
    if they exceed the bounds.
    """
    import yaml
    from omegaconf._utils import get_yaml_loader  # OmegaConf.load takes this one

    try:
        text = _text(file)
        _check_size(text, get_yaml_loader())
        nodes = yaml.load(text, Loader=get_yaml_loader())  # a SafeLoader
    except yaml.MarkedYAMLError as error:
        raise Unreadable(_complaint(error)) from None
    except yaml.reader.ReaderError as error:
        raise Unreadable(f"character {error.position}: {error.reason}") from None
    except (OSError, yaml.YAMLError, ValueError) as error:
        raise Unreadable(shorten(" ".join(str(error).split()))) from None
    for path, value in _leaves(nodes, ""):
        _check_value(path, value)
    return {} if nodes is None else nodes


def _text(file: Path) -> str:
    """The text of a file; Unreadable if it is too long."""
    size = file.stat().st_size
    if size > MOST_BYTES:
        raise Unreadable(f"{size} bytes; allowed: at most {MOST_BYTES}")
    return file.read_text(encoding="utf-8")


def _complaint(error: Any) -> str:
    """The line and the problem of an error of the YAML parser."""
    mark = error.problem_mark or error.context_mark
    line = f"line {mark.line + 1}: " if mark else ""
    if str(error.context).startswith("expected a single document"):
        return f"{line}a second document begins; allowed: one"
    key = str(error.problem).removeprefix("found duplicate key ")
    if key != error.problem:
        return f"{line}the key {shorten(repr(key), 80)} is given twice"
    return f"{line}{shorten(str(error.problem or error.context), 120)}"


def _check_size(text: str, loader: Any) -> None:
    """Raise Unreadable for a document that exceeds the bounds or contains itself.

    The parser's events are counted as they come, so that nothing large is built.
    """
    import yaml

    opened: list[_Counted] = []
    known: dict[str, _Counted] = {}
    total = _Counted(None)
    for event in yaml.parse(text, Loader=loader):
        anchor = event.anchor if isinstance(event, yaml.NodeEvent) else None
        node = _Counted(anchor)
        where = f"line {event.start_mark.line + 1}" if event.start_mark else "line 1"
        if isinstance(event, yaml.AliasEvent):
            if any(one.anchor == anchor for one in opened):
                raise Unreadable(f"{where}: *{shorten(str(anchor), 80)} contains itself")
            node = known.get(str(anchor), node)
        elif isinstance(event, yaml.CollectionStartEvent):
            opened.append(node)
            if len(opened) > MOST_LEVELS:
                raise Unreadable(f"{where}: more than {MOST_LEVELS} nested levels")
            continue
        elif isinstance(event, yaml.CollectionEndEvent):
            node = opened.pop()
        elif isinstance(event, yaml.ScalarEvent):
            _check_text(event.value, where)
        else:
            continue
        if node.anchor is not None:
            known[node.anchor] = node
        (opened[-1] if opened else total).add(node)
        if sum(one.nodes for one in opened) + total.nodes > MOST_NODES:
            raise Unreadable(
                f"{where}: more than {MOST_NODES} values, aliases counted; "
                "allowed: a table in a CSV file, by its name"
            )
        if len(opened) + node.levels > MOST_LEVELS:
            raise Unreadable(f"{where}: more than {MOST_LEVELS} nested levels")


class _Counted:
    """A node of a document: its anchor, the number of values in it, and of levels below it."""

    def __init__(self, anchor: str | None) -> None:
        self.anchor, self.nodes, self.levels = anchor, 1, 0

    def add(self, child: _Counted) -> None:
        self.nodes += child.nodes
        self.levels = max(self.levels, child.levels + 1)


def _check_text(text: str, where: str) -> None:
    """Raise Unreadable for a text with more or longer interpolations than allowed."""
    if text.count("${") > MOST_REFERENCES:
        raise Unreadable(f"{where}: more than {MOST_REFERENCES} interpolations ${{...}} in a text")
    if "${" in text and len(text) > LONGEST_OPEN:
        raise Unreadable(
            f"{where}: an interpolation ${{...}} in a text of more than {LONGEST_OPEN} characters"
        )


def _leaves(node: Any, path: str) -> Iterator[tuple[str, Any]]:
    """All values that are neither lists nor mappings, and keys that are no texts or numbers."""
    if isinstance(node, dict):
        for key, value in node.items():
            if not isinstance(key, _PLAIN) or key is None or not str(key).isprintable():
                raise Unreadable(
                    f"the key {shorten(repr(key), 80)} is not allowed; allowed: a printable text"
                )
            yield from _leaves(value, f"{path}.{key}" if path else str(key))
    elif isinstance(node, list):
        for number, value in enumerate(node):
            yield from _leaves(value, f"{path}[{number}]")
    else:
        yield path, node


def _check_value(path: str, value: Any) -> None:
    """Raise Unreadable for a value of a type that configs cannot hold, or one too long to show."""
    from omegaconf.errors import GrammarParseError
    from omegaconf.grammar_parser import parse

    name = shorten(repr(path), 80)
    if not isinstance(value, _PLAIN):
        raise Unreadable(f"{name} is a {type(value).__name__}; allowed: {_KINDS}")
    if isinstance(value, int) and value.bit_length() > 1_000:
        raise Unreadable(f"{name}: a number of more than 300 digits")
    if isinstance(value, str) and "${" in value:
        try:
            parse(value)
        except (GrammarParseError, RecursionError):
            raise Unreadable(
                f"{name}: the interpolation {shorten(repr(value), 80)} cannot be read; "
                "allowed: ${KEY}, the path of another key"
            ) from None
