"""The fixes of recorded tracks by one method, and how far each measured angle is from them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace

import numpy as np

from aoabench.engine.draws import Draws
from aoabench.engine.threads import one_thread
from aoabench.engine.tiles import tile_of, try_tile
from aoabench.estimators.rays import POLE
from aoabench.maths.geometry import Array, wrap
from aoabench.roles import Estimator, Noise, Scenario
from aoabench.types import Batch, Estimates


@dataclass(frozen=True)
class Residuals:
    """Measured less expected angles of N measurements, one of each anchor's packet in a fix.

    fix (N,): the index of the fix; anchor (N,): the anchor's number; azimuth and elevation (N,) rad
    in the anchor's frame, NaN where not measured or not defined.
    """

    fix: np.ndarray
    anchor: np.ndarray
    azimuth: Array
    elevation: Array

    @classmethod
    def joined(cls, each: list[Residuals]) -> Residuals:
        """All of them, one after the other."""
        return cls(*(np.concatenate([getattr(r, f.name) for r in each]) for f in fields(cls)))


@dataclass(frozen=True)
class Solved:
    """F fixes of all tracks, one track after the other: estimates (1, F, ...), residuals, and
    errors, the messages of tracks on which the method failed, by the number of the track.
    """

    estimates: Estimates
    residuals: Residuals
    errors: dict[int, str]


def solve(scenario: Scenario, noise: Noise, method: Estimator, counts: np.ndarray) -> Solved:
    """The fixes of recorded tracks with `counts` (R,) fixes each."""
    with one_thread():
        size = tile_of(method, scenario)
        draws, errors = Draws(scenario, noise, seed=0), dict[int, str]()
        pieces, residuals, begin = list[Estimates](), list[Residuals](), 0
        for first in range(0, len(counts), size):
            _, estimates, failed = try_tile(draws, method, first)
            errors |= failed
            batch = draws.drawn(first, size).whole
            lengths = counts[first : first + size]
            for i, each in enumerate(_tracks(estimates, lengths)):
                one = at_height(each, scenario.known_height_m)
                pieces.append(one)
                residuals.append(residuals_of(batch.of(i), one.position, begin))
                begin += int(lengths[i])
    return Solved(joined(pieces), Residuals.joined(residuals), errors)


def _tracks(estimates: Estimates, lengths: np.ndarray) -> Iterator[Estimates]:
    """The estimates (1, T, ...) of each track of a tile, without its padding."""
    for i, T in enumerate(lengths):
        given = {f.name: getattr(estimates, f.name) for f in fields(Estimates)}
        cut = {n: a if a is None else a[i : i + 1, :T] for n, a in given.items()}
        yield Estimates(**cut)  # type: ignore[arg-type]


def joined(pieces: list[Estimates]) -> Estimates:
    """The estimates (1, F, ...) of tracks one after the other; NaN in place of an optional array
    that some of them lack.
    """
    found: dict[str, np.ndarray | None] = {}
    for name in (f.name for f in fields(Estimates)):
        arrays = [getattr(piece, name) for piece in pieces]
        given = next((a for a in arrays if a is not None), None)
        if given is not None and len(pieces) > 1:
            shapes = [(*piece.outcome.shape, *given.shape[2:]) for piece in pieces]
            filled = [np.full(s, np.nan) if a is None else a for a, s in zip(arrays, shapes)]
            given = np.concatenate(filled, axis=1)
        found[name] = given
    return Estimates(**found)  # type: ignore[arg-type]


def at_height(estimates: Estimates, height_m: float | None) -> Estimates:
    """The estimates with the known height as z where a method in the plane gives none."""
    position = estimates.position
    flat = np.isfinite(position[..., 0]) & np.isnan(position[..., 2])
    if height_m is None or not flat.any():
        return estimates
    z = np.where(flat, height_m, position[..., 2])
    return replace(estimates, position=np.concatenate([position[..., :2], z[..., None]], axis=-1))


def residuals_of(batch: Batch, position: Array, begin: int = 0) -> Residuals:
    """Residuals of the fixes at `position` (1, T, 3) m of one track, whose first fix has the index
    `begin`. Where z is NaN, azimuths are those at the anchor's height; a measured elevation of
    +-90 deg leaves none.
    """
    T = position.shape[1]
    seen = np.isfinite(batch.azimuth[0, :T]) & np.isfinite(position[0, :, :1])
    t, b = np.nonzero(seen)

    def at(array: np.ndarray) -> np.ndarray:
        return np.asarray(array[0, t if array.shape[1] > 1 else 0, b])

    d = position[0, t] - at(batch.anchors.position)
    flat = np.isnan(d[:, 2])
    d[flat, 2] = 0.0
    u, v, w = np.einsum("nij,nj->in", at(batch.anchors.rotation), d)
    azimuth = wrap(batch.azimuth[0, t, b] - np.arctan2(v, u))
    measured = batch.elevation[0, t, b]
    azimuth[np.abs(np.abs(measured) - np.pi / 2) < POLE] = np.nan
    elevation = measured - np.arctan2(w, np.hypot(u, v))
    return Residuals(begin + t, at(batch.numbers), azimuth, np.where(flat, np.nan, elevation))
