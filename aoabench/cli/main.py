"""The command line: the group of subcommands and their exit status.

Exit status: 0 done, 2 the user's mistake (one line), 129 hung up, 130 interrupted, 143 terminated,
1 anything else.
"""

from __future__ import annotations

import io
import math
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any, NoReturn

import click

from aoabench import __version__
from aoabench.cli import crash
from aoabench.cli.collect import collect
from aoabench.cli.common import QUIET
from aoabench.cli.compare import compare
from aoabench.cli.export import export
from aoabench.cli.list import list_presets
from aoabench.cli.locate import locate
from aoabench.cli.new import new
from aoabench.cli.plot import plot
from aoabench.cli.replay import replay
from aoabench.cli.report import report
from aoabench.cli.reproduce import reproduce
from aoabench.cli.run import run
from aoabench.cli.test import test
from aoabench.config.presets import GROUPS
from aoabench.engine.faults import KEPT, explained
from aoabench.errors import ManyErrors, RunError, UserError, did_you_mean, printable, shorten

_STOPPED = {"SIGHUP": "hung up", "SIGINT": "interrupted", "SIGTERM": "terminated"}
_GRACE_S = 5  # after the first signal


class _Commands(click.Group):
    """The subcommands, listed in the order in which they were added."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(self.commands)

    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except (KeyboardInterrupt, EOFError) as error:  # click takes both for an interruption
            raise _Passed(error) from None


class _Passed(Exception):
    """Carries an exception, its only argument, past click."""


@click.group(
    cls=_Commands,
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.option("-q", "--quiet", **QUIET)
@click.version_option(__version__, "-V", "--version", message="aoabench %(version)s")
@click.pass_context
def cli(ctx: click.Context) -> None:
    """Monte Carlo benchmark of angle-of-arrival (AoA) positioning.

    \b
    Examples:
      aoabench list
      aoabench run noise=vmf 'filter=[ekf_vmf,ukf_vmf]' reps=200
      aoabench run -m noise.sigma_deg=2,5,10 'filter=[ekf_vmf]' runner.out=results/raw/sigma
      aoabench compare results/raw/sigma

    `aoabench COMMAND --help` describes a command. The exit status is 0 when the command is done, 2
    after a mistake in the input, 130 when interrupted and 1 for anything else. With the environment
    variable AOABENCH_DEBUG=1 errors are printed with their traceback.
    """
    if ctx.invoked_subcommand is None:
        click.echo(ctx.get_help())


@click.command("help", hidden=True)
@click.argument("command", required=False)
@click.pass_context
def help_(ctx: click.Context, command: str | None) -> None:
    """Print the help of a command."""
    dispatch([command, "--help"] if command else ["--help"])


_COMMANDS = (
    run,
    locate,
    list_presets,
    compare,
    plot,
    export,
    collect,
    replay,
    reproduce,
    report,
    new,
    test,
    help_,
)
for _command in _COMMANDS:
    cli.add_command(_command)


def main(argv: Sequence[str] | None = None) -> NoReturn:
    """Entry point of `aoabench`."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    if isinstance(sys.stdout, io.TextIOWrapper):  # its encoding may lack ± or parts of file names
        sys.stdout.reconfigure(errors="backslashreplace")
    with _signals() as received:
        sys.exit(_status(arguments, received))


def _status(arguments: Sequence[str], received: Sequence[signal.Signals]) -> int:
    """Run one subcommand and return its exit status; an exception becomes one line."""
    debug = bool(os.environ.get(crash.DEBUG))
    try:
        with explained():
            status = dispatch(arguments)
            sys.stdout.flush()  # a full disk is reported here
        return status
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except KeyboardInterrupt:
        number = received[0] if received else signal.SIGINT
        _complain(f"{_STOPPED[number.name]}; {KEPT}")
        return 128 + number
    except Exception as error:
        if debug:
            raise
        known = isinstance(error, UserError | RunError)
        _complain(*_lines(error) if known else [crash.reported(error)])
        return 2 if isinstance(error, UserError) else 1


def dispatch(arguments: Sequence[str]) -> int:
    """Run one subcommand and return its exit status; UserError for a mistake in the arguments."""
    try:
        status = cli.main(list(arguments), prog_name="aoabench", standalone_mode=False)
    except click.UsageError as error:
        raise UserError(_usage(error, arguments)) from None
    except click.ClickException as error:
        raise UserError(error.format_message()) from None
    except click.Abort:
        raise KeyboardInterrupt from None
    except _Passed as passed:
        raise passed.args[0] from None
    return status if isinstance(status, int) else 0


