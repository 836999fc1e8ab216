"""Refuse settings that a config or an override from outside must not make."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator
from pathlib import Path, PurePosixPath
from typing import Any

from aoabench.config.defaults import entries, named, refuse_endless, refuse_malformed
from aoabench.config.overrides import Setting
from aoabench.config.presets import GROUPS, LISTS, options
from aoabench.config.yaml_files import Unreadable, load
from aoabench.errors import UserError, shorten
from aoabench.maths.digest import flatten

_MOST_FILES = 3_000  # folders and YAML files of a user's folder
_ENDINGS = (".yaml", ".yml")


def refuse_hydra(setting: Setting) -> None:
    """Raise UserError for an override of Hydra's own node, or for a preset in an unchecked file."""
    parts = re.split(r"[./]", f"{setting.key}.{setting.package}")
    word = shorten(setting.word)
    if "hydra" in parts:
        raise UserError(
            f"{word}: nothing under hydra can be set; a sweep is written as -m KEY=VALUE,VALUE"
        )
    if "." not in setting.key and any(".." in text or "${" in text for text in setting.texts):
        raise UserError(f"{word}: the name of a preset is needed; `aoabench list` shows the names")


def refuse_foreign_hydra(config_dir: str | None) -> None:
    """Raise UserError if a config from outside sets `plugins`, or any key under `hydra` except the
    sweeper's params.

    The files are read before Hydra starts, and links are followed, as Hydra follows them. Hydra
    could also reach files outside the config groups; the only condition on these is that they do
    not set `hydra`.
    """
    if config_dir is None:
        return
    root = Path(config_dir)
    if not root.is_dir():
        raise UserError(
            f"--config-dir={config_dir}: no such folder; "
            f"allowed: a folder that holds folders {', '.join(GROUPS)}"
        )
    if (root / "hydra").exists() or (root / "hydra").is_symlink():
        raise UserError(
            f"--config-dir={config_dir}: a folder 'hydra' inside is not allowed; remove that folder"
        )
    lists = {}
    for file in _files(root):
        place = file.relative_to(root)
        group = place.parts[0] if len(place.parts) > 1 and place.parts[0] in GROUPS else None
        nodes = _checked(file, group)
        lists[place.with_suffix("").as_posix()] = named(PurePosixPath(place.with_suffix("")), nodes)
    refuse_endless(root, lists)


def refuse_unreadable(config_dir: str | None, settings: Iterable[Setting]) -> None:
    """Raise UserError for an override that chooses a file beside the config groups, which are not
    checked, and that exceeds the bounds on files.
    """
    for setting in settings:
        if config_dir and setting.key not in GROUPS and "." not in setting.key:
            for name in setting.texts:
                file = Path(config_dir, setting.key, f"{name.removesuffix('.yaml')}.yaml")
                if file.is_file():
                    try:
                        load(file)
                    except Unreadable as error:
                        raise UserError(f"{file}: not a config: {error}") from None


def _files(root: Path) -> Iterator[Path]:
    """The YAML files in a folder and the folders below it, links followed, each folder once below
    each folder of `root`; UserError for too many.
    """
    count = 0
    for start in (root, *sorted(path for path in root.iterdir() if path.is_dir())):
        visited: set[tuple[int, int]] = set()
        for folder, inner, names in os.walk(start, followlinks=True):
            status = os.stat(folder)
            again = (status.st_dev, status.st_ino) in visited
            visited.add((status.st_dev, status.st_ino))
            inner[:] = [] if again or start == root else sorted(inner)
            files = [Path(folder, name) for name in sorted(names) if name.endswith(_ENDINGS)]
            count += 1 + len(files)
            if count > _MOST_FILES:
                raise UserError(
                    f"--config-dir={root}: more than {_MOST_FILES} folders and YAML files; "
                    f"allowed: a folder of configs, with folders {', '.join(GROUPS)}"
                )
            yield from () if again else (file for file in files if file.is_file())


def _checked(file: Path, group: str | None) -> Any:
    """The nodes of a file, {} for one that is no config; UserError for a setting that a file must
    not hold. `group` is the file's config group, if any.
    """
    allowed = "allowed: under hydra only hydra.sweeper.params; plugins only on the command line"
    try:
        nodes = load(file)
    except Unreadable as error:
        if group is None:  # no file that a config may name
            return {}
        raise UserError(f"{file}: not a config: {error}") from None
    if group is not None and not isinstance(nodes, dict):
        kind = "a list" if isinstance(nodes, list) else f"one value, {shorten(repr(nodes), 80)}"
        raise UserError(f"{file}: holds {kind}; allowed: lines KEY: VALUE")
    if group is not None and not file.stem.isprintable():
        raise UserError(f"{str(file)!r} is not allowed; allowed: a file with a printable name")
    if group is not None:
        refuse_malformed(file, nodes)
    _refuse_header(file)
    for bad in _foreign_settings(nodes):
        if group or "hydra" in bad:
            raise UserError(f"{file}: {shorten(repr(bad), 80)} is not allowed; {allowed}")
    if group is not None and file.stem in options(group):
        raise UserError(f"{file}: {group} {file.stem!r} is a shipped preset; choose another name")
    if group in LISTS and list(nodes) != [file.stem]:
        keys = shorten(", ".join(map(repr, nodes)), 80)
        raise UserError(f"{file}: holds {keys or 'nothing'}; allowed: one key, {file.stem!r}")
    return nodes


def _refuse_header(file: Path) -> None:
    """Raise UserError for a header that puts a file's keys elsewhere."""
    for line in file.read_text(encoding="utf-8").splitlines():
        words = line.strip().lstrip("#").split()
        if (
            line.strip().startswith("#")
            and words[:1] == ["@package"]
            and words[1:] not in (["_global_"], ["_group_"])
        ):
            raise UserError(
                f"{file}: {shorten(repr(line.strip()), 80)} is not allowed; "
                "allowed: # @package _global_"
            )


def _foreign_settings(node: Any) -> Iterator[str]:
    """The settings that a document must not make: at the top level, and in its defaults list."""
    if not isinstance(node, dict):
        return
    for entry in entries(node):
        group = entry.target.lstrip("/").partition("/")[0]
        inside = group in GROUPS or "/" not in entry.target
        if not inside or any(mark in entry.text for mark in ("hydra", "@", "..", "${")):
            yield f"defaults: {entry.text}"
    for key, value in node.items():
        name = str(key)
        if name.split(".")[0] in ("plugins", "hydra") and name != "hydra":
            yield name
        elif name == "hydra":
            yield from _foreign_hydra(value)


def _foreign_hydra(node: Any) -> Iterator[str]:
    for leaf, value in flatten(node, "hydra"):
        parts = leaf.split(".")
        key = ".".join(parts[3:]).lstrip("+~ ")
        swept = parts[:3] == ["hydra", "sweeper", "params"] and len(parts) > 3
        if (
            not swept
            or key.split(".")[0].split("/")[0].split("@")[0] in ("hydra", "plugins")
            or "@" in key
        ):
            yield leaf
        elif isinstance(value, dict | list):
            yield f"{leaf}: {shorten(str(value), 80)}"
