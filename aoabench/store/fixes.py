"""Every fix of replications: as stored where they share their true positions, else from steps."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from aoabench.errors import UserError
from aoabench.store.accuracy import Errors
from aoabench.store.clusters import Clusters, influences, position_sums
from aoabench.store.folder import noted_parts
from aoabench.store.index import entry_of
from aoabench.store.parts import Part, intact_parts
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

    def first(self, count: int) -> Fixes:
        """The fixes of the first `count` replications."""
        arrays = {f.name: getattr(self, f.name) for f in fields(Fixes)}
        cut = {n: None if a is None else a[:count] for n, a in arrays.items()}
        return Fixes(**cut)  # type: ignore[arg-type]

    @property
    def accepted(self) -> np.ndarray:
        """Whether a fix has a position with a known error (R, T)."""
        usable = (self.outcome != Outcome.FAILED) & (self.outcome != Outcome.REJECTED)
        return np.asarray(usable & (self.outcome >= 0) & np.isfinite(self.error_xy_m))


_FOR_SUMS = ("error_3d_m", "error_xy_m", "iterations", "score", "anchors_used", "outcome", "place")


def fixes(out: str | os.PathLike[str], cell: str, estimator: str) -> Fixes:
    """Fixes of one estimator in one cell of the run in `out`; UserError if none are stored."""
    root = Path(out)
    entry = entry_of(root, cell, estimator)
    parts = [] if entry is None else intact_parts(root, entry["key"])
    found: list[Fixes] = []
    if entry is not None and (not parts or any("fixes" in part.files for part in parts)):
        found = [_fixes(part) for part in noted_parts(root, entry, "fixes", parts=parts)]
    if not found:
        raise UserError(f"{out}: no fixes of {estimator!r} in cell {cell!r} are stored")
    each = {f.name: [getattr(one, f.name) for one in found] for f in fields(Fixes)}
    return Fixes(
        **{n: None if any(a is None for a in v) else np.concatenate(v) for n, v in each.items()}  # type: ignore[arg-type]
    )


class Read(Mapping[str, Fixes]):
    """The fixes of the first `count` replications by estimator, read when they are first asked for
    by `reader` (`fixes` or `steps`) from one cell of the run in `out`.
    """

    def __init__(
        self,
        reader: Callable[[Path, str, str], Fixes],
        out: Path,
        cell: str,
        estimators: Iterable[str],
        count: int,
    ) -> None:
        self._names = tuple(estimators)
        self._read = cache(lambda name: reader(out, cell, name).first(count))

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
    entry = entry_of(root, cell, estimator)
    parts = [] if entry is None else intact_parts(root, entry["key"])
    if entry is None or not any("steps" in part.files for part in parts):
        raise UserError(f"{out}: no steps of {estimator!r} in cell {cell!r}; set store.steps=true")
    columns = ["replication", "outcome", *_OF_STEPS]
    found: dict[str, list[np.ndarray]] = {name: [] for name in ("outcome", *_OF_STEPS)}
    for part in noted_parts(root, entry, "steps", columns, parts):
        count = len(set(part["replication"].to_pylist()))
        codes = [Outcome[text.upper()] for text in part["outcome"].to_pylist()]
        found["outcome"].append(np.array(codes, dtype=np.int8).reshape(count, -1))
        for name in _OF_STEPS:
            found[name].append(part[name].to_numpy().reshape(count, -1))
    whole = {name: np.concatenate(arrays) for name, arrays in found.items()}
    return Fixes(**whole, iterations=np.full(whole["outcome"].shape, np.nan))


def _fixes(part: pa.Table) -> Fixes:
    arrays = {}
    for f in fields(Fixes):
        if f.name in part.column_names and part[f.name].null_count == 0:
            column = part[f.name].combine_chunks()
            arrays[f.name] = column.flatten().to_numpy(zero_copy_only=False).reshape(len(part), -1)
    return Fixes(**arrays)


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
