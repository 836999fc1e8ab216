"""The config groups and their presets."""

from __future__ import annotations

from pathlib import Path

from aoabench.errors import printable
from aoabench.resources import shipped

GROUPS = ("scenario", "noise", "filter", "estimator", "runner", "experiment")
LISTS = ("filter", "estimator")  # groups of which several presets can be chosen


def options(group: str, config_dir: str | None = None) -> dict[str, str]:
    """Presets of a config group with the one-line description that heads each file."""
    found = _options(group, shipped("configs"))
    own = own_options(group, config_dir) if config_dir else {}
    return found | {name: text for name, text in own.items() if name not in found}


def own_options(group: str, config_dir: str) -> dict[str, str]:
    """Presets of a config group in a user's folder, each with its description."""
    return _options(group, Path(config_dir))


def _options(group: str, root: Path) -> dict[str, str]:
    found: dict[str, str] = {}
    for file in sorted((root / group).glob("*.yaml")):
        if not file.is_file() or not file.stem.isprintable():
            continue
        head = file.read_text(encoding="utf-8", errors="replace").splitlines()
        lines = [
            line[1:].strip() for line in head if line.startswith("#") and "@package" not in line
        ]
        found[file.stem] = printable(lines[0]) if lines else ""
    return found
