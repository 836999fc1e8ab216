"""Recorded tracks as replications: each track is a tile of its own, with as many steps as fixes.

So the results of a track depend on no other track of the recording, bit for bit.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace

import numpy as np

from aoabench.types import Anchors, Measurements, Tracks

_MOST_PLACES = 2**21  # tracks times fixes of which fixes are stored at their places


@dataclass(frozen=True)
class Identity:
    """A track's tag, None without a name; the names fix (T,) of its fixes; and `fixes`, their
    places among the `total` fixes of the recording.
    """

    tag: str | None
    fix: np.ndarray
    fixes: slice
    total: int

    @classmethod
    def of(cls, tracks: Tracks, track: int) -> Identity:
        """The identity of one track."""
        some = fixes_of(tracks, track)
        return cls(tracks.tags[track] or None, tracks.fix[some], some, len(tracks.time))

    def spread(self, array: np.ndarray, absent: float) -> np.ndarray:
        """An array (1, F) over all fixes of the recording from one (1, T) of the track; `absent` in
        place of the other tracks' fixes.
        """
        found = np.full((1, self.total), absent, dtype=array.dtype)
        found[:, self.fixes] = array
        return found


def has_places(tracks: Tracks) -> bool:
    """Whether each fix is stored with the place of its true position, over all tracks; not in very
    long recordings of several tracks.
    """
    count = len(tracks.counts)
    return count == 1 or count * len(tracks.time) <= _MOST_PLACES


def random_number(tracks: Tracks, track: int) -> int:
    """The number below 2^32 that stands for a track in the keys of the random streams.

    It follows from the tag's name and the track's place among those of the tag, so that a track has
    the same draws whichever other tags the log holds; 0, 1, ... in a log without tags.
    """
    tag = tracks.tags[track]
    place = tracks.tags[:track].count(tag)
    digest = hashlib.blake2b(tag.encode("utf-8", "surrogatepass"), digest_size=4).digest()
    return (place + (int.from_bytes(digest, "little") if tag else 0)) % 2**32


def fixes_of(tracks: Tracks, track: int) -> slice:
    """The places of a track's fixes in the arrays of `tracks`."""
    starts = tracks.starts
    return slice(int(starts[track]), int(starts[track + 1]))


def columns_of(tracks: Tracks, track: int) -> np.ndarray:
    """The columns (C,) of the track's measurements: the first one of each anchor, and those further
    ones in which the track has a measurement.
    """
    _, first = np.unique(tracks.columns, return_index=True)
    if len(first) == len(tracks.columns):
        return np.arange(len(tracks.columns))
    some, used = fixes_of(tracks, track), np.isin(np.arange(len(tracks.columns)), first)
    for array in tracks.measured.arrays.values():
        used |= np.isfinite(array[some]).any(axis=0)
    return np.flatnonzero(used)


def measured_by(tracks: Tracks, track: int, columns: np.ndarray) -> Measurements:
    """The measurements (1, T, C) of one track in some of the columns."""
    some, whole = fixes_of(tracks, track), len(columns) == len(tracks.columns)
    arrays = {
        name: (array[some] if whole else array[some][:, columns])[None]
        for name, array in tracks.measured.arrays.items()
    }
    return replace(tracks.measured, **arrays)


def anchors_of(known: Anchors, tracks: Tracks, track: int, columns: np.ndarray) -> Anchors:
    """The anchors (1, T|1, C, ...) behind some of the columns of one track: by the recorded poses,
    or else of the `known` B anchors, at all fixes of the recording if they move.
    """
    fixes = np.arange(*fixes_of(tracks, track).indices(len(tracks.time)))
    if tracks.poses is not None:
        return tracks.poses.at(fixes).those(columns)
    anchor, those = tracks.columns[columns], known.at(fixes)
    return those if np.array_equal(anchor, np.arange(known.count)) else those.those(anchor)
