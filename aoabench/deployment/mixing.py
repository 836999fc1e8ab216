"""Packets of several pieces of a stream as one."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from aoabench.devices.readers.table import Table
from aoabench.devices.tracks.packets import Packets
from aoabench.maths.geometry import Array


def joined(a: Packets, b: Packets) -> Packets:
    """The packets of `a`, then those of `b`, of one stream, both `without_rows`."""
    n, m = a.count, b.count
    tags, ours, theirs = _merged(a.tags, b.tags)
    fixes, our_fixes, their_fixes = _merged(a.fixes, b.fixes)
    values = {}
    for name in dict.fromkeys((*a.values, *b.values)):
        pair = a.values.get(name, np.full(n, np.nan)), b.values.get(name, np.full(m, np.nan))
        values[name] = np.concatenate(pair)
    fix = None
    if a.fix is not None and b.fix is not None:
        fix = np.concatenate([our_fixes[a.fix], their_fixes[b.fix]])
    return replace(
        b,
        anchor=np.concatenate([a.anchor, b.anchor]),
        values=values,
        tag=np.concatenate([ours[a.tag], theirs[b.tag]]),
        tags=tags,
        fix=fix,
        fixes=fixes,
        time=_both(a.time, b.time),
        sequence=_both(a.sequence, b.sequence),
        truth=np.concatenate([a.truth, b.truth]),
    )


@dataclass(frozen=True)
class Gone(Table):
    """A log's name and remarks, without its rows."""

    def where(self, keep: np.ndarray) -> Table:
        return self


def without_rows(packets: Packets) -> Packets:
    """The packets without the rows of the log, which only messages need."""
    table = packets.table
    return replace(packets, table=Gone(table.key, table.path, {}, None, table.parts))  # type: ignore[arg-type]


def without_unused_names(packets: Packets) -> Packets:
    """The packets with the tags and fixes alone that they have."""
    used, tag = np.unique(packets.tag, return_inverse=True)
    found = replace(packets, tag=tag.ravel(), tags=tuple(packets.tags[i] for i in used))
    if packets.fix is None:
        return found
    used, fix = np.unique(packets.fix, return_inverse=True)
    return replace(found, fix=fix.ravel(), fixes=tuple(packets.fixes[i] for i in used))


def _merged(
    a: tuple[str, ...], b: tuple[str, ...]
) -> tuple[tuple[str, ...], np.ndarray, np.ndarray]:
    """All names once, and the places in them of each of `a` and of `b`."""
    names = tuple(dict.fromkeys((*a, *b)))
    place = {name: i for i, name in enumerate(names)}
    ours, theirs = (np.array([place[name] for name in each], dtype=int) for each in (a, b))
    return names, ours, theirs


def _both(a: Array | None, b: Array | None) -> Array | None:
    return None if a is None or b is None else np.concatenate([a, b])
