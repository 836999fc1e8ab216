"""The numbers that a figure of a run shows, as frames with a row for each mark.

In each frame `panel` is the title of the mark's panel and `group` the name of its colour.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from aoabench.errors import UserError
from aoabench.maths import statistics
from aoabench.report import campaign
from aoabench.report.runs.choice import Choice
from aoabench.report.runs.metrics import ERRORS, estimates
from aoabench.report.runs.source import Source, ordered, value_text
from aoabench.report.text import shown_name
from aoabench.store.compare import compare
from aoabench.store.comparison import Comparison
from aoabench.store.every_fix import FixErrors, errors_over_time, fix_errors

if TYPE_CHECKING:
    import pandas as pd

_BAND = 100  # points of a distribution at which its band is computed
_MOST_TIMES = 400
LEVELS = {"q05": 0.05, "q25": 0.25, "q50": 0.5, "q75": 0.75, "q95": 0.95}


@dataclass(frozen=True)
class Shown:
    """One estimator in one cell: where a figure shows it."""

    cell: str
    estimator: str
    panel: str
    group: str


def shown(source: Source, choice: Choice) -> list[Shown]:
    """Each chosen estimator and cell in the order of panels, colours and axes."""
    pairs = source.pairs()
    orders = {}
    for name in dict.fromkeys((*choice.panels, choice.by, *choice.over)):
        values = pairs[name].unique().tolist() if name == "estimator" else ordered(pairs[name])
        orders[name] = {value_text(value): i for i, value in enumerate(values)}
    found = []
    for row in pairs.to_dict("records"):
        texts = {name: value_text(row[name]) for name in orders}
        names = {n: _named(source, n, text) for n, text in texts.items()}
        panel = ", ".join(
            names[n] if n == "estimator" else f"{_short(n)} = {names[n]}"
            for n in choice.panels
            if texts[n] != "null"
        )
        place = tuple(orders[n][texts[n]] for n in (*choice.panels, choice.by, *choice.over))
        found.append((place, Shown(row["cell"], row["estimator"], panel, names[choice.by])))
    return [one for _, one in sorted(found, key=lambda pair: pair[0])]


def _named(source: Source, name: str, text: str) -> str:
    return shown_name(text, text not in source.late) if name == "estimator" else text


def _short(name: str) -> str:
    """A parameter without the path to it."""
    return name.rpartition(".")[2]


def distributions(source: Source, choice: Choice) -> list[tuple[Shown, FixErrors]]:
    """The errors of every fix of each chosen estimator and cell, or the metric of its replications
    (R, 1), NaN without a value.

    Raises UserError if nothing has a value.
    """
    found = []
    rows = dict(list(source.frame.groupby(["cell", "estimator"], sort=False)))
    for one in shown(source, choice):
        if choice.metric in ERRORS:
            assert source.out is not None
            axis = choice.metric.split("_")[1]
            tracks = source.tracks.get(one.cell)
            errors = fix_errors(source.out, source.entries[one.cell][one.estimator], axis, tracks)
            assert errors is not None, "choose() was told that all fixes are stored"
        else:
            values = rows[one.cell, one.estimator][choice.metric].to_numpy(dtype=float)[:, None]
            errors = FixErrors(values, np.ones(values.shape, dtype=bool))
        found.append((one, errors))
    if not any(np.isfinite(errors.error).any() for _, errors in found):
        raise no_values(source, choice.metric)
    return found


def no_values(source: Source, metric: str) -> UserError:
    """The error for results in which a metric has no value at all."""
    if "recorded" in source.recorded and metric.startswith(("rmse", "error", "nees", "cep", "p_w")):
        return UserError(
            f"metric={metric}: a recording without ground truth has no errors; give the truth "
            "with scenario.truth, or use another metric, such as n_ok"
        )
    return UserError(
        f"metric={metric}: no replication has a value; use another metric, such as n_failed, "
        "or other estimators"
    )


Found = Sequence[tuple[Shown, FixErrors]]  # what `distributions` returns


def cdf_points(found: Found) -> pd.DataFrame:
    """The distribution functions: x, the share of all fixes (or replications) with a value of at
    most x, and its pointwise 95 % band low, high, computed at up to 100 points and drawn straight
    between them.
    """
    import pandas as pd

    frames = []
    for one, errors in found:
        x, share = campaign.distribution(errors.error[errors.tried])
        some = x[np.unique(np.linspace(0, len(x) - 1, _BAND).astype(int))]
        low, high = errors.share_band(some)
        ends = {"low": np.interp(x, some, low), "high": np.interp(x, some, high)}
        frames.append(pd.DataFrame({**_of(one), "x": x, "share": share, **ends}))
    return pd.concat(frames, ignore_index=True)


def quantiles(found: Found) -> pd.DataFrame:
    """A row for each estimator and cell: replications, n values of `of` fixes (or replications),
    minimum, quantiles and maximum of the values.
    """
    import pandas as pd

    rows = []
    for one, errors in found:
        given = errors.error[np.isfinite(errors.error)]
        counts = {"replications": errors.replications, "n": len(given)}
        row = {**_of(one), **counts, "of": int(errors.tried.sum())}
        levels = np.quantile(given, list(LEVELS.values())) if len(given) else np.full(5, np.nan)
        ends = (given.min(), given.max()) if len(given) else (np.nan, np.nan)
        rows.append(row | dict(zip(LEVELS, levels)) | dict(zip(("minimum", "maximum"), ends)))
    return pd.DataFrame(rows)


def samples(found: Found, most: int = 2000) -> pd.DataFrame:
    """The values `x` of each estimator and cell; of more than `most`, evenly spaced quantiles."""
    import pandas as pd

    frames = []
    for one, errors in found:
        given = np.sort(errors.error[np.isfinite(errors.error)])
        if len(given) > most:
            given = np.quantile(given, (np.arange(most) + 0.5) / most)
        frames.append(pd.DataFrame({**_of(one), "x": given}))
    return pd.concat(frames, ignore_index=True)


def outside(found: Found, ends: tuple[float, float]) -> tuple[int, int]:
    """How many values lie below, and above, the ends of an axis."""
    values = [errors.error for _, errors in found]
    below, above = ([v < ends[0] for v in values], [v > ends[1] for v in values])
    return sum(int(b.sum()) for b in below), sum(int(a.sum()) for a in above)


def means(source: Source, choice: Choice) -> pd.DataFrame:
    """The estimates of the metric (see `metrics.estimates`) with the parameters `choice.over`."""
    import pandas as pd

    found = estimates(source, choice.metric).set_index(["cell", "estimator"])
    if not np.isfinite(found["value"]).any():
        raise no_values(source, choice.metric)
    over = source.pairs().set_index(["cell", "estimator"], drop=False)[list(choice.over)]
    each = shown(source, choice)
    keys = pd.MultiIndex.from_tuples([(one.cell, one.estimator) for one in each])
    places = pd.DataFrame([_of(one) for one in each], index=keys)
    return pd.concat([places, over.loc[keys], found.loc[keys]], axis=1).reset_index(drop=True)


def courses(source: Source, choice: Choice) -> pd.DataFrame:
    """Errors over the steps: x (the time in s where it is known, in a recording since its first
    fix; else the step), median and the quantiles low (5 %) and high (95 %) over the n replications
    with a position. The tracks of a recording, which have times of their own, stay apart: `track`
    has their number, -1 elsewhere. Of more than 400 steps, each point covers several (`steps`).
    """
    import pandas as pd

    assert source.out is not None
    frames = []
    recorded = set(source.frame["cell"][source.frame["noise"] == "recorded"])
    for one in shown(source, choice):
        entry = source.entries[one.cell][one.estimator]
        frame = errors_over_time(source.out, entry, choice.metric.split("_")[1])
        timed = bool(frame["time_s"].notna().all())
        start = frame["time_s"].min() if one.cell in recorded else 0.0
        at = frame["time_s"] - start if timed else frame["step"].astype(float)
        tracks = source.tracks.get(one.cell)
        if tracks is not None:
            mine = frame["replication"].isin(tracks)
            at, frame = at[mine], frame[mine]
        several = frame["replication"].nunique() > 1
        apart = one.cell in recorded and (several or tracks is not None)
        frame["track"] = frame["replication"] if apart else -1
        frame["x"], steps = _spans(at.to_numpy())
        each = frame.groupby(["track", "x"])["error"]
        found = each.quantile(np.array([0.5, 0.05, 0.95])).unstack()
        found.columns = pd.Index(["median", "low", "high"])
        found["n"] = each.count()
        frames.append(found.reset_index().assign(**_of(one), timed=timed, steps=steps))
    whole = pd.concat(frames, ignore_index=True)
    if not whole["median"].notna().any():
        raise no_values(source, choice.metric)
    return whole


def _spans(at: np.ndarray) -> tuple[np.ndarray, int]:
    """The times (N,) themselves, or the mean of each span of several neighbouring distinct ones if
    there are more than _MOST_TIMES; and the number of times in a span.
    """
    times, which = np.unique(at, return_inverse=True)
    steps = -(-len(times) // _MOST_TIMES)
    starts = np.arange(0, len(times), steps)
    sizes = np.diff(np.append(starts, len(times)))
    return (np.add.reduceat(times, starts) / sizes)[which // steps], steps


def paired(source: Source, choice: Choice) -> tuple[pd.DataFrame, pd.DataFrame]:
    """The metric of each replication for two estimators, x of the baseline and y of another one, in
    a panel for each cell and other estimator; and a row for each panel: the change of the mean with
    its 95 % interval, as in `compare`, and the number of pairs in which y is smaller, and equal.
    """
    import pandas as pd

    base = choice.baseline or _best(source, choice.metric)
    changes = _changes(source, base, choice.metric)
    points, rows = [], []
    names = source.frame["estimator"].unique().tolist()
    for one in sorted(shown(source, choice), key=lambda one: names.index(one.estimator)):
        pair = changes.get((one.cell, one.estimator))
        if pair is None:
            continue
        mine = source.frame[source.frame["cell"] == one.cell]
        wide = mine.pivot(index="replication", columns="estimator", values=choice.metric)
        both = wide[[base, one.estimator]].dropna()
        x, y = both[base].to_numpy(), both[one.estimator].to_numpy()
        panel = ", ".join(filter(None, (one.group, one.panel)))
        points.append(pd.DataFrame({"panel": panel, "replication": both.index, "x": x, "y": y}))
        counts = {"n": len(x), "of": len(wide), "smaller": int((y < x).sum())}
        counts["equal"] = int((y == x).sum())
        rows.append(
            {"panel": panel, "estimator": one.estimator, "baseline": base, **counts, **pair}
        )
    if not points:
        raise UserError(f"baseline={base}: no other estimator of these results has cells with it")
    if not any(map(len, points)):
        raise no_values(source, choice.metric)
    return pd.concat(points, ignore_index=True), pd.DataFrame(rows)


def _best(source: Source, metric: str) -> str:
    """The estimator with the smallest mean over all its cells' means, of those in most cells."""
    mean = source.frame.groupby(["estimator", "cell"])[metric].mean().groupby("estimator")
    order = mean.agg(["count", "mean"]).sort_values(["count", "mean"], ascending=[False, True])
    return str(order.index[0])


def _changes(source: Source, base: str, metric: str) -> dict[tuple[str, str], dict[str, Any]]:
    """The change against the baseline with its interval and unit, by cell and other estimator."""
    names = ("change", "change_low", "change_high", "unit")
    keep = {(one["cell"], one["estimator"]) for one in source.pairs().to_dict("records")}
    if source.out is not None and not source.tracks:
        table = compare(source.out, base, metric).to_dict("records")
        found = {(r["cell"], r["estimator"]): {n: r[n] for n in names} for r in table}
        return {k: v for k, v in found.items() if k in keep and (k[0], base) in keep}
    found = {}
    for cell, mine in source.frame.groupby("cell"):
        wide = mine.pivot(index="replication", columns="estimator", values=metric)
        for name in [n for n in wide.columns if n != base and base in wide.columns]:
            pair = statistics.paired(wide[name], wide[base])
            values = (len(wide), wide[name].mean(), wide[base].mean(), pair, "replication")
            one = Comparison(metric, name, base, *values)
            found[cell, name] = dict(zip(names, (*one.change, one.unit)))
    return found


def _of(one: Shown) -> dict[str, str]:
    return {n: v for n, v in asdict(one).items() if n in ("panel", "group")}
