"""What a figure of a run shows: its kind, metric, colours, axes and panels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from aoabench.errors import UserError, did_you_mean, listed
from aoabench.report.runs.kinds import AXES, DISTRIBUTIONS, KINDS
from aoabench.report.runs.metrics import ERRORS, SUMMARIES, check_metric
from aoabench.report.runs.source import Source, check_parameter, varied


@dataclass(frozen=True)
class Asked:
    """A user's wishes, None where the run's contents decide."""

    kind: str | None = None
    metric: str | None = None
    by: str | None = None
    over: Sequence[str] = ()
    baseline: str | None = None


@dataclass(frozen=True)
class Choice:
    """A kind of figure: `metric`; `by`, the column with a colour for each of its values; `over`,
    the swept parameters on the axes; `panels`, the columns with a panel for each combination of
    their values; `baseline`, the estimator of the x axes of pairs; `others`, the other kinds that
    fit; `left_out`, the sentence about panels that are not drawn, "" if all are.
    """

    kind: str
    metric: str
    by: str
    over: tuple[str, ...]
    panels: tuple[str, ...]
    baseline: str | None
    others: tuple[str, ...]
    left_out: str = ""


def choose(source: Source, asked: Asked, fixes: bool, steps: bool) -> Choice:
    """The figure of a source's replications for a user's wishes.

    `fixes` says whether the error of every fix is stored, `steps` whether the steps are. Raises
    UserError for a wish that is unknown or that these replications cannot fulfil.
    """
    _check(source, asked)
    by = asked.by or "estimator"
    names = varied(source, [by, *asked.over])
    numbers = [name for name in names if name != by and is_number(source, name)]
    own = {by, "cell", "estimator"} - set(asked.over)
    free = [name for name in names if name not in own]
    reasons = _unfit(source, asked, free, fixes, steps)
    fit = [kind for kind in KINDS if kind not in reasons]
    kind = asked.kind or _default(asked, numbers, fit)
    if kind is None or kind in reasons:
        why = reasons[asked.kind] if asked.kind else f"no kind of figure fits {asked.metric}"
        flag = f"kind={asked.kind}" if asked.kind else f"metric={asked.metric}"
        raise UserError(f"{flag}: {why}" + (f"; these kinds fit: {', '.join(fit)}" if fit else ""))
    if kind == "pairs" and by != "estimator":
        raise UserError(f"by={by}: allowed for kind=pairs: estimator")
    if kind != "pairs" and asked.baseline is not None:
        raise UserError(f"baseline={asked.baseline}: allowed for kind=pairs alone")
    over = tuple(asked.over) or _over(source, kind, numbers, free)
    if len(over) != AXES.get(kind, 0):
        need = AXES.get(kind, 0)
        allowed = ("no parameter", "one parameter", "two parameters")[need]
        raise UserError(f"over={','.join(over)}: allowed for kind={kind}: {allowed}")
    panels = tuple(name for name in names if name not in (*over, by))
    if kind == "heatmap" and by in names:
        panels = (by, *panels)
    metric = asked.metric or _metric(kind, fixes)
    others = tuple(name for name in fit if name != kind)
    return Choice(kind, metric, by, over, panels, asked.baseline, others)


def is_number(source: Source, name: str) -> bool:
    """Whether a parameter's values are numbers, the seed apart."""
    from pandas.api.types import is_bool_dtype, is_numeric_dtype

    column = source.frame[name]
    return name != "seed" and is_numeric_dtype(column) and not is_bool_dtype(column)


def _check(source: Source, asked: Asked) -> None:
    """Raise UserError for an unknown kind, metric, column or baseline."""
    if asked.kind is not None and asked.kind not in KINDS:
        hint = did_you_mean(asked.kind, KINDS) or f"; allowed: {', '.join(KINDS)}"
        raise UserError(f"kind={asked.kind}: no such kind{hint}")
    if asked.metric is not None:
        check_metric(asked.metric)
    for flag, names in (("by", [asked.by] if asked.by else []), ("over", asked.over)):
        for name in names:
            check_parameter(flag, name, source)
    for name in asked.over:
        values = source.frame[name].nunique(dropna=False)
        if values < 2 or name == (asked.by or "estimator") or list(asked.over).count(name) > 1:
            why = "has one value here" if values < 2 else "is used already"
            raise UserError(f"over={name}: {why}; allowed: another parameter that differs")
    known = list(source.frame["estimator"].unique())
    if asked.baseline is not None and asked.baseline not in known:
        hint = did_you_mean(asked.baseline, known) or f"; allowed: {listed(known)}"
        raise UserError(f"baseline={asked.baseline}: not among these results{hint}")


def _unfit(
    source: Source, asked: Asked, free: list[str], fixes: bool, steps: bool
) -> dict[str, str]:
    """The kinds that these replications or this metric cannot show, each with the reason."""
    found = {}
    swept = f"this run sweeps {', '.join(free)}" if free else "this run sweeps none"
    if not free:
        found["curve"] = f"it needs a swept parameter, and {swept}"
    if len(free) < 2:
        found["heatmap"] = f"it needs two swept parameters, and {swept}"
    if source.out is None:
        found["time"] = "it needs the steps, which a frame does not hold; give the run's folder"
    elif not steps:
        found["time"] = "it needs the steps; run the same command again with store.steps=true"
    if source.frame.groupby("cell")["estimator"].nunique().max() < 2:
        found["pairs"] = "it needs two estimators in a cell"
    return found | _unfit_metric(asked.metric, fixes)


def _unfit_metric(metric: str | None, fixes: bool) -> dict[str, str]:
    """The kinds that do not show a metric, each with the reason."""
    if metric is None:
        return {}
    if metric in ERRORS:
        why = f"{metric} is the error of a fix; use an RMSE, such as rmse_3d_m"
        found = dict.fromkeys(("curve", "heatmap", "pairs"), why)
        if not fixes:
            again = "run the same command again with store.steps=true, or use rmse_3d_m"
            found |= dict.fromkeys(DISTRIBUTIONS, f"the fixes are not stored; {again}")
        return found
    found = {"time": f"{metric} is not the error of a fix; use {', '.join(ERRORS)}"}
    if metric in SUMMARIES:
        why = f"{metric} is one number for a cell and estimator, not for each replication"
        found |= dict.fromkeys((*DISTRIBUTIONS, "pairs"), why)
    return found


def _default(asked: Asked, numbers: list[str], fit: list[str]) -> str | None:
    """The kind for what the run sweeps: a curve over one parameter with numbers, a heat map of two,
    else a distribution.
    """
    count = len(asked.over) or min(len(numbers), 2)
    wanted = ("cdf", "curve", "heatmap")[min(count, 2)]
    if asked.baseline is not None:
        wanted = "pairs"
    return wanted if wanted in fit else next(iter(fit), None)


def _over(source: Source, kind: str, numbers: list[str], free: list[str]) -> tuple[str, ...]:
    """The parameters for the axes: those with numbers first, of these those with most values; x
    before y.
    """
    count = {name: source.frame[name].nunique() for name in free}
    order = sorted(free, key=lambda name: (name not in numbers, -count[name], free.index(name)))
    axes = order[: AXES.get(kind, 0)]
    return tuple(sorted(axes, key=lambda name: (name not in numbers, free.index(name))))


def _metric(kind: str, fixes: bool) -> str:
    errors = kind == "time" or (kind in DISTRIBUTIONS and fixes)
    return ERRORS[0] if errors else "rmse_3d_m"
