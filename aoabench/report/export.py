"""A run's table in the formats of papers and programs: LaTeX, Markdown, CSV, JSON, xarray."""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from aoabench.columns import REPLICATIONS, unit_of
from aoabench.errors import UserError, check_number, printable
from aoabench.report.exported import Exported, by_value, exported, plain
from aoabench.report.latex import latex
from aoabench.report.text import shown_name
from aoabench.resources import version
from aoabench.store import tables

if TYPE_CHECKING:
    import pandas as pd
    import xarray

# the formats, and the ending of a file's name that stands for each
FORMATS = {
    "latex": ".tex",
    "csv": ".csv",
    "json": ".json",
    "markdown": ".md",
    "xarray": ".nc",
}
_SHOWN = ("latex", "markdown")  # rounded, for readers; the others hold every digit


def export(
    run: Path,
    form: str,
    metrics: Sequence[str] = (),
    by: str | None = None,
    digits: int = 2,
    command: str = "",
    replications: bool = False,
) -> Any:
    """The summary of the run in folder `run`, a row for each cell and estimator: a text for latex,
    markdown and csv, an object for json, and a Dataset for xarray.

    metrics: see `exported`. by: the key of whose values each gets a column per metric, in latex and
    markdown. digits: significant digits of an interval's half-width, to which latex and markdown
    round a number and its interval. command: the command that made the table, for its comments.
    replications: whether the Dataset also holds the numbers of each replication. Raises UserError
    for a mistake in these.
    """
    check_number("--digits", digits, least=1, most=12, integer=True)
    if by and form not in _SHOWN:
        raise UserError(
            f"--by={by} is not allowed with --{form}, which has each value in rows; "
            f"allowed: with {' and '.join(f'--{one}' for one in _SHOWN)}"
        )
    table = exported(run, metrics)
    if form == "latex":
        return latex(table, _about(table, command), by, digits)
    if form == "markdown":
        return _markdown(table, _about(table, command), by, digits)
    if form == "csv":
        columns = _columns(table)
        return str(table.frame[columns].to_csv(index=False, lineterminator="\n"))
    return _plain(table) if form == "json" else dataset(table, command, replications)


def _columns(table: Exported) -> list[str]:
    """The columns of the table in full."""
    numbers = [c for metric in table.metrics for c in metric.columns]
    return [*table.keys, "replications", "causal", *numbers]


def _plain(table: Exported) -> dict[str, Any]:
    """The object that --json prints."""
    return {
        "run": table.run,
        "aoabench": version("aoabench"),
        "varied": table.varied,
        "fixed": table.fixed,
        "metrics": [
            {"name": m.name, "title": m.title, "unit": m.unit, "columns": m.columns}
            for m in table.metrics
        ],
        "rows": table.frame[_columns(table)].to_dict("records"),
    }


def _about(table: Exported, command: str) -> list[str]:
    """Lines about a table: what it shows, of which run, and how it was made."""
    titles = ", ".join(metric.title for metric in table.metrics)
    errors = ["[95 % interval]"] * any(m.low for m in table.metrics)
    errors += ["± standard error"] * any(m.se and not m.low for m in table.metrics)
    fixed = "; ".join(f"{key} {plain(value)}" for key, value in table.fixed.items())
    return [
        "; ".join([titles, *errors]),
        f"{table.replications}; {fixed}",
        f"aoabench {version('aoabench')}" + (f": {command}" if command else ""),
    ]


def _markdown(table: Exported, about: Sequence[str], by: str | None, digits: int) -> str:
    """The table with pipes; with `by`, with a group of columns for each value of this key."""
    groups = by_value(table, by) if by else [(None, table.frame)]
    keys, first = table.shown(by), groups[0][1]
    heads, columns = [*keys], [[plain(value) for value in first[key]] for key in keys]
    if "estimator" in keys:
        names = zip(first["estimator"], first["causal"])
        columns[keys.index("estimator")] = [shown_name(*pair) for pair in names]
    sides = ["---:" if first[key].dtype.kind in "iuf" else "---" for key in keys]
    for value, rows in groups:
        for metric in table.metrics:
            unit = f" [{metric.unit}]" if metric.unit else ""
            where = f", {by} = {plain(value)}" if by else ""
            heads.append(f"{metric.title}{unit}{where}")
            columns.append([" ".join(two).strip() or "-" for two in metric.texts(rows, digits)])
            sides.append("---:")
    lines = [map(_cell, heads), sides, *(map(_cell, row) for row in zip(*columns))]
    body = "\n".join(f"| {' | '.join(line)} |" for line in lines)
    notes = "\n".join(f"<!-- {_comment(line)} -->" for line in about)
    return f"{notes}\n\n{body}\n"


def _cell(text: str) -> str:
    """The text of a cell of a Markdown table, on one line."""
    line = " ".join(printable(text).split())
    return line.replace("\\", "\\\\").replace("|", "\\|").replace("<", "&lt;").replace("_", "\\_")


def _comment(text: str) -> str:
    """The text as it may stand in a comment of HTML."""
    return " ".join(printable(text).split()).replace("-->", "-- >")


def dataset(table: Exported, command: str = "", replications: bool = False) -> xarray.Dataset:
    """The table as an xarray Dataset with a dimension for each key with several values, `estimator`
    among them, and with units as attributes; combinations that the run lacks are NaN.

    With `replications`, the numbers of each replication too, over a further dimension. Raises
    UserError without the library.
    """
    _require_xarray()
    dims = table.varied
    numbers = [c for metric in table.metrics for c in metric.columns]
    found = _indexed(table.frame, dims, ["replications", *numbers])
    if replications:
        seeds = table.frame[["cell", "seed"]].drop_duplicates()
        rows = tables.load(table.run).merge(seeds, on="cell", validate="m:1")
        rows["experiment"] = rows["experiment"].fillna("")
        kinds = REPLICATIONS.items()
        each = [c for c, k in kinds if k in ("double", "int64") and c != "replication"]
        found = found.merge(_indexed(rows, [*dims, "replication"], each))
    causal = table.frame.drop_duplicates("estimator").set_index("estimator")["causal"]
    order = causal.loc[found["estimator"].to_numpy().tolist()].to_numpy(bool)
    found = found.assign_coords(causal=("estimator", order))
    for name in found.variables:
        if unit := unit_of(str(name)):
            found[name].attrs["units"] = unit
    for metric in table.metrics:
        found[metric.name].attrs["long_name"] = metric.title
    about = {"aoabench": version("aoabench"), "run": str(table.run), "history": command}
    found.attrs = {k: plain(v) for k, v in (table.fixed | about).items() if v != ""}
    return found


def _require_xarray() -> None:
    """Raise UserError without xarray, or without what writes its files."""
    missing = [name for name in ("xarray", "netCDF4") if importlib.util.find_spec(name) is None]
    if missing:
        raise UserError(
            f"--xarray needs {' and '.join(missing)}; allowed: after "
            "pip install 'aoabench[xarray]', or another format"
        )


def _indexed(frame: pd.DataFrame, dims: Sequence[str], columns: Sequence[str]) -> xarray.Dataset:
    """Columns of numbers over the dimensions `dims`; values of mixed kinds become text."""
    some = frame[[*dims, *columns]].copy()
    for key in dims:
        if some[key].dtype.kind not in "iufb":
            some[key] = some[key].map(plain).astype(object)
    return some.set_index(list(dims)).to_xarray()
