"""Writing the figure of a run: a picture, or a page with the picture, its table and the command."""

from __future__ import annotations

import io
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from aoabench.errors import BadValue
from aoabench.report import plots
from aoabench.report.runs.drawing import Drawing
from aoabench.store.files import write_atomically

if TYPE_CHECKING:
    import pandas as pd

SUFFIXES = (*(f".{form}" for form in plots.FORMATS), ".html")
_MOST_ROWS = 1000


def check_out(path: Path) -> None:
    """Raise BadValue unless the file's name ends in one of SUFFIXES."""
    if path.suffix not in SUFFIXES:
        raise BadValue("--out", str(path), f"a file that ends in {', '.join(SUFFIXES)}")


def write(drawing: Drawing, path: Path, command: str) -> None:
    """Draw a figure into a file whose suffix names its format (see SUFFIXES); `command` is that of
    the page.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix != ".html":
        plots.save(drawing.draw, path, (path.suffix[1:],))
        return
    text = page(drawing, command)
    write_atomically(path, lambda file: file.write_text(text, encoding="utf-8"))


def page(drawing: Drawing, command: str) -> str:
    """A self-contained HTML page: the figure as SVG, its footer, the command, and the table."""
    import jinja2
    import matplotlib.pyplot as plt

    buffer = io.StringIO()
    with plt.style.context(str(plots.STYLE)):
        figure = drawing.draw()
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
        plt.close(figure)
    svg = buffer.getvalue()
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    shown = _shown(drawing.table).rename(columns={"group": drawing.choice.by})
    return environment.get_template("page.html.j2").render(
        title=f"{drawing.choice.kind}: {drawing.choice.metric}",
        svg=svg[svg.index("<svg") :],
        footer=drawing.footer,
        command=command,
        columns=list(shown.columns),
        rows=[[_text(value) for value in row] for row in shown.itertuples(index=False)],
        left_out=len(drawing.table) - len(shown),
    )


def _shown(table: pd.DataFrame) -> pd.DataFrame:
    """The first rows of a table, without a column that is empty everywhere."""
    empty = [name for name in ("panel",) if name in table and (table[name] == "").all()]
    return table.drop(columns=empty).head(_MOST_ROWS)


def _text(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.4g}" if math.isfinite(value) else "\u2013"
    return str(value)
