"""The point nearest to all measured lines, in the least-squares sense, with and without discarding
anchors.

A line through the anchor s along the unit vector u is at the distance |(I - u u^T)(p - s)| from p,
so that

    p = (sum_i (I - u_i u_i^T))^-1 sum_i (I - u_i u_i^T) s_i      [Boquet 2024, 2.2.2, M_LS]

An azimuth alone is a plane with normal n = (-sin phi, cos phi, 0) in the anchor's frame, and n n^T
replaces I - u u^T. With vertical planes alone the problem is that of bearing lines in two
dimensions.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aoabench.estimators.parameters import clip_param
from aoabench.estimators.plane import clipped, directions
from aoabench.maths.geometry import Array
from aoabench.maths.linalg import solve
from aoabench.params import param
from aoabench.roles import Estimator, Scenario
from aoabench.streams import Streams
from aoabench.types import Batch, Estimates, Outcome


def projectors(batch: Batch) -> tuple[Array, np.ndarray]:
    """Projectors (R, T, B, 3, 3): I - u u^T, n n^T for an azimuth alone, or 0; and the mask
    (R, T, B) of the measured azimuths.
    """
    u = directions(batch)
    whole: np.ndarray = np.asarray(np.isfinite(u).all(axis=-1))
    phi = np.where(np.isfinite(batch.azimuth), batch.azimuth, 0.0)
    n = np.stack([-np.sin(phi), np.cos(phi), np.zeros_like(phi)], axis=-1)
    n = (n[..., None, :] @ batch.anchors.rotation)[..., 0, :]
    u = np.where(whole[..., None], u, 0.0)
    line, plane = np.eye(3) - u[..., :, None] * u[..., None, :], n[..., :, None] * n[..., None, :]
    measured = np.isfinite(batch.azimuth)
    return np.where(
        measured[..., None, None], np.where(whole[..., None, None], line, plane), 0.0
    ), measured


def nearest_point(P: Array, s: Array) -> Array:
    """The point (R, T, 3) m nearest to lines or planes with projectors P (R, T, B, 3, 3) through s
    (R|1, T|1, B, 3) m.

    NaN if the lines and planes do not determine a point; z alone is NaN if only z is undetermined.
    """
    A, g = P.sum(axis=2), (P @ s[..., None])[..., 0].sum(axis=2)
    level = A[..., 2, 2] <= 1e-12 * (A[..., 0, 0] + A[..., 1, 1])
    A[..., 2, 2] += level
    p = solve(A, g)
    p[..., 2] = np.where(level, np.nan, p[..., 2])
    return p


def distances(P: Array, s: Array, p: Array) -> Array:
    """Distances (R, T, B) m of points (R, T, 3) m from the lines or planes."""
    d = np.where(np.isnan(p), 0.0, p)[:, :, None] - s
    return np.sqrt((((P @ d[..., None])[..., 0]) ** 2).sum(axis=-1))


@dataclass(frozen=True)
class LineLeastSquares(Estimator):
    """The nearest point to all lines.

    The score is the root mean square distance in m from the lines.
    """

    clip: bool = clip_param()
    tile = 8

    @property
    def needs(self) -> frozenset[str]:
        return frozenset({"several_anchors"})

    def __call__(self, batch: Batch, scenario: Scenario, streams: Streams) -> Estimates:
        """One position per fix; outcome FAILED if fewer than two anchors measured or all lines are
        parallel.
        """
        P, measured = projectors(batch)
        p = nearest_point(P, batch.anchors.position)
        return _estimates(p, distances(P, batch.anchors.position, p), measured, scenario, self.clip)


@dataclass(frozen=True)
class AnchorDiscarding(Estimator):
    """Least squares that discards, one by one, the anchor whose line is furthest from the point.

    It stops when the root mean square distance is at most `threshold_m` or two anchors are left.
    The paper names this method M_IAD without equations; this class is a reconstruction.
    """

    threshold_m: float = param(
        0.3, "root mean square distance up to which no anchor is discarded", unit="m", least=0
    )
    clip: bool = clip_param()
    tile = 8

    @property
    def needs(self) -> frozenset[str]:
        return frozenset({"several_anchors"})

    def __call__(self, batch: Batch, scenario: Scenario, streams: Streams) -> Estimates:
        P, used = projectors(batch)
        s = batch.anchors.position
        p = nearest_point(P, s)
        for _ in range(used.shape[-1] - 2):
            d = np.where(used, distances(P, s, p), 0.0)
            n = used.sum(axis=-1)
            bad = (n > 2) & ((d**2).sum(axis=-1) > n * self.threshold_m**2)
            if not bad.any():
                break
            worst = np.arange(used.shape[-1]) == d.argmax(axis=-1)[..., None]
            used &= ~(worst & bad[..., None])
            P = np.where(used[..., None, None], P, 0.0)
            p = np.where(bad[..., None], nearest_point(P, s), p)
        return _estimates(p, distances(P, s, p), used, scenario, self.clip)


def _estimates(p: Array, d: Array, used: np.ndarray, scenario: Scenario, clip: bool) -> Estimates:
    found = np.isfinite(p[..., :2]).all(axis=-1)
    n = used.sum(axis=-1)
    with np.errstate(invalid="ignore", divide="ignore"):
        score = np.where(
            found & (n > 1), np.sqrt(np.where(used, d**2, 0.0).sum(axis=-1) / n), np.nan
        )
    position = np.concatenate([clipped(p[..., :2], scenario, clip), p[..., 2:]], axis=-1)
    return Estimates(
        position,
        None,
        None,
        np.where(found, Outcome.OK, Outcome.FAILED).astype(np.int8),
        score,
        n.astype(float),
    )