def _usage(error: click.UsageError, arguments: Sequence[str]) -> str:
    """The message about an option or argument that is unknown, missing or not allowed."""
    ctx = error.ctx
    command = next((f" {word}" for word in arguments if word in cli.commands), "")
    path = ctx.command_path if ctx else f"aoabench{command}"
    where = f"{name}: " if (name := path.partition(" ")[2]) else ""
    text = error.format_message().rstrip(".").replace("Got unexpected extra", "unexpected")
    if isinstance(error, click.NoSuchOption) and ctx:
        text = f"unknown option {error.option_name}{_about_option(error.option_name, ctx)}"
    elif isinstance(error, click.exceptions.NoSuchCommand):
        known = [name for name, command in cli.commands.items() if not command.hidden]
        hint = did_you_mean(error.command_name, known) or f"; allowed: {', '.join(known)}"
        text = f"unknown command {error.command_name!r}{hint}"
    elif isinstance(error, click.BadOptionUsage):
        text = f"{error.option_name} needs a value"
    elif isinstance(error, click.BadParameter) and error.param and ctx:
        text = f"{_named(error.param, ctx)}: {error.message.rstrip('.')}"
        if isinstance(error, click.MissingParameter):
            text = f"{_named(error.param, ctx)} is missing: {_help_of(error.param)}"
    mark = "" if text.endswith("?") else ";"
    return f"{where}{shorten(text, 1000)}{mark} see `{path} --help`"


def _about_option(flag: str, ctx: click.Context) -> str:
    """A hint about an unknown option."""
    if flag.lstrip("-") in (*GROUPS, "reps", "seed"):
        return f"; did you mean '{flag.lstrip('-')}=...'?"
    if ctx.command is cli and any(flag in p.opts for c in cli.commands.values() for p in c.params):
        return " before the command; allowed: after the command"
    return did_you_mean(flag, [f for p in ctx.command.get_params(ctx) for f in p.opts])


def _named(parameter: click.Parameter, ctx: click.Context) -> str:
    """The flag of an option, or the placeholder of an argument."""
    flags = [flag for flag in parameter.opts if flag.startswith("--")]
    return flags[0] if flags else parameter.make_metavar(ctx).strip("[].")


def _help_of(parameter: Any) -> str:
    return (parameter.help or "").rstrip(".").lower()


def _lines(error: Exception) -> list[str]:
    """The message of an error: one line, or a heading and a line for each of several mistakes."""
    if isinstance(error, ManyErrors):
        return [f"{len(error.each)} mistakes:", *map(str, error.each)]
    return [str(error)]


def _complain(*lines: str) -> None:
    """Print a message on standard error, each of its lines as one line."""
    plain = [printable(" ".join(line.split())) for line in lines]
    with suppress(OSError):  # a terminal that has hung up
        print("\n  ".join([f"aoabench: {plain[0]}", *plain[1:]]), file=sys.stderr)


@contextmanager
def _signals() -> Iterator[list[signal.Signals]]:
    """Handle SIGTERM and SIGHUP like Ctrl-C; yield the list of received signals.

    Signals that are ignored, such as SIGHUP under nohup, stay ignored. Further signals within
    _GRACE_S of the first are ignored, so that they do not disturb the end; all are ignored once a
    signal has ended the command, because the process ends too.
    """
    received: list[signal.Signals] = []
    first = [math.inf]

    def stop(number: int, _frame: object) -> None:
        received.append(signal.Signals(number))
        first[0] = min(first[0], time.monotonic())
        if len(received) == 1 or time.monotonic() > first[0] + _GRACE_S:
            raise KeyboardInterrupt

    mine = threading.current_thread() is threading.main_thread()
    usual = (signal.SIG_DFL, signal.default_int_handler)
    before = {
        number: signal.signal(number, stop)
        for number in (getattr(signal, name) for name in _STOPPED if hasattr(signal, name))
        if mine and signal.getsignal(number) in usual
    }
    try:
        yield received
    finally:
        for number, handler in before.items():
            if signal.getsignal(number) != signal.SIG_IGN:  # by a command that a signal has ended
                signal.signal(number, signal.SIG_IGN if received else handler)
