"""The measured rows as a figure and as a table."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pandas as pd

from aoabench.report import plots

PANELS = {"particle-step": "ns per particle and step", "Kalman step": "µs per replication and step"}


def draw(frame: pd.DataFrame, path: Path) -> None:
    """Write a figure of particle-steps and Kalman steps of each engine, on logarithmic axes."""
    plots.save(lambda: _figure(frame), path)


def _figure(frame: pd.DataFrame) -> Any:
    figure, axes = plots.new(plots.PAGE, 2.6, cols=2)
    for axis, (what, label) in zip(axes, PANELS.items()):
        part = frame[frame["what"].str.fullmatch(rf"{what}( in .*)?")]
        if len(part):
            _panel(axis, part, what, label)
    for key, label in plots.LABELS.items():
        axes[0].plot([], [], "o", color=plots.COLOURS[key], label=label)
    axes[1].plot([], [], "o", color=plots.GREY, label="EKF")
    axes[1].plot([], [], "s", color=plots.GREY, label="UKF")
    for axis, corner in zip(axes, ("lower left", "upper right")):
        axis.legend(loc=corner, fontsize=6)
    return figure


def _panel(axis: Any, part: pd.DataFrame, what: str, label: str) -> None:
    """Draw the rows of one kind of step, a line for each engine."""
    engines = list(dict.fromkeys(part["what"]))[::-1]
    for row in part.to_dict("records"):
        _point(axis, row, engines.index(row["what"]))
    names = [e.replace(what, "").removeprefix(" in ") for e in engines]
    names = [name.replace("NumPy", "aoabench, NumPy") or "aoabench" for name in names]
    axis.set_yticks(range(len(engines)), names)
    axis.set(xscale="log", xlabel=label, ylim=(-0.5, len(engines) - 0.5))
    axis.set_xlim(left=0.5 * part["value"].min())
    axis.grid(axis="x", which="major", linewidth=0.4)


def _point(axis: Any, row: dict[Any, Any], height: int) -> None:
    """Draw one filter's value; the filters of other libraries have the model AE-nominal."""
    models = list(plots.LABELS)
    key = re.sub(r"^(pf|ekf|ukf)_", "", row["detail"])
    i = models.index(key if key in models else "ae_nominal")
    marker = "s" if row["detail"].lower().startswith("ukf") else "o"
    colour = plots.COLOURS[models[i]]
    axis.plot(row["value"], height + 0.13 * (1.5 - i), marker, color=colour, markersize=4)


def markdown(frame: pd.DataFrame, before: pd.DataFrame | None = None) -> str:
    """The table for the documentation, without the rows that serve only to compute ratios; `before`
    has the rows of an earlier version, measured on the same machine.
    """
    frame = frame[~frame["what"].str.contains(" in ")]
    earlier = {} if before is None else _values(before)
    lines = ["| what | | before | measured | target | how |", "|---|---|---|---|---|---|"]
    for key, value, row in zip(_values(frame), _values(frame).values(), frame.to_dict("records")):
        given = [*key, earlier.get(key, ""), value, row["target"], row["how"]]
        lines.append(f"| {' | '.join(given)} |")
    return "\n".join(lines)


def _values(frame: pd.DataFrame) -> dict[tuple[str, str], str]:
    """The value with its unit of each row, by what and detail."""
    rows = frame.to_dict("records")
    return {(r["what"], r["detail"]): f"{r['value']:.3g} {r['unit']}".strip() for r in rows}


def write_into(page: Path, table: str) -> None:
    """Replace the text between the two bench marks of a page."""
    text = page.read_text(encoding="utf-8")
    marks = r"(?s)(<!-- bench -->\n).*?(\n<!-- /bench -->)"
    page.write_text(re.sub(marks, lambda m: m[1] + table + m[2], text), encoding="utf-8")
