"""`aoabench new`."""

from __future__ import annotations

from pathlib import Path

import click

from aoabench.cli.common import Choice, Command, echo

KINDS = ("estimator", "filter", "noise", "scenario", "study")


@click.command("new", cls=Command)
@click.argument("kind", type=Choice(KINDS), help="estimator, filter, noise, scenario or study.")
@click.argument("name", help="Name of the module and of the preset, such as my_estimator.")
@click.option(
    "--dir",
    "folder",
    type=click.Path(path_type=Path),
    default=Path("."),
    help="The folder to write into.  [default: this one]",
)
def new(kind: str, name: str, folder: Path) -> None:
    """Write a plug-in or a study to start from, with its test.

    The test passes at once. NAME.py has the class, conf/KIND/NAME.yaml the preset and test_NAME.py
    a test by aoabench.testing. No file is replaced. A track of your own in a file needs no class:
    `aoabench run scenario=track scenario.path=FILE`. A study is written into a checkout:
    experiments/NAME, its experiment in configs and its test.

    \b
    Examples:
      aoabench new estimator my_lines
      aoabench new filter my_ekf --dir lab
      aoabench new study smith2027
    """
    from aoabench.testing import skeletons

    if kind == skeletons.STUDY:
        written = skeletons.write_study(name, folder)
    else:
        written = skeletons.write(kind, name, folder)
    echo("\n".join(f"wrote {path}" for path in written.files))
    echo("try:" if folder == Path(".") else f"try, in {folder}:")
    echo("\n".join(f"  {command}" for command in written.commands))
