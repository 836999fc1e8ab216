"""`aoabench export`."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

import click
from click.shell_completion import CompletionItem

from aoabench.cli.common import Command, json_text, run_argument
from aoabench.errors import UserError


def _metrics(_ctx: click.Context, _param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    from aoabench.report.exported import ALL, METRICS

    return [CompletionItem(name) for name in (*METRICS, ALL) if name.startswith(incomplete)]


@click.command("export", cls=Command)
@run_argument
@click.option("--latex", is_flag=True, help="A tabular for booktabs and siunitx.")
@click.option("--csv", is_flag=True, help="Comma-separated values with every digit.")
@click.option("--json", is_flag=True, help="One JSON object with every digit.")
@click.option("--markdown", is_flag=True, help="A Markdown table.")
@click.option(
    "--xarray", is_flag=True, help="NetCDF, for xarray; it needs -o and aoabench[xarray]."
)
@click.option(
    "--metric",
    "metrics",
    multiple=True,
    metavar="NAME",
    shell_complete=_metrics,
    help="A number of summary.parquet or timing.parquet, such as rmse_pooled_3d_m, cep95_m or "
    "seconds_per_step; may be repeated; all: each of them.  [default: mean and median RMSE 3-D, or "
    "mean RMSE xy where there is no 3-D error, and availability]",
)
@click.option(
    "--by",
    metavar="KEY",
    help="With --latex or --markdown: a group of columns for each value of this key, such as "
    "noise.sigma_deg.",
)
@click.option(
    "--digits",
    type=int,
    default=2,
    show_default=True,
    help="With --latex or --markdown: significant digits of an interval's half-width, to which a "
    "number and its interval are rounded.",
)
@click.option(
    "--replications", is_flag=True, help="With --xarray: also the numbers of each replication."
)
@click.option(
    "-o",
    "--out",
    type=click.Path(path_type=Path),
    help="The file to write; its ending (.tex, .csv, .json, .md, .nc) can stand for the format.",
)
def export(
    run: Path,
    metrics: tuple[str, ...],
    by: str | None,
    digits: int,
    replications: bool,
    out: Path | None,
    **formats: bool,
) -> None:
    """Write the table of a run for a paper or another program.

    The table has a row for each cell and estimator, with the parameters that differ between the
    cells, and the numbers of summary.parquet with their 95 % intervals. LaTeX and Markdown round a
    number to what its interval supports; the other formats hold every digit.

    \b
    Examples:
      aoabench export results/raw/sigma --latex
      aoabench export results/raw/sigma --latex --by noise.sigma_deg -o table.tex
      aoabench export results/raw/sigma --csv --metric rmse_pooled_3d_m --metric cep95_m
      aoabench export results/raw/sigma -o sigma.nc

    With --json: `run`; `aoabench`, the version; `varied` and `fixed`, the keys with several values
    and the others with their value; `metrics`, each with its name, title, unit and columns; `rows`.
    """
    from aoabench.report import export as export_module

    form = _form([name for name, given in formats.items() if given], out)
    if replications and form != "xarray":
        raise UserError(f"--replications is not allowed with --{form}; allowed: with --xarray")
    if form == "xarray" and out is None:
        raise UserError("--xarray: the file is missing; allowed: together with -o FILE.nc")
    words = [f"--{form}", *(f"--metric={name}" for name in metrics)]
    words += [f"--by={by}"] * bool(by) + [f"--digits={digits}"] * (digits != 2)
    command = shlex.join(["aoabench", "export", str(run), *words])
    made = export_module.export(run, form, metrics, by, digits, command, replications)
    if out is None:
        click.echo(json_text(made) if form == "json" else made, nl=form == "json")
    else:
        _write(out, form, made)


def _form(given: list[str], out: Path | None) -> str:
    """The format that the flags name, or else the file's ending; UserError unless it is one."""
    from aoabench.report.export import FORMATS

    if len(given) > 1:
        raise UserError(f"{' '.join(f'--{name}' for name in given)}: one format at a time")
    if given:
        return given[0]
    known = {ending: name for name, ending in FORMATS.items()}
    if out is None or out.suffix.lower() not in known:
        flags = ", ".join(f"--{name}" for name in FORMATS)
        raise UserError(
            f"the format is missing; allowed: one of {flags}, or -o FILE with one of the endings "
            f"{', '.join(known)}"
        )
    return known[out.suffix.lower()]


def _write(out: Path, form: str, made: Any) -> None:
    """Write what `export` made to a file."""
    from aoabench.store.files import write_atomically

    if out.is_dir():
        raise UserError(f"-o {out}: this is a folder; allowed: the name of a file")
    if form == "xarray":
        write_atomically(out, lambda file: made.to_netcdf(file, engine="netcdf4"))
        return
    text = json_text(made) + "\n" if form == "json" else made
    write_atomically(out, lambda file: file.write_text(text, encoding="utf-8", newline="\n"))
