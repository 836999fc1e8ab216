"""The replications of a run that a figure shows: from the run's folder or from a frame."""

from __future__ import annotations

import json
import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from aoabench.columns import REPLICATIONS
from aoabench.errors import UserError, did_you_mean, listed
from aoabench.store import tables
from aoabench.store.compare import with_failures
from aoabench.store.comparison import FAILURES
from aoabench.store.swept import natural

if TYPE_CHECKING:
    import pandas as pd

_NAMES = ("estimator", "scenario", "noise")
_IDENTITY = ("cell", "experiment", *_NAMES)
TAG = "tag"  # column with the tag of a recorded track


@dataclass(frozen=True)
class Source:
    """Replications as `aoabench.load` returns them, with a column for failures.

    Of a folder also `out`, the rows of its `summary`, the `entries` of its records (cell ->
    estimator -> its part key, number of replications and steps) and the `configs` of its cells as
    JSON. late: the estimators that are not causal, as far as that is known. tracks: the numbers of
    the tracks of each cell that is one tag of a recording (see `by_tag`). scale: how much was
    computed, in words (see `scale.scale_text`).
    """

    frame: pd.DataFrame
    out: Path | None = None
    summary: pd.DataFrame | None = None
    entries: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    configs: Mapping[str, str] = field(default_factory=dict)
    late: frozenset[str] = frozenset()
    tracks: Mapping[str, Sequence[int]] = field(default_factory=dict)
    scale: str = ""

    @property
    def parameters(self) -> list[str]:
        """The columns that can differ between cells and estimators: names, tag, seed, and swept
        parameters.
        """
        known = {*REPLICATIONS, FAILURES, "seed"}
        swept = [str(name) for name in self.frame.columns if name not in known]
        return [*_NAMES, *([TAG] if self.tracks else []), *swept, "seed", "experiment"]

    @property
    def recorded(self) -> str:
        """Whether the measurements are "recorded" or "synthetic", or a run holds both."""
        recorded = self.frame["noise"] == "recorded"
        if recorded.any() and not recorded.all():
            return "synthetic and recorded"
        return "recorded" if recorded.any() else "synthetic"

    @property
    def tags(self) -> list[str]:
        """The tags of recorded tracks."""
        return self.frame[TAG].dropna().unique().tolist() if TAG in self.frame else []

    def pairs(self) -> pd.DataFrame:
        """A row for each cell and estimator, with the columns `parameters`."""
        names = dict.fromkeys(["cell", *self.parameters])
        return self.frame[list(names)].drop_duplicates(["cell", "estimator"])

    def chosen(self, where: Sequence[str]) -> Source:
        """The cells and estimators to which all conditions KEY=VALUE[,VALUE] apply; UserError for
        an unknown key or value, and if nothing is left.
        """
        frame = self.frame
        for condition in where:
            key, values = _condition(condition, self)
            frame = frame[frame[key].map(value_text).isin(values)]
        if frame.empty:
            raise UserError(f"where {' and '.join(where)}: no results have all of these")
        return self.kept(set(zip(frame["cell"], frame["estimator"])))

    def kept(self, pairs: Collection[tuple[str, str]]) -> Source:
        """These cells and estimators alone."""
        frames = [self.frame] if self.summary is None else [self.frame, self.summary]
        some = [f[[pair in pairs for pair in zip(f["cell"], f["estimator"])]] for f in frames]
        return replace(self, frame=some[0], summary=some[1] if len(some) > 1 else None)

    def by_tag(self) -> Source:
        """The same with a cell for each tag in place of a cell for each recording, and without the
        summary, which is of all tags; UserError if no track has a tag.
        """
        if not self.tags:
            raise UserError("tag: no results here are of recorded tags; allowed: another column")
        frame = self.frame.copy()
        before = frame["cell"]
        frame["cell"] = before.where(frame[TAG].isna(), before + " " + frame[TAG])
        tagged = frame[frame[TAG].notna()].groupby("cell")["replication"]
        names = dict(zip(frame["cell"], before))
        return replace(
            self,
            frame=frame,
            summary=None,
            entries={name: self.entries[cell] for name, cell in names.items() if self.entries},
            configs={name: self.configs[cell] for name, cell in names.items() if self.configs},
            tracks={str(name): sorted(set(numbers)) for name, numbers in tagged},
        )


