"""The figure of a run: what it shows, the words on it, and the table behind it."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from aoabench.report.runs import courses, distribution, footer, look, swept, values
from aoabench.report.runs.choice import Asked, Choice, choose
from aoabench.report.runs.kinds import DISTRIBUTIONS
from aoabench.report.runs.look import Words
from aoabench.report.runs.metrics import ERRORS, label, mean_label
from aoabench.report.runs.scale import ScaleOf, scale_text
from aoabench.report.runs.source import TAG, Source, read

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
    source: str | os.PathLike[str] | pd.DataFrame,
    asked: Asked,
    where: Sequence[str] = (),
    scale_of: ScaleOf | None = None,
) -> Drawing:
    """Read a run, decide what its figure shows (see `choice.choose`), and compute the numbers; of
    more than look.MOST_PANELS panels, of the first ones.

    Raises UserError for a folder, condition, kind, metric or column that does not fit, and RunError
    for torn tables.
    """
    found = read(source, where, by_tag=TAG in (asked.by, *asked.over))
    choice = choose(found, asked, *_stored(found))
    shown = values.shown(found, choice)
    panels = list(dict.fromkeys(one.panel for one in shown))
    if choice.kind != "pairs":
        shown = [one for one in shown if one.panel in panels[: look.MOST_PANELS]]
        found = found.kept({(one.cell, one.estimator) for one in shown})
        choice = _limited(choice, len(panels), choice.panels)
    look.check_groups(len({one.group for one in shown}), choice.by)
    found = replace(found, scale=scale_text(found, scale_of))
    return _DRAWN[choice.kind](found, choice)


def _limited(choice: Choice, panels: int, names: Sequence[str]) -> Choice:
    """The choice, which says so if there are more panels than look.MOST_PANELS; they differ in the
    columns `names`.
    """
    if panels <= look.MOST_PANELS:
        return choice
    first = f"{look.MOST_PANELS} of {panels} panels are drawn"
    how = f"choose others with where KEY=VALUE[,VALUE], KEY one of {', '.join(names)}"
    return replace(choice, left_out=f"{first}; {how}.")


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
    if source.out is None:
        return False, False
    pairs = source.pairs()[["cell", "estimator"]].itertuples(index=False)
    steps = all(source.entries[cell][name]["steps"] for cell, name in pairs)
    by = None if source.summary is None else source.summary["se_by"]
    return steps or (by is not None and bool((by == "position").all())), steps


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
        *footer.left_out(choice),
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
    lines += footer.left_out(choice)
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
    lines += footer.left_out(choice)
    words = Words("time [s]" if timed else "step", label(choice.metric), _title(choice), lines)
    shown = table.drop(columns=["timed", "steps", *([] if apart else ["track"])])
    return Drawing(choice, shown, lines, lambda: courses.time(table, words))


def _pairs(source: Source, choice: Choice) -> Drawing:
    """Replications of two estimators, which have a panel for each cell and other estimator."""
    points, table = values.paired(source, choice)
    choice = _limited(choice, len(table), ("estimator", *choice.panels))
    table = table.head(look.MOST_PANELS)
    points = points[points["panel"].isin(table["panel"])]
    base, name = table["baseline"].iloc[0], label(choice.metric)
    units = footer.units(source, choice.metric)
    lines = [*footer.about(source), footer.MARKS["pairs"].format(base=base, units=units)]
    lines += footer.left_out(choice)
    words = Words(f"{base}: {name}", f"other estimator: {name}", "", lines)
    return Drawing(choice, table, lines, lambda: courses.pairs(points, table, words))


_DRAWN = {
    **dict.fromkeys(DISTRIBUTIONS, _distribution),
    "curve": _swept,
    "heatmap": _swept,
    "time": _time,
    "pairs": _pairs,
}


def _title(choice: Choice) -> str:
    return "" if choice.by == "estimator" else label(choice.by)
