"""The figure of a run: what it shows, the words on it, and the table behind it."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from aoabench.report.runs import courses, distribution, footer, look, swept, values
from aoabench.report.runs.choice import Asked, Choice, choose
from aoabench.report.runs.kinds import DISTRIBUTIONS
from aoabench.report.runs.look import Words
from aoabench.report.runs.metrics import ERRORS, label, mean_label
from aoabench.report.runs.source import Source, read

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Drawing:
    """A figure of a run that can be drawn: `table` has its numbers, `footer` its sentences; `draw`
    makes it with the style in force (see `plots.save`).
    """

    choice: Choice
    table: pd.DataFrame
    footer: list[str]
    draw: Callable[[], Figure]


def prepare(
    source: str | os.PathLike[str] | pd.DataFrame, asked: Asked, where: Sequence[str] = ()
) -> Drawing:
    """Read a run, decide what its figure shows (see `choice.choose`), and compute the numbers.

    Raises UserError for a folder, condition, kind, metric or column that does not fit, and RunError
    for torn tables.
    """
    found = read(source, where)
    choice = choose(found, asked, *_stored(found))
    shown = values.shown(found, choice)
    places = {one.panel for one in shown}, {one.group for one in shown}
    look.check_size(len(places[0]), len(places[1]), choice.panels, choice.by)
    if choice.kind in DISTRIBUTIONS:
        return _distribution(found, choice)
    if choice.kind == "time":
        return _time(found, choice)
    return _pairs(found, choice) if choice.kind == "pairs" else _swept(found, choice)


def plot(
    source: str | os.PathLike[str] | pd.DataFrame,
    kind: str | None = None,
    metric: str | None = None,
    by: str | None = None,
    over: str | Sequence[str] = (),
    where: Sequence[str] | str = (),
    baseline: str | None = None,
) -> Figure:
    """The figure of a run as `aoabench.plot` describes it."""
    import matplotlib.pyplot as plt

    from aoabench.report.plots import STYLE

    names = (over,) if isinstance(over, str) else tuple(over)
    conditions = (where,) if isinstance(where, str) else tuple(where)
    drawing = prepare(source, Asked(kind, metric, by, names, baseline), conditions)
    with plt.style.context(str(STYLE)):
        figure = drawing.draw()
        figure.draw_without_rendering()  # ticks take their style when they are first drawn
        plt.close(figure)  # the caller shows or saves it
    return figure


def _stored(source: Source) -> tuple[bool, bool]:
    """Whether the error of every fix of every estimator is stored, and whether all steps are."""
    if source.out is None or source.summary is None:
        return False, False
    pairs = source.pairs()[["cell", "estimator"]].itertuples(index=False)
    steps = all(source.entries[cell][name]["steps"] for cell, name in pairs)
    return steps or bool((source.summary["se_by"] == "position").all()), steps


def _distribution(source: Source, choice: Choice) -> Drawing:
    """Distribution functions, boxes or violins."""
    found = values.distributions(source, choice)
    table = values.quantiles(found)
    log = look.is_heavy(table)
    ends = look.limits(table, log, whole=choice.kind != "cdf")
    fixes = choice.metric in ERRORS
    lines = [
        *footer.about(source, table if fixes else None),
        footer.MARKS[choice.kind].format(units=footer.units(source, choice.metric)),
        *footer.axis(log, *values.outside(found, ends), choice.kind == "cdf"),
        *footer.without(table, "fixes" if fixes else "replications"),
    ]
    name = label(choice.metric)
    words = Words(name, "", _title(choice), lines)
    if choice.kind == "cdf":
        points = values.cdf_points(found)
        lines[1] = footer.bands(points, lines[1])
        words = Words(name, f"share of {'fixes' if fixes else 'replications'}", words.by, lines)
        return Drawing(choice, table, lines, lambda: distribution.cdf(points, table, words))
    if choice.kind == "box":
        return Drawing(choice, table, lines, lambda: distribution.box(table, words))
    some = values.samples(found)
    return Drawing(choice, table, lines, lambda: distribution.violin(some, table, words))


def _swept(source: Source, choice: Choice) -> Drawing:
    """A metric over one or two parameters."""
    table = values.means(source, choice)
    name = mean_label(choice.metric)
    lines = [*footer.about(source), *footer.without(table, "replications")]
    if choice.kind == "curve":
        bars = footer.MARKS["curve"].format(units=footer.units(source, choice.metric))
        lines[1:1] = [bars, *footer.bars(table)]
        words = Words(label(choice.over[0]), name, _title(choice), lines)
        return Drawing(choice, table, lines, lambda: swept.curve(table, choice.over[0], words))
    first, second = choice.over
    words = Words(label(first), label(second), name, lines)
    return Drawing(choice, table, lines, lambda: swept.heatmap(table, (first, second), words))


def _time(source: Source, choice: Choice) -> Drawing:
    """Errors over the steps."""
    table = values.courses(source, choice)
    timed, apart = bool(table["timed"].all()), bool((table["track"] >= 0).any())
    lines = [*footer.about(source), footer.over_time(apart, int(table["steps"].max()))]
    words = Words("time [s]" if timed else "step", label(choice.metric), _title(choice), lines)
    shown = table.drop(columns=["timed", "steps", *([] if apart else ["track"])])
    return Drawing(choice, shown, lines, lambda: courses.time(table, words))


def _pairs(source: Source, choice: Choice) -> Drawing:
    """Replications of two estimators."""
    points, table = values.paired(source, choice)
    base, name = table["baseline"].iloc[0], label(choice.metric)
    units = footer.units(source, choice.metric)
    lines = [*footer.about(source), footer.MARKS["pairs"].format(base=base, units=units)]
    words = Words(f"{base}: {name}", f"other estimator: {name}", "", lines)
    return Drawing(choice, table, lines, lambda: courses.pairs(points, table, words))


def _title(choice: Choice) -> str:
    return "" if choice.by == "estimator" else label(choice.by)