def read(
    source: str | os.PathLike[str] | pd.DataFrame, where: Sequence[str] = (), by_tag: bool = False
) -> Source:
    """The replications of a run's folder, or of a frame as `aoabench.load` returns it, that fit the
    conditions `where`; with `by_tag`, or a condition on tags, apart for each tag of a recording.

    Raises UserError for a folder without results, a frame that lacks columns, or a condition that
    does not fit, and RunError for torn tables.
    """
    whole = _whole(source)
    apart = by_tag or any(text.partition("=")[0] == TAG for text in where)
    return (whole.by_tag() if apart else whole).chosen(where)


def _whole(source: str | os.PathLike[str] | pd.DataFrame) -> Source:
    """All replications of a run's folder or of a frame."""
    import pandas as pd

    if isinstance(source, pd.DataFrame):
        lacking = [c for c in (*_IDENTITY, "replication", "outcome", "seed") if c not in source]
        if lacking:
            raise UserError(
                f"the frame has no column {listed(lacking)}; allowed: a frame of aoabench.load or "
                "aoabench.run"
            )
        return Source(with_failures(source.copy()))
    out = Path(source)
    if out.exists() and not out.is_dir():
        raise UserError(f"{out} is a file; allowed: the runner.out folder of a run")
    shown = tables.shown(out, "tidy", "summary", "index")
    index, summary = shown["index"], shown["summary"]
    entries = dict(zip(index["cell"], map(json.loads, index["estimators"])))
    late = summary["estimator"][~summary["causal"].astype(bool)] if "causal" in summary else ()
    return Source(
        with_failures(shown["tidy"]),
        out,
        summary,
        entries,
        dict(zip(index["cell"], index["config"])),
        frozenset(late),
    )


def _condition(text: str, source: Source) -> tuple[str, set[str]]:
    """The key and the values of a condition as text."""
    key, equals, given = text.partition("=")
    if not equals or not given:
        raise UserError(f"where {text}: not a condition; allowed: KEY=VALUE[,VALUE]")
    check_parameter("where", key, source, more=("cell",))
    known = {value_text(value) for value in source.frame[key].unique()}
    values = {given} if given in known else set(given.split(","))  # a name may have commas
    values = {value_text(value) if value in known else _as_number(value) for value in values}
    for value in sorted(values - known):
        shown = [value_text(v) for v in ordered(source.frame[key])]
        hint = did_you_mean(value, shown) or f"; allowed: {listed(shown)}"
        raise UserError(f"where {key}={value}: no results have it{hint}")
    return key, values


def check_parameter(flag: str, key: str, source: Source, more: Sequence[str] = ()) -> None:
    """Raise UserError unless `key` is a column that can differ between cells or estimators."""
    known = list(dict.fromkeys([*source.parameters, *([TAG] if source.tags else []), *more]))
    if key not in known:
        ends = [name for name in known if name.rpartition(".")[2] == key]
        hint = f"; did you mean {ends[0]!r}?" if len(ends) == 1 else did_you_mean(key, known)
        raise UserError(f"{flag} {key}: no such column{hint or f'; allowed: {listed(known)}'}")


def value_text(value: Any) -> str:
    """A value of a parameter as on the command line: 5 for 5.0, null if there is none."""
    import pandas as pd

    if value is None or value is pd.NA or value != value:
        return "null"
    if isinstance(value, bool) or type(value).__name__ == "bool":
        return str(value).lower()
    if isinstance(value, str):
        return value
    return f"{value:.12g}"


def _as_number(text: str) -> str:
    """5 for 5.0 and 5e0; text that is no number as it is."""
    try:
        return value_text(float(text))
    except ValueError:
        return text


def ordered(column: pd.Series) -> list[Any]:
    """The distinct values of a parameter in their natural order: numbers by size, then texts."""
    values = column.unique().tolist()
    return [v for _, v in sorted(zip(natural(values), values), key=lambda pair: pair[0])]


def varied(source: Source, first: Sequence[str] = ()) -> list[str]:
    """The parameters that tell the chosen cells and estimators apart: those that differ, without
    those that others determine; the parameters `first` stay where they differ.
    """
    import pandas as pd

    frame = source.pairs()
    names = dict.fromkeys([*(n for n in first if n in frame), *source.parameters])
    codes = {name: pd.factorize(frame[name], use_na_sentinel=False)[0] for name in names}
    kept = [name for name in names if codes[name].max() > 0]
    count = _combinations([codes[name] for name in kept])
    for name in reversed(kept.copy()):
        rest = [n for n in kept if n != name]
        if _combinations([codes[n] for n in rest]) == count:
            kept = rest
    return kept if count == len(frame) else [*kept, "cell"]


def _combinations(columns: Sequence[np.ndarray]) -> int:
    """The number of different rows of some columns (N,)."""
    return len({row.tobytes() for row in np.stack(columns, axis=-1)}) if columns else 1
