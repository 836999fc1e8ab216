r"""A run's table as LaTeX: a tabular with the rules of booktabs and number columns of siunitx."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from aoabench.errors import printable
from aoabench.report.exported import Exported, Metric, by_value, plain
from aoabench.report.text import shown_name

if TYPE_CHECKING:
    import pandas as pd

_SPECIAL = {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "[": "{[}",  # after a line's end it would be an argument
    **{mark: f"\\{mark}" for mark in "&%$#_{}"},
}
_UNITS = {
    "m": r"\metre",
    "s": r"\second",
    "ns": r"\nano\second",
    "m/s": r"\metre\per\second",
    "m^2": r"\square\metre",
    "deg": r"\degree",
    "rad": r"\radian",
    "Hz": r"\hertz",
    "dB": r"\decibel",
    "dBm": "dBm",
    "GHz": r"\giga\hertz",
    "kHz": r"\kilo\hertz",
}
_NONE = "{--}"


def escaped(text: str) -> str:
    """The text with the characters that LaTeX obeys escaped, on one line."""
    line = " ".join(printable(text).split())
    return "".join(_SPECIAL.get(character, character) for character in line)


def latex(table: Exported, about: Sequence[str], by: str | None = None, digits: int = 2) -> str:
    r"""The table as a tabular, with a row for each row of `table`; with `by`, with a group of
    columns for each value of this key.

    A number and its 95 % interval, both rounded to `digits` digits of the interval's half-width,
    are two columns. `about`: lines that head the table as comments.
    """
    groups = by_value(table, by) if by else [(None, table.frame)]
    keys = table.shown(by)
    columns = [c for _, rows in groups for m in table.metrics for c in _columns(m, rows, digits)]
    first = [_names(groups[0][1], key) for key in keys]
    kinds = "".join(["r" if one.is_number else "l" for one in first] + [c.kind for c in columns])
    body = zip(*[one.cells for one in first], *[c.cells for c in columns])
    about = [*about, r"needs \usepackage{booktabs,siunitx}"]
    lines = [f"% {' '.join(printable(line).split())}" for line in about]
    lines += [r"\begin{tabular}{" + kinds + "}", r"\toprule"]
    lines += _heads(keys, groups, table.metrics, by)
    lines += [r"\midrule", *(f"{' & '.join(row)} \\\\" for row in body)]
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}"]) + "\n"


@dataclass(frozen=True)
class _Column:
    """A column of the tabular: its letter and its cells."""

    kind: str
    cells: list[str]

    @property
    def is_number(self) -> bool:
        return self.kind == "r"


def _names(rows: pd.DataFrame, key: str) -> _Column:
    """The column of a key."""
    values = list(rows[key])
    if key == "estimator":
        values = [shown_name(*pair) for pair in zip(values, rows["causal"])]
    numbers = rows[key].dtype.kind in "iuf"
    return _Column("r" if numbers else "l", [escaped(plain(value)) for value in values])


def _columns(metric: Metric, rows: pd.DataFrame, digits: int) -> Iterator[_Column]:
    """The columns of a metric: the number, and its interval or standard error if it has one."""
    parts = metric.texts(rows, digits)
    numbers = [value for value, _ in parts]
    yield _Column(_format(numbers), [number or _NONE for number in numbers])
    if metric.low or metric.se:
        marks = [error.replace("±", r"$\pm$").replace("inf", r"$\infty$") for _, error in parts]
        yield _Column("@{\\;}l", marks)


def _format(numbers: Sequence[str]) -> str:
    """The S column that fits these numbers."""
    found = [re.fullmatch(r"(-?)(\d+)(?:\.(\d+))?(?:e([+-]?\d+))?", n) for n in numbers if n]
    whole = max((len(m[1] + m[2]) for m in found if m), default=1)
    part = max((len(m[3] or "") for m in found if m), default=0)
    sign = "-" if any(m and m[1] for m in found) else ""
    power = max((len(m[4].lstrip("+-")) for m in found if m and m[4]), default=0)
    e = f"e{'-' if any(m and (m[4] or '').startswith('-') for m in found) else ''}{10**power // 10}"
    return f"S[table-format={sign}{whole - len(sign)}.{part}{e if power else ''}]"


def _heads(
    keys: Sequence[str],
    groups: Sequence[tuple[Any, pd.DataFrame]],
    metrics: Sequence[Metric],
    by: str | None,
) -> Iterator[str]:
    """The lines of the table's head."""
    widths = [2 if m.low or m.se else 1 for m in metrics]
    if by:
        cells, rules, at = [""] * len(keys), [], len(keys) + 1
        for value, _ in groups:
            text = f"{escaped(by)} = {escaped(plain(value))}"
            cells.append(rf"\multicolumn{{{sum(widths)}}}{{c}}{{{text}}}")
            rules.append(rf"\cmidrule(lr){{{at}-{at + sum(widths) - 1}}}")
            at += sum(widths)
        yield " & ".join(cells) + r" \\"
        yield " ".join(rules)
    each = [rf"\multicolumn{{{w}}}{{c}}{{{_title(m)}}}" for m, w in zip(metrics, widths)]
    yield " & ".join([*map(escaped, keys), *each * len(groups)]) + r" \\"


def _title(metric: Metric) -> str:
    unit = _UNITS.get(metric.unit)
    error = r" [95\,\%]" if metric.low else r" $\pm$ s.e." if metric.se else ""
    return escaped(metric.title) + error + (rf" / \si{{{unit}}}" if unit else "")
