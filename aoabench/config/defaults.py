"""Defaults lists of configs: the configs that they name, and that none contains itself."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

from aoabench.errors import UserError, shorten

MOST_CONFIGS = 200  # that one config's defaults list names, those of its configs included
MOST_LEVELS = 20  # of configs that name configs


class Entry(NamedTuple):
    """An entry of a defaults list: its text, the group or config that it names, as written without
    `override` and `optional`, and the chosen presets of a group, [] for a config.
    """

    text: str
    target: str
    chosen: Sequence[str]

    @property
    def words(self) -> list[str]:
        return self.text.partition(":")[0].split()


def entries(nodes: Any) -> Iterator[Entry]:
    """The entries of a file's defaults list."""
    value = nodes.get("defaults") if isinstance(nodes, dict) else None
    for entry in value if isinstance(value, list) else [] if value is None else [value]:
        pairs = entry.items() if isinstance(entry, dict) else [(entry, None)]
        for key, chosen in pairs:
            words = str(key).split()
            names = chosen if isinstance(chosen, list) else [] if chosen is None else [chosen]
            text = f"{key}: {chosen}" if chosen else str(key)
            yield Entry(text, words[-1] if words else "", [str(name) for name in names])


def refuse_malformed(file: Path, nodes: Mapping[str, Any]) -> None:
    """Raise UserError for a defaults list that is none."""
    value = nodes.get("defaults", [])
    for entry in value if isinstance(value, list) else [None]:
        pair = next(iter(entry.items())) if isinstance(entry, dict) and len(entry) == 1 else ()
        if not isinstance(entry, str) and not (pair and isinstance(pair[0], str)):
            raise UserError(
                f"{file}: defaults: {shorten(repr(value), 80)} is not allowed; "
                "allowed: a list of NAME, GROUP: NAME and override /GROUP: NAME"
            )


def named(place: PurePosixPath, nodes: Any) -> list[str]:
    """The configs that a file's defaults list loads, by their paths; `place` is the path of the
    file without its ending.
    """
    found = []
    for entry in entries(nodes):
        if "override" in entry.words or entry.target == "_self_":
            continue
        absolute = entry.target.startswith("/")
        group = PurePosixPath(entry.target.strip("/"))
        group = group if absolute else place.parent / group
        is_group = ": " in entry.text
        paths = [group / name for name in entry.chosen] if is_group else [group]
        found += [str(path).removesuffix(".yaml") for path in paths]
    return found


class _Size(NamedTuple):
    configs: int
    levels: int


def refuse_endless(root: Path, lists: Mapping[str, Sequence[str]]) -> None:
    """Raise UserError for a config whose defaults list contains the config itself, or names more
    configs than allowed; `lists`: the configs that each config of the folder `root` names.
    """
    sizes: dict[str, _Size] = {}

    def size(name: str, chain: tuple[str, ...]) -> _Size:
        file = root / f"{chain[0] if chain else name}.yaml"
        if name in chain:
            loop = " -> ".join((*chain[chain.index(name) :], name))
            raise UserError(f"{file}: the defaults list contains itself: {loop}")
        if len(chain) > MOST_LEVELS:
            raise UserError(f"{file}: configs name configs on more than {MOST_LEVELS} levels")
        if name not in sizes:
            below = [size(other, (*chain, name)) for other in lists.get(name, ())]
            sizes[name] = _Size(
                1 + sum(one.configs for one in below), 1 + max((b.levels for b in below), default=0)
            )
        if sizes[name].configs > MOST_CONFIGS:
            raise UserError(
                f"{file}: the defaults list names more than {MOST_CONFIGS} configs, those of its "
                "configs included"
            )
        if len(chain) + sizes[name].levels > MOST_LEVELS:
            raise UserError(f"{file}: configs name configs on more than {MOST_LEVELS} levels")
        return sizes[name]

    for name in lists:
        size(name, ())
