"""`aoabench list`."""

from __future__ import annotations

import json
from pathlib import Path

import click

from aoabench.cli.common import Command, echo, json_option, print_json
from aoabench.config.presets import GROUPS, options
from aoabench.errors import UserError


def _names(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[str]:
    known = [*GROUPS, *(name for group in GROUPS for name in options(group))]
    return [name for name in known if name.startswith(incomplete)]


@click.command("list", cls=Command)
@click.argument(
    "name",
    required=False,
    metavar="[NAME]",
    shell_complete=_names,
    help="A config group, to list its presets, or a preset, to show its parameters.",
)
@click.option(
    "--fits",
    metavar="SCENARIO",
    help="List the filters and estimators that run in this scenario, with the noises they allow.",
)
@click.option(
    "--config-dir", type=click.Path(), help="Also list the presets in this folder of your own."
)
@json_option
def list_presets(name: str | None, fits: str | None, config_dir: str | None, as_json: bool) -> None:
    """List the presets, each with a one-line description.

    \b
    Examples:
      aoabench list
      aoabench list filter
      aoabench list noise            (a group)
      aoabench list ofdm_crlb        (a preset: its parameters)
      aoabench list --fits ble_room

    With --json: `groups`, an object with an object {preset: description} for each group; of a
    preset `parameters`, each with key, value, unit, help and allowed; with --fits `fits`, an
    object {estimator: [noises]} for each group.
    """
    if config_dir and not Path(config_dir).is_dir():
        raise UserError(f"--config-dir={config_dir}: no such folder; allowed: an existing folder")
    if fits is not None:
        if name is not None:
            raise UserError(f"{name!r} is not allowed with --fits; allowed: either NAME or --fits")
        _print_fits(fits, config_dir, as_json)
    elif name is None or name in GROUPS:
        _print_groups([name] if name else list(GROUPS), config_dir, as_json)
    else:
        _print_parameters(name, config_dir, as_json)


def _print_groups(groups: list[str], config_dir: str | None, as_json: bool) -> None:
    found = {group: options(group, config_dir) for group in groups}
    if as_json:
        print_json({"groups": found})
        return
    for group, presets in found.items():
        echo(f"{group}:" if presets else f"{group}: (none yet)")
        for preset, text in presets.items():
            echo(f"  {preset:24s} {text}")


def _print_fits(scenario: str, config_dir: str | None, as_json: bool) -> None:
    from aoabench.config import catalogue

    found = catalogue.fitting(scenario, config_dir)
    if as_json:
        print_json({"fits": found})
        return
    for group, names in found.items():
        echo(f"{group}:" if names else f"{group}: none")
        for name, noises in names.items():
            echo(f"  {name:24s} noise={','.join(noises)}")


def _print_parameters(name: str, config_dir: str | None, as_json: bool) -> None:
    from aoabench.config import catalogue

    group = catalogue.group_of(name, config_dir)
    if group in ("runner", "experiment"):
        raise UserError(
            f"{name!r}: this preset has no parameters; "
            f"`aoabench run {group}={name} --cfg job` shows its config"
        )
    found = catalogue.parameters(name, config_dir)
    if as_json:
        print_json({"group": group, "preset": name, "parameters": [p._asdict() for p in found]})
        return
    echo(f"{group}={name}: {options(group, config_dir)[name]}")
    for one in found:
        value = json.dumps(one.value)
        short = value if len(value) <= 24 else f"{value[:20]} ..."
        text = f"{one.help} [{one.unit}]" if one.unit else one.help
        echo(f"  {one.key:44s} {short:26s} {text}")
