"""`aoabench list`."""

from __future__ import annotations

from pathlib import Path

import click

from aoabench.cli.common import Choice, Command, json_option, print_json
from aoabench.config.presets import GROUPS, options
from aoabench.errors import UserError


@click.command("list", cls=Command)
@click.argument(
    "group", required=False, type=Choice(GROUPS), metavar="[GROUP]", help="Only this group."
)
@click.option(
    "--config-dir", type=click.Path(), help="Also list the presets in this folder of your own."
)
@json_option
def list_presets(group: str | None, config_dir: str | None, as_json: bool) -> None:
    """List the presets, with a line about each.

    \b
    Examples:
      aoabench list
      aoabench list filter
      aoabench list --json

    With --json: `groups`, an object with an object {preset: description} for each group.
    """
    if config_dir and not Path(config_dir).is_dir():
        raise UserError(f"--config-dir={config_dir}: no such folder")
    found = {name: options(name, config_dir) for name in ([group] if group else GROUPS)}
    if as_json:
        print_json({"groups": found})
        return
    for name, presets in found.items():
        print(f"{name}:" if presets else f"{name}: (none yet)")
        for preset, text in presets.items():
            print(f"  {preset:24s} {text}")
