"""Options and helpers that the subcommands share."""

from __future__ import annotations

import contextlib
import json
import math
import os
import shutil
import sys
import textwrap
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, TextIO, TypeVar

import click
from click.shell_completion import CompletionItem

from aoabench.engine.faults import explained
from aoabench.errors import did_you_mean, printable, shorten

_QUIET = "aoabench.quiet"
SCHEMA = 1  # of the objects that --json prints

Decorated = TypeVar("Decorated", bound=Callable[..., Any])


def _note_quiet(ctx: click.Context, _param: click.Parameter, value: bool) -> None:
    ctx.meta[_QUIET] = value or ctx.meta.get(_QUIET, False)  # before the command or after it


QUIET: dict[str, Any] = {
    "is_flag": True,
    "expose_value": False,
    "callback": _note_quiet,
    "help": "Print no progress and no remarks.",
}


class Command(click.Command):
    """A subcommand with -q, which keeps everything but errors off standard error.

    Errors of the machine become one line (see engine.faults).
    """

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.params.append(click.Option(["-q", "--quiet"], **QUIET))

    def invoke(self, ctx: click.Context) -> Any:
        folder = ctx.params.get("run") or ctx.params.get("results")
        with explained(folder):
            return self._invoke(ctx)

    def _invoke(self, ctx: click.Context) -> Any:
        if not ctx.meta.get(_QUIET):
            return super().invoke(ctx)
        with (
            open(os.devnull, "w", encoding="utf-8") as nowhere,
            contextlib.redirect_stderr(nowhere),
        ):
            return super().invoke(ctx)


def say(line: str = "") -> None:
    """Print a line that is not the command's result: with --json to standard error, with -q not at
    all.
    """
    ctx = click.get_current_context()
    if not ctx.meta.get(_QUIET):
        echo(line, file=sys.stderr if ctx.params.get("as_json") else sys.stdout)


def echo(text: str, file: TextIO | None = None) -> None:
    """Print lines that may hold names and words from other people's files."""
    print(printable(text), file=file)


def wrapped(line: str, indent: int) -> str:
    """A line as it fits a terminal, further lines indented by `indent`; in a file or pipe as it
    is.
    """
    if not sys.stdout.isatty():
        return line
    width = max(shutil.get_terminal_size().columns, 40)
    return textwrap.fill(
        line,
        width,
        subsequent_indent=" " * indent,
        break_long_words=False,
        break_on_hyphens=False,
    )


json_option = click.option(
    "--json", "as_json", is_flag=True, help="Print one JSON object instead of text."
)


def print_json(found: Mapping[str, Any]) -> None:
    """Print one object on standard output; NaN and infinite numbers become null."""
    print(json_text(found))


def json_text(found: Mapping[str, Any]) -> str:
    """One object with its schema as JSON; NaN and infinite numbers become null."""
    return json.dumps({"schema": SCHEMA, **_plain(found)}, allow_nan=False, indent=1)


def _plain(value: Any) -> Any:
    """The value in the types of JSON."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if type(value).__module__ == "numpy":
        return _plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if value is None or isinstance(value, bool | int | str) else str(value)


class Choice(click.Choice[str]):
    """One of a few words; the error for another word suggests the nearest of them."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        if value not in self.choices:
            allowed = f"; allowed: {', '.join(self.choices)}"
            hint = did_you_mean(str(value), self.choices) or allowed
            self.fail(f"{shorten(repr(value))} is not allowed{hint}")
        return str(value)


def _folders(_ctx: click.Context, _param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    return [CompletionItem(incomplete, type="dir")]


run_argument = click.argument(
    "run",
    type=click.Path(path_type=Path),
    shell_complete=_folders,
    help="Folder of a run (its runner.out).",
)


def estimator_names(
    ctx: click.Context, _param: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """Completions: the estimators of RUN, or of all presets if RUN is unknown."""
    from aoabench.config.presets import options

    given = ctx.params.get("run") or next(iter(ctx.args), "")  # in args, while a flag has no value
    files = Path(given).glob("cells/*.json")
    names: Iterable[str] = {name for file in files for name in _estimators(file)}
    names = names or [name for group in ("filter", "estimator") for name in options(group)]
    return [CompletionItem(name) for name in sorted(names) if name.startswith(incomplete)]


def _estimators(file: Path) -> list[str]:
    """The estimators that the record of a cell names; none if it cannot be read."""
    try:
        return list(json.loads(file.read_text(encoding="utf-8"))["estimators"])
    except (OSError, ValueError, KeyError, TypeError):
        return []


def results_options(command: Decorated) -> Decorated:
    """Add the options --results and --format to a command."""
    command = click.option(
        "--format",
        "format_",
        type=Choice(["pdf", "svg"]),
        help="Write figures in this format too, beside the PNG.",
    )(command)
    return click.option(
        "--results",
        type=click.Path(path_type=Path),
        shell_complete=_folders,
        help="Folder of tables, figures, page and replications.  [default: results/quick at quick "
        "scale, results at paper scale]",
    )(command)


def scale_option(default: str, explained: str) -> Callable[[Decorated], Decorated]:
    """The option --scale of a command."""
    return click.option(
        "--scale",
        type=Choice(["quick", "paper"]),
        default=default,
        show_default=True,
        help=explained,
    )


all_option = click.option(
    "--all", "every", is_flag=True, help="Print each claim instead of one screen."
)


def formats(format_: str | None) -> list[str]:
    """The formats of the figures."""
    return ["png", format_] if format_ else ["png"]
