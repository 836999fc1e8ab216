"""`aoabench new`."""

from __future__ import annotations

from pathlib import Path

import click

from aoabench.cli.common import Choice, Command, echo

KINDS = ("estimator", "filter", "noise", "scenario")


@click.command("new", cls=Command)
@click.argument("kind", type=Choice(KINDS), help="estimator, filter, noise or scenario.")
@click.argument("name", help="Name of the module and of the preset, such as my_estimator.")
@click.option(
    "--dir",
    "folder",
    type=click.Path(path_type=Path),
    default=Path("."),
    help="The folder to write into.  [default: this one]",
)
def new(kind: str, name: str, folder: Path) -> None:
    """Write a plug-in to start from: a class, a preset, a test.

    The test passes at once. NAME.py has the class, conf/KIND/NAME.yaml the preset and test_NAME.py
    a test by aoabench.testing. No file is replaced. A track of your own in a file needs no class:
    `aoabench run scenario=track scenario.path=FILE`.

    \b
    Examples:
      aoabench new estimator my_lines
      aoabench new filter my_ekf --dir lab
    """
    from aoabench.testing import skeletons

    written = skeletons.write(kind, name, folder)
    echo("\n".join(f"wrote {path}" for path in written.files))
    echo("try:" if folder == Path(".") else f"try, in {folder}:")
    echo("\n".join(f"  {command}" for command in written.commands))
