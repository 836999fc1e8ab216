"""Every fix of replications: as stored where they share their true positions, else from steps."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cache, cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from aoabench.errors import UserError
from aoabench.store.accuracy import Errors
from aoabench.store.clusters import Clusters, influences, position_sums
from aoabench.store.folder import missing, noted_parts
from aoabench.store.index import entry_of
from aoabench.store.parts import Part, intact_parts, missing_ranges
from aoabench.types import Outcome

if TYPE_CHECKING:
    import pyarrow as pa


@dataclass(frozen=True)
class Fixes:
    """Every fix of one estimator in one cell whose replications share their true positions, or are
    tracks of a recording; arrays (R, T), or None if a part was stored without them. In a recording
    T counts the fixes of all tracks.

    error_3d_m, error_xy_m in m (NaN: no position), iterations, score and anchors_used of
    types.Estimates (NaN: not reported), outcome of types.Outcome, -1 for a fix of another track,
    place: the number of the true
    position, which several fixes may share; reason of types.Reason; imprecise (see
    engine.inputs.Inputs) and n_unmeasured (no anchor has an angle or a delay), 0 or 1; sigma_x_m,
    sigma_y_m, sigma_z_m: reported standard deviations in m (NaN: not reported).
    """

    error_3d_m: np.ndarray
    error_xy_m: np.ndarray
    iterations: np.ndarray
    score: np.ndarray
    anchors_used: np.ndarray
    outcome: np.ndarray
    place: np.ndarray | None = None
    reason: np.ndarray | None = None
    imprecise: np.ndarray | None = None
    n_unmeasured: np.ndarray | None = None
    sigma_x_m: np.ndarray | None = None
    sigma_y_m: np.ndarray | None = None
    sigma_z_m: np.ndarray | None = None

    @property
    def accepted(self) -> np.ndarray:
        """Whether a fix has a position with a known error (R, T)."""
        usable = (self.outcome != Outcome.FAILED) & (self.outcome != Outcome.REJECTED)
        return np.asarray(usable & (self.outcome >= 0) & np.isfinite(self.error_xy_m))


_FOR_SUMS = ("error_3d_m", "error_xy_m", "iterations", "score", "anchors_used", "outcome", "place")


def fixes(out: str | os.PathLike[str], cell: str, estimator: str) -> Fixes:
    """Fixes of one estimator in one cell of the run in `out`; UserError if none are stored."""
    root = Path(out)
    return fixes_of(root, cell, estimator, entry_of(root, cell, estimator))


def fixes_of(out: Path, cell: str, estimator: str, entry: Mapping[str, Any] | None) -> Fixes:
    """The fixes of an estimator from its entry in the record of a cell; UserError if none are
    stored.
    """
    parts = [] if entry is None else intact_parts(out, entry["key"])
    if entry is None or (parts and not any("fixes" in part.files for part in parts)):
        raise UserError(f"{out}: no fixes of {estimator!r} in cell {cell!r} are stored")
    gaps = missing_ranges([(part.start, part.stop) for part in parts], entry["reps"])
    if gaps:
        raise missing(out, entry, gaps[0][0])
    return _OfParts(out, entry, parts)


def _of_parts(name: str) -> Any:
    """An array of `_OfParts`, which is read once."""
    return cached_property(lambda fixes: fixes.column(name))


class _OfParts(Fixes):
    """The fixes of the intact parts of a recorded estimator; each array is read when it is first
    asked for.
    """

    def __init__(self, out: Path, entry: Mapping[str, Any], parts: Sequence[Part]) -> None:
        vars(self).update(column=partial(_column, out, entry, parts))  # the dataclass is frozen

    error_3d_m = _of_parts("error_3d_m")
    error_xy_m = _of_parts("error_xy_m")
    iterations = _of_parts("iterations")
    score = _of_parts("score")
    anchors_used = _of_parts("anchors_used")
    outcome = _of_parts("outcome")
    place = _of_parts("place")
    reason = _of_parts("reason")
    imprecise = _of_parts("imprecise")
    n_unmeasured = _of_parts("n_unmeasured")
    sigma_x_m = _of_parts("sigma_x_m")
    sigma_y_m = _of_parts("sigma_y_m")
    sigma_z_m = _of_parts("sigma_z_m")


def _column(
    out: Path, entry: Mapping[str, Any], parts: Sequence[Part], name: str
) -> np.ndarray | None:
    """One array (R, T) of the fixes in some parts; None if a part lacks it."""
    tables = list(noted_parts(out, entry, "fixes", ["replication", name], parts))
    arrays = [_array(table, name) for table in tables]
    known = [array for array in arrays if array is not None]
    return np.concatenate(known) if len(known) == len(arrays) else None


class Read(Mapping[str, Fixes]):
    """The fixes by estimator, each read by `reader` when it is first asked for."""

    def __init__(self, reader: Callable[[str], Fixes], estimators: Iterable[str]) -> None:
        self._names, self._read = tuple(estimators), cache(reader)

    def __getitem__(self, name: str) -> Fixes:
        if name not in self._names:
            raise KeyError(name)
        return self._read(name)

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)


_OF_STEPS = ("error_3d_m", "error_xy_m", "score", "anchors_used")


def steps(out: str | os.PathLike[str], cell: str, estimator: str) -> Fixes:
    """Errors, outcome, score and anchors_used of one estimator's steps in one cell of a run with
    store.steps=true, whatever the true positions; the other fields are NaN or None.

    Raises UserError if none are stored.
    """
    root = Path(out)
    return steps_of(root, cell, estimator, entry_of(root, cell, estimator))


def steps_of(out: Path, cell: str, estimator: str, entry: Mapping[str, Any] | None) -> Fixes:
    """The fixes of `steps` of an estimator from its entry in the record of a cell; UserError if
    none are stored.
    """
    parts = [] if entry is None else intact_parts(out, entry["key"])
    if entry is None or not any("steps" in part.files for part in parts):
        raise UserError(f"{out}: no steps of {estimator!r} in cell {cell!r}; set store.steps=true")
    columns = ["replication", "outcome", *_OF_STEPS]
    found: dict[str, list[np.ndarray]] = {name: [] for name in ("outcome", *_OF_STEPS)}
    for part in noted_parts(out, entry, "steps", columns, parts):
        count = len(np.unique(part["replication"].to_numpy()))
        texts = part["outcome"].combine_chunks().dictionary_encode()
        code = np.array([Outcome[t.upper()] for t in texts.dictionary.to_pylist()], dtype=np.int8)
        found["outcome"].append(code[texts.indices.to_numpy()].reshape(count, -1))
        for name in _OF_STEPS:
            found[name].append(part[name].to_numpy().reshape(count, -1))
    whole = {name: np.concatenate(arrays) for name, arrays in found.items()}
    return Fixes(**whole, iterations=np.full(whole["outcome"].shape, np.nan))


def _fixes(part: pa.Table) -> Fixes:
    arrays = {f.name: _array(part, f.name) for f in fields(Fixes)}
    return Fixes(**arrays)  # type: ignore[arg-type]


def _array(part: pa.Table, name: str) -> np.ndarray | None:
    """One array (R, T) of the fixes of a part; None if the part was stored without it."""
    if name not in part.column_names or part[name].null_count:
        return None
    values = part[name].combine_chunks().flatten()
    return np.asarray(values.to_numpy(zero_copy_only=False).reshape(len(part), -1))


def clusters(
    out: str | os.PathLike[str],
    cell: str,
    estimator: str,
    replications: Iterable[int] | None = None,
) -> Clusters | None:
    """Return the sums per true position over the `replications` (None: all) of one estimator in one
    cell, read part by part; None if the replications do not share their positions.
    """
    root = Path(out)
    entry = entry_of(root, cell, estimator)
    if entry is None:
        return None
    wanted = None if replications is None else np.fromiter(replications, dtype=np.int64)
    return clusters_of(root, entry, intact_parts(root, entry["key"]), wanted)


def clusters_of(
    out: Path, entry: Mapping[str, Any], parts: Sequence[Part], wanted: np.ndarray | None = None
) -> Clusters | None:
    """The sums of `clusters` from the intact parts of a recorded estimator; `wanted` (N,) are the
    numbers of the replications.
    """
    total: Clusters | None = None
    for one, place in each_part(out, entry, parts, wanted):
        found = position_sums(*_errors(one), one.accepted, place)
        total = found if total is None else total + found
    return total


def facts_of(
    out: Path, entry: Mapping[str, Any], parts: Sequence[Part]
) -> tuple[Clusters | None, Errors | None]:
    """The sums of `clusters` and every error of a recorded estimator from its intact parts, read
    once; None for both if they were stored without fixes.
    """
    total: Clusters | None = None
    found: list[tuple[np.ndarray, ...]] = []
    places: np.ndarray | None = None
    for one, places in each_part(out, entry, parts):
        some = position_sums(*_errors(one), one.accepted, places)
        total = some if total is None else total + some
        z = np.sqrt(np.maximum(one.error_3d_m**2 - one.error_xy_m**2, 0))
        known = (np.where(one.accepted, e, np.nan) for e in (one.error_xy_m, z))
        found.append((*known, one.outcome == Outcome.OK, one.outcome >= 0))
    if total is None:
        return None, None
    xy, z, ok, tried = (np.concatenate(arrays) for arrays in zip(*found))
    return total, Errors(xy, z, ok, places, tried=tried)


def influences_of(
    out: Path, entry: Mapping[str, Any], parts: Sequence[Part], wanted: np.ndarray, metric: str
) -> np.ndarray | None:
    """Influences (N, P) of each position in each of the `wanted` (N,) replications on the mean of a
    clustered `metric` (see clusters.influences); None without fixes.
    """
    found = [
        influences(metric, *_errors(one), one.accepted, place) * len(one.outcome) / len(wanted)
        for one, place in each_part(out, entry, parts, wanted)
    ]
    return np.concatenate(found) if found else None


def _errors(one: Fixes) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return one.error_3d_m, one.error_xy_m, one.iterations


def each_part(
    out: Path, entry: Mapping[str, Any], parts: Sequence[Part], wanted: np.ndarray | None = None
) -> Iterator[tuple[Fixes, np.ndarray]]:
    """The fixes of the intact parts of a recorded estimator, part by part, with the number of the
    position (T,) of each fix; nothing if they were stored without fixes or positions. `wanted` (N,)
    are the numbers of the replications; None: all.
    """
    import pyarrow as pa

    if not any("fixes" in part.files for part in parts):
        return
    for part in noted_parts(out, entry, "fixes", ["replication", *_FOR_SUMS], parts):
        some = part
        if wanted is not None:
            some = part.filter(pa.array(np.isin(part["replication"].to_numpy(), wanted)))
        if len(some):
            one = _fixes(some)
            if one.place is None:
                return
            yield one, one.place[0]
