"""Refuse settings that a config or an override from outside must not make."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from aoabench.config.messages import first_line
from aoabench.config.overrides import Setting
from aoabench.config.presets import GROUPS, options
from aoabench.errors import UserError, shorten
from aoabench.maths.digest import flatten


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
    for folder, _, files in os.walk(root, followlinks=True):
        place = Path(folder).relative_to(root).parts
        for name in sorted(files):
            if name.endswith((".yaml", ".yml")):
                _check_file(Path(folder) / name, place[0] if place and place[0] in GROUPS else None)


def _check_file(file: Path, group: str | None) -> None:
    """Raise UserError for a setting that a file must not hold; `group` is the file's config group,
    if any.
    """
    import yaml

    allowed = "allowed: under hydra only hydra.sweeper.params; plugins only on the command line"
    try:
        text = file.read_text(encoding="utf-8")
        nodes = list(yaml.safe_load_all(text))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        if group is None:  # nothing that Hydra could compose
            return
        raise UserError(f"{file}: not plain YAML: {first_line(error)}") from None
    for line in text.splitlines():
        words = line.strip().lstrip("#").split()
        if (
            line.strip().startswith("#")
            and words[:1] == ["@package"]
            and words[1:] not in (["_global_"], ["_group_"])
        ):
            raise UserError(
                f"{file}: {line.strip()!r} is not allowed; allowed: # @package _global_"
            )
    for node in nodes:
        for bad in _foreign_settings(node):
            if group or "hydra" in bad:
                raise UserError(f"{file}: {bad!r} is not allowed; {allowed}")
    if group is None:
        return
    if file.stem in options(group):
        raise UserError(f"{file}: {group} {file.stem!r} is a shipped preset; choose another name")
    if group in ("filter", "estimator"):
        keys = [key for node in nodes if isinstance(node, dict) for key in node]
        if keys != [file.stem]:
            raise UserError(
                f"{file}: holds {', '.join(map(str, keys)) or 'nothing'}; "
                f"allowed: one key, {file.stem!r}"
            )


def _foreign_settings(node: Any) -> Iterator[str]:
    """The settings that a document must not make: at the top level, and in its defaults list."""
    if not isinstance(node, dict):
        return
    for key, value in node.items():
        name = str(key)
        if name == "defaults":
            for entry in value if isinstance(value, list) else [value]:
                target, chosen = (
                    next(iter(entry.items())) if isinstance(entry, dict) and entry else (entry, "")
                )
                words = str(target).split()
                plain = words[-1] if words else ""
                group = plain.lstrip("/").partition("/")[0]
                text = f"{target}: {chosen}" if chosen else str(target)
                inside = group in GROUPS or "/" not in plain
                if not inside or any(mark in text for mark in ("hydra", "@", "..", "${")):
                    yield f"defaults: {text}"
        elif name.split(".")[0] in ("plugins", "hydra") and name != "hydra":
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
            yield f"{leaf}: {value}"
