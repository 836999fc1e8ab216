"""What several subcommands share."""

from __future__ import annotations

import argparse
from typing import NoReturn

from aoabench.errors import UserError


class Parser(argparse.ArgumentParser):
    """An argument parser whose complaint is one line."""

    def error(self, message: str) -> NoReturn:
        raise UserError(
            f"{self.prog.partition(' ')[2] or 'command'}: {message}; see `{self.prog} --help`"
        )


def results_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--results", default="results", help="folder of tables, figures and page (default: results)"
    )
    parser.add_argument(
        "--format", choices=["pdf", "svg"], help="figures in this format too, beside the PNG"
    )


def formats(given: argparse.Namespace) -> list[str]:
    return ["png", given.format] if given.format else ["png"]
