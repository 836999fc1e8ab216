"""`aoabench list`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from aoabench.cli.common import Command, echo, json_option, print_json, wrapped
from aoabench.config.presets import GROUPS, LISTS, options
from aoabench.errors import UserError

if TYPE_CHECKING:
    from aoabench.config.catalogue import Parameter

_KEYS = ("reps", "seed", "plugins", "store", "until")  # of a run, beside those of the groups


def _names(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[str]:
    from aoabench.config import about

    return [name for name in about.names() if name.startswith(incomplete)]


@click.command("list", cls=Command)
@click.argument(
    "name",
    required=False,
    metavar="[NAME]",
    shell_complete=_names,
    help="A config group, to list its presets; a preset, to show its source, needs and keys; or a "
    "key, to show its meaning and range.",
)
@click.argument(
    "words",
    nargs=-1,
    metavar="[plugins=[NAME]]",
    help="Your own packages that presets of --config-dir may name, as in `run`.",
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
def list_presets(
    name: str | None,
    words: tuple[str, ...],
    fits: str | None,
    config_dir: str | None,
    as_json: bool,
) -> None:
    """List the presets, each with a one-line description.

    \b
    Examples:
      aoabench list
      aoabench list filter
      aoabench list noise            (a group)
      aoabench list ofdm_crlb        (a preset: source, needs, what runs with it, keys)
      aoabench list until            (keys of a run)
      aoabench list noise.sigma_deg  (a key, in each preset that has it)
      aoabench list --fits ble_room
      aoabench list my_noise --config-dir conf 'plugins=[my_noise]'   (of your own)

    With --json: `groups`, an object with an object {preset: description} for each group; of a
    preset `parameters`, each with key, value, unit, help and allowed, and `fits`: of a filter or
    estimator {scenario: [noises]}, of a scenario {group: [estimators]}, of a noise {"scenario":
    [scenarios]}; with --fits `fits`, an object {estimator: [noises]} for each group.
    """
    if config_dir and not Path(config_dir).is_dir():
        raise UserError(f"--config-dir={config_dir}: no such folder; allowed: an existing folder")
    if name and "=" in name:
        words, name = (name, *words), None
    plugins = _plugins(words)
    if fits is not None:
        if name is not None:
            raise UserError(f"{name!r} is not allowed with --fits; allowed: either NAME or --fits")
        _print_fits(fits, config_dir, plugins, as_json)
    elif name is None or name in GROUPS:
        _print_groups([name] if name else list(GROUPS), config_dir, as_json)
    elif "." in name or name in _KEYS:
        _print_key(name, config_dir, plugins, as_json)
    else:
        _print_preset(name, config_dir, plugins, as_json)


def _plugins(words: tuple[str, ...]) -> tuple[str, ...]:
    """The packages of plugins=[...]; UserError for other words."""
    if not words:
        return ()
    from aoabench.config.overrides import read
    from aoabench.config.plugins import parse_plugins

    settings = read(words)
    for one in settings:
        if one.key != "plugins":
            raise UserError(f"{one.word}: not allowed here; allowed: one NAME and plugins=[...]")
    return parse_plugins(settings)


def _print_groups(groups: list[str], config_dir: str | None, as_json: bool) -> None:
    found = {group: options(group, config_dir) for group in groups}
    if as_json:
        print_json({"groups": found})
        return
    for group, presets in found.items():
        echo(f"{group}:" if presets else f"{group}: (none yet)")
        shipped = options(group)
        for preset, description in presets.items():
            text = description if preset in shipped else f"{description} (in {config_dir})".strip()
            echo(wrapped(f"  {preset:24s} {text}", 27))


def _print_fits(
    scenario: str, config_dir: str | None, plugins: tuple[str, ...], as_json: bool
) -> None:
    from aoabench.config import catalogue

    found = catalogue.fitting(scenario, config_dir, plugins)
    without = catalogue.not_in_all(config_dir, plugins)
    if as_json:
        mine = {g: {n: why for n, why in without[g].items() if n in found[g]} for g in found}
        print_json({"fits": found, "not_in_all": mine})
        return
    for group, names in found.items():
        echo(f"{group}:" if names else f"{group}: none")
        for name, noises in names.items():
            why = without[group].get(name, "")
            rest = f"    (not in {group}=all: {why})" if why else ""
            echo(wrapped(f"  {name:24s} noise={','.join(noises)}{rest}", 27))


def _print_key(key: str, config_dir: str | None, plugins: tuple[str, ...], as_json: bool) -> None:
    from aoabench.config import about

    found = about.of_key(key, config_dir, plugins)
    if as_json:
        rows = [{"preset": k.partition(" ")[0], **p._asdict()} for k, p in found.items()]
        print_json({"key": key, "parameters": rows})
        return
    preset = ""
    for place, one in found.items():
        if (name := place.partition(" ")[0]) != preset:
            preset = name
            echo(f"{name}:")
        _print_parameter(one)


def _print_preset(
    name: str, config_dir: str | None, plugins: tuple[str, ...], as_json: bool
) -> None:
    from aoabench.config import about

    found = about.about(name, config_dir, plugins)
    fits = about.fits(found, config_dir, plugins)
    if as_json:
        rows = [p._asdict() for p in found.parameters]
        print_json({**found._asdict(), "parameters": rows, "fits": fits})
        return
    echo(f"{found.group}={name}: {found.description}")
    lines = {
        "class": f"{found.target}: {found.what}" if found.target else "",
        "source": found.source,
        "needs": "; ".join(map(about.need_text, found.needs)),
        "offers": ", ".join(found.offers or []),
        "runs with" if found.group in GROUPS[:4] else "": _fits_text(found.group, fits),
        f"not in {found.group}=all": found.not_in_all,
        "example": found.example,
    }
    for head, text in lines.items():
        if text:
            echo(wrapped(f"  {head}: {text}", 4))
    for one in found.parameters:
        _print_parameter(one)


def _fits_text(group: str, fits: dict[str, list[str]]) -> str:
    """The presets of `about.fits`; of a filter or estimator the scenarios with the same noises
    together.
    """
    if group not in LISTS:
        return "; ".join(f"{key}={','.join(names)}" for key, names in fits.items())
    places: dict[str, list[str]] = {}
    for scenario, noises in fits.items():
        places.setdefault(",".join(noises), []).append(scenario)
    return "; ".join(f"scenario={','.join(s)} noise={noises}" for noises, s in places.items())


def _print_parameter(one: Parameter) -> None:
    """A key with its default, meaning, unit and range, on one line."""
    value = json.dumps(one.value)
    short = value if len(value) <= 24 else f"{value[:20]} ..."
    text = f"{one.help} [{one.unit}]" if one.unit else one.help
    limits = f"; {one.allowed}" if one.allowed else ""
    echo(wrapped(f"  {one.key:44s} {short:26s} {text}{limits}", 6))
