"""`aoabench list`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from aoabench.cli.common import Parser
from aoabench.errors import UserError


def list_presets(arguments: Sequence[str]) -> int:
    """`aoabench list`: every preset with its one-line description."""
    from aoabench.config.presets import GROUPS, options

    parser = Parser(prog="aoabench list", description="The presets of each config group.")
    parser.add_argument("group", nargs="?", choices=GROUPS, help="only this group")
    parser.add_argument("--config-dir", help="also the configs of this folder")
    given = parser.parse_args(list(arguments))
    if given.config_dir and not Path(given.config_dir).is_dir():
        raise UserError(f"--config-dir={given.config_dir}: no such folder")
    for group in [given.group] if given.group else GROUPS:
        presets = options(group, given.config_dir)
        print(f"{group}:" if presets else f"{group}: (none yet)")
        for name, text in presets.items():
            print(f"  {name:24s} {text}")
    return 0
