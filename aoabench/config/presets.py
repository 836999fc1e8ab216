"""The config groups and their presets."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from aoabench.errors import printable
from aoabench.resources import shipped

GROUPS = ("scenario", "noise", "filter", "estimator", "runner", "experiment")
LISTS = ("filter", "estimator")  # groups of which several presets can be chosen
ALL = "all"  # in place of names in LISTS: every preset that fits
_VARIANT = "variant:"
_OWN = "conf"


def options(group: str, config_dir: str | None = None) -> dict[str, str]:
    """Presets of a config group with the one-line description that heads each file."""
    found: dict[str, str] = {}
    for root in _roots(config_dir):
        for name, lines in _heads(group, root):
            found.setdefault(name, _described(lines))
    return found


def own_options(group: str, config_dir: str) -> dict[str, str]:
    """Presets of a config group in a user's folder, each with its description."""
    return {name: _described(lines) for name, lines in _heads(group, Path(config_dir))}


def unread(group: str, name: str) -> str:
    """How to read a preset in the folder that `aoabench new` writes to, "" if it is not there."""
    file = Path(_OWN, group, f"{name}.yaml")
    found = name.isidentifier() and file.is_file()
    return f"; {file.as_posix()} is read with --config-dir {_OWN}" if found else ""


def variants(group: str, config_dir: str | None = None) -> dict[str, str]:
    """The presets that differ in a detail from another one, which `all` leaves out, with the words
    of their line `# variant: of wcg, as printed`.
    """
    found: dict[str, str] = {}
    for root in _roots(config_dir):
        for name, lines in _heads(group, root):
            said = [line for line in lines if line.startswith(_VARIANT)]
            words = printable(said[0]).removeprefix(_VARIANT).strip() if said else ""
            found.setdefault(name, words)
    return {name: words for name, words in found.items() if words}


def _roots(config_dir: str | None) -> list[Path]:
    return [shipped("configs"), *([Path(config_dir)] if config_dir else [])]


def _described(lines: list[str]) -> str:
    said = [line for line in lines if not line.startswith(_VARIANT)]
    return printable(said[0]) if said else ""


def _heads(group: str, root: Path) -> Iterator[tuple[str, list[str]]]:
    """Each preset's name with the comments of its file that fill a line."""
    for file in sorted((root / group).glob("*.yaml")):
        if file.is_file() and file.stem.isprintable():
            lines = file.read_text(encoding="utf-8", errors="replace").splitlines()
            comments = [s for s in lines if s.startswith("#") and "@package" not in s]
            yield file.stem, [line[1:].strip() for line in comments]
