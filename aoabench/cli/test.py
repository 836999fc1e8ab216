"""`aoabench test`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from aoabench.cli.common import Command, echo, json_option, print_json
from aoabench.errors import UserError

if TYPE_CHECKING:
    from aoabench.testing.plugins import PlugIn
    from aoabench.testing.rules import Result


@click.command("test", cls=Command)
@click.argument("plugin", help="A module, or a file NAME.py, with plug-ins of your own.")
@click.option(
    "--config-dir",
    type=click.Path(),
    help="A folder of presets; those that name a class of PLUGIN are tried.  [default: conf, if it "
    "is there]",
)
@click.option(
    "--skip", metavar="RULE,...", default="", help="Rules that cannot hold, as their names."
)
@json_option
def test(plugin: str, config_dir: str | None, skip: str, as_json: bool) -> int:
    """Try plug-ins in small simulations; say which rules they break.

    Each estimator, filter, noise and scenario that the module defines is tried: with its presets
    in --config-dir, else with its default parameters. The rules are those of aoabench.testing:
    shapes, missing measurements, repeated calls, permuted anchors, a turned world, and so on. The
    exit status is 1 if a rule is broken.

    \b
    Examples:
      aoabench test my_plugin
      aoabench test lab/my_plugin.py --config-dir lab/conf
      aoabench test my_plugin --skip permuted,rotated

    With --json: `plugin`; `plugins`, an object for each with name, role, `lacks` (why it was not
    tried) and `rules`, each with rule, status (passed, broken, skipped), expected, problem and
    skipped; `broken`, the number of plug-ins that break a rule.
    """
    from aoabench.testing import plugins

    if config_dir is None and Path("conf").is_dir():
        config_dir = "conf"
    if config_dir and not Path(config_dir).is_dir():
        raise UserError(f"--config-dir={config_dir}: no such folder; allowed: an existing folder")
    names = [name for name in skip.split(",") if name]
    plugins.check_names(names)
    reasons = dict.fromkeys(names, "--skip")
    found = plugins.plugins_of(plugins.module_of(plugin), config_dir)
    tried = [(one, [] if one.lacks else plugins.tried(one, reasons)) for one in found]
    broken = sum(any(result.problem for result in results) for _, results in tried)
    if as_json:
        each = [_as_json(one, results) for one, results in tried]
        print_json({"plugin": plugin, "plugins": each, "broken": broken})
    else:
        for one, results in tried:
            echo("\n".join(_lines(one, results)))
        words = f"{broken} of them" if len(tried) > 1 else "it"
        good = "every rule holds" if not broken else f"{words} breaks rules"
        echo(f"{len(tried)} plug-in{'s' * (len(tried) != 1)} in {plugin}: {good}")
    return 1 if broken else 0


def _status(result: Result) -> str:
    return "broken" if result.problem else "skipped" if result.skipped else "passed"


def _as_json(one: PlugIn, results: list[Result]) -> dict[str, Any]:
    rules = [
        {
            "rule": r.rule,
            "status": _status(r),
            "expected": r.expected,
            "problem": r.problem,
            "skipped": r.skipped,
        }
        for r in results
    ]
    return {"name": one.name, "role": one.role, "lacks": one.lacks, "rules": rules}


def _lines(one: PlugIn, results: list[Result]) -> list[str]:
    """The results of a plug-in, a line for each rule."""
    if one.lacks:
        return [f"{one.name} ({one.role}): not tried: it {one.lacks}"]
    tried = [r for r in results if not r.skipped]
    count = sum(not r.problem for r in tried)
    rest = f", {len(results) - len(tried)} skipped" if len(tried) < len(results) else ""
    head = f"{one.name} ({one.role}): {count} of {len(tried)} rules hold{rest}"
    lines = [f"  {_status(r):8s}{r.rule:15s} {_words(r)}" for r in results]
    return [head, *lines]


def _words(result: Result) -> str:
    if result.problem:
        return f"{result.problem}; {result.expected}"
    return result.skipped or result.expected
