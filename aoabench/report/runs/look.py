"""Panels, colours, legends, axes and the footer of the figures of a run."""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from aoabench.errors import UserError
from aoabench.report import plots

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

MOST_PANELS = 12
MOST_GROUPS = 40
_STYLES = ("-", "--", "-.", ":")
_MARKERS = "osD^vPX<>*"
_FEW = 6  # groups whose legend lies above the panels; that of more lies beside them
_COLUMN = 30  # entries of a legend in a column
_MORE = 15  # letters after a group's name in a legend
_LETTERS = 20  # of the footer in an inch
HEAVY = 10.0  # largest 95 % quantile over smallest median, beyond which an axis is logarithmic


@dataclass(frozen=True)
class Words:
    """The texts of a figure: axis labels `x` and `y`, `by` (the title of the legend) and the
    sentences of the footer.
    """

    x: str
    y: str
    by: str = ""
    footer: Sequence[str] = ()


@dataclass(frozen=True)
class Sheet:
    """A figure with a panel for each title, in order."""

    figure: Figure
    axes: dict[str, Any]
    groups: list[str]

    def style(self, group: str) -> dict[str, Any]:
        """Colour, line style and marker of a group; neighbours differ in all three, for prints in
        grey.
        """
        i = self.groups.index(group)
        return {
            "color": f"C{i % 7}",
            "linestyle": _STYLES[i % len(_STYLES)],
            "marker": _MARKERS[i % len(_MARKERS)],
        }


def check_groups(groups: int, by: str) -> None:
    """Raise UserError for more colours than a reader can tell apart."""
    if groups > MOST_GROUPS:
        raise UserError(
            f"{groups} colours for the values of {by}: at most {MOST_GROUPS} are drawn; choose "
            "some values with where KEY=VALUE[,VALUE]"
        )


def _lines(text: str, letters: int) -> list[str]:
    """A text in lines of at most so many letters; the last word of a clause, such as the 1 of
    "seed 1;", stays with the word before it.
    """
    bound = re.sub(r" (?=\S+[;.](?: |$))", "\N{NO-BREAK SPACE}", text)
    lines = textwrap.wrap(bound, letters)
    return [line.replace("\N{NO-BREAK SPACE}", " ") for line in lines]


def sheet(
    frame: pd.DataFrame, words: Words, height: float | None = None, groups: bool = True
) -> Sheet:
    """An empty figure with a panel for each title in the frame's `panel`, in the order of
    appearance; `height` of a panel in inches; with `groups` there is room for their legend.
    """
    titles = list(dict.fromkeys(frame["panel"]))
    names = list(dict.fromkeys(frame["group"])) if "group" in frame else []
    cols = 2 if len(titles) in (2, 4) else min(len(titles), 3)
    rows = math.ceil(len(titles) / cols)
    above, beside, least = _room(names) if groups else (0.0, 0.0, 0.0)
    width = (plots.PAGE if cols > 1 else 1.5 * plots.COLUMN) + beside
    footer = [t for text in words.footer for t in _lines(text, int(_LETTERS * width))]
    inner = rows * ((height or (2.9 if cols == 1 else 2.2)) + 0.25)
    total = max(inner + 0.12 * len(footer) + 0.3, least) + above
    figure, axes = plots.new(width, total, rows, cols, squeeze=False, sharex=True, sharey=True)
    for axis in axes.ravel()[len(titles) :]:
        axis.set_visible(False)
    for i, (axis, title) in enumerate(zip(axes.ravel(), titles)):
        axis.set_title("\n".join(textwrap.wrap(title, 34 if cols > 1 else 60)), loc="left")
        last = i + cols >= len(titles)
        axis.tick_params(labelbottom=last)
        axis.set_xlabel(broken(words.x, 34 if cols > 1 else 60) if last else "")
        axis.set_ylabel(broken(words.y, 34) if i % cols == 0 else "")
    figure.supxlabel("\n".join(footer), x=0.01, ha="left", fontsize=6, color=plots.GREY)
    return Sheet(figure, dict(zip(titles, axes.ravel())), names)


def broken(text: str, most: int) -> str:
    """The text in lines of at most `most` letters, if spaces and the dots of a key allow it."""
    lines = [""]
    for word in re.findall(r"[^. ]+[. ]*|[. ]+", text):
        if lines[-1] and len(lines[-1] + word.rstrip()) > most:
            lines.append("")
        lines[-1] += word
    return "\n".join(line.rstrip() for line in lines)


def _room(names: Sequence[str]) -> tuple[float, float, float]:
    """Inches that a legend takes above the panels, or beside them, and the least height of a figure
    for a legend beside them.
    """
    if len(names) <= _FEW:
        return 0.3 + 0.17 * math.ceil(len(names) / 2), 0.0, 0.0
    cols = math.ceil(len(names) / _COLUMN)
    wide = 0.7 + 0.065 * (max(map(len, names)) + _MORE)
    return 0.0, cols * wide, 0.3 + 0.165 * math.ceil(len(names) / cols)


def panels_of(frame: pd.DataFrame) -> Iterator[tuple[str, pd.DataFrame]]:
    """The title and the rows of each panel, in the order of appearance."""
    for panel, mine in frame.groupby("panel", sort=False):
        yield str(panel), mine


def groups_of(frame: pd.DataFrame) -> Iterator[tuple[str, str, pd.DataFrame]]:
    """The title, the group and the rows of each group in each panel."""
    for panel, rows in panels_of(frame):
        for group, mine in rows.groupby("group", sort=False):
            yield panel, str(group), mine


def legend(made: Sheet, by: str) -> None:
    """The legend of all groups: above the panels, or beside them if there are many."""
    found = {
        label: handle
        for axis in made.axes.values()
        for handle, label in zip(*axis.get_legend_handles_labels())
    }
    if not found:
        return
    many = len(made.groups) > _FEW
    place: Any = "outside right upper" if many else "outside upper left"
    cols = math.ceil(len(found) / _COLUMN) if many else min(len(found), 2)
    made.figure.legend(
        list(found.values()), list(found), loc=place, ncols=cols, title=by or None, alignment="left"
    )


def scale(axes: Any, which: str, log: bool, values: Any) -> None:
    """Make the x or y axis linear, or logarithmic with plain numbers: 0.5, 1, 2, 5, 10, or the
    powers of ten alone where the positive `values` span more than two decades.
    """
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axes.set(**{f"{which}scale": "log" if log else "linear"})
    axis = axes.xaxis if which == "x" else axes.yaxis
    if log:
        x = np.asarray(values, dtype=float)
        x = x[np.isfinite(x) & (x > 0)]
        short = len(x) > 0 and x.max() < 100 * x.min()
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if short else (1.0,)))
        axis.set_major_formatter(FuncFormatter(lambda value, _place: f"{value:g}"))
        axis.set_minor_formatter(NullFormatter())


def is_heavy(quantiles: pd.DataFrame) -> bool:
    """Whether the axis of a distribution is logarithmic: the largest 95 % quantile exceeds HEAVY
    times the smallest median, and all medians are positive.
    """
    known = quantiles[quantiles["n"] > 0]
    least = known["q50"].min()
    return bool(least > 0 and known["q95"].max() > HEAVY * least)


def limits(quantiles: pd.DataFrame, log: bool, whole: bool) -> tuple[float, float]:
    """The ends of the axis of a distribution; with `whole` a logarithmic axis shows each value
    above 0, a linear one ends at 1.5 times the largest 95 % quantile, or at the largest value.
    """
    known = quantiles[quantiles["n"] > 0]
    top = float(known["maximum"].max())
    if log:
        low = known["minimum"][known["minimum"] > 0].min() if whole else known["q05"].min()
        low = low if low > 0 else known["q50"].min() / 100
        return 0.8 * float(low), 1.2 * top
    bottom = min(float(known["minimum"].min()), 0.0)
    top = min(top, 1.5 * float(known["q95"].max())) if known["q95"].max() > 0 else top
    return bottom, (1.05 * top or 1.0)


def is_even_in_log(values: np.ndarray) -> bool:
    """Whether the values (K,) of an axis span a factor of 8 and are spaced more evenly by ratio
    than by difference.
    """
    x = np.unique(values[np.isfinite(values)])
    if len(x) < 3 or x[0] <= 0 or x[-1] < 8 * x[0]:
        return False
    spread = [np.std(d) / np.mean(d) for d in (np.diff(x), np.diff(np.log(x)))]
    return bool(spread[1] < spread[0])


def spans_decades(values: np.ndarray) -> bool:
    """Whether positive values (K,) span more than a factor of 20."""
    x = values[np.isfinite(values)]
    return bool(len(x) and x.min() > 0 and x.max() > 20 * x.min())
