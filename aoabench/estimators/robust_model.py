"""The model of the robust likelihood in NumPy: the fixes, their lines, the cost and its equations.

N fixes at once; B anchors, of which each fix uses those with a weight. Positions are relative to
the centre of the anchors used.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from aoabench.estimators.losses import Loss
from aoabench.estimators.places import distinct_places
from aoabench.kernels.robust_limits import FLAT, STEEP, TINY
from aoabench.maths.geometry import Array, to_unit, wrap
from aoabench.maths.linalg import solve


class Fixes(NamedTuple):
    """Angles (N, B) rad and ranges r (N, B) m of N fixes, and 1 / variance, all 0 where not
    measured; anchors s (N, B, 3) m from the centre of those used, rotations R (N, B, 3, 3);
    z (N,) m: the height of the fixes, if it is known or does not matter (flat); measured rays ahead
    (N, B, 3); slot (N, B): the place of the anchor among those of the fix, -1 where not measured;
    redundancy (N,): the number of angles and ranges less that of unknowns; different (N,): the same
    with several of a kind by one anchor counted once.
    """

    phi: Array
    theta: Array
    wa: Array
    we: Array
    r: Array
    wr: Array
    s: Array
    R: Array
    flat: np.ndarray
    z: Array
    ahead: Array
    slot: np.ndarray
    redundancy: np.ndarray
    different: np.ndarray

    def those(self, index: np.ndarray) -> Fixes:
        """The fixes with these indices."""
        return Fixes(*(a[index] for a in self))


class Lines(NamedTuple):
    """Projectors A (N, B, 3, 3) across the measured lines and planes, and g = A s (N, B, 3)."""

    A: Array
    g: Array

    def nearest(self, weight: Array, f: Fixes) -> Array:
        """The points (N, 3) m nearest to the lines of a mask (N, B), NaN if not determined."""
        A = (weight[..., None, None] * self.A).sum(axis=1)
        g = (weight[..., None] * self.g).sum(axis=1)
        g[:, :2] -= np.where(f.flat[:, None], A[:, :2, 2] * f.z[:, None], 0.0)
        flattened(A, g, f.flat)
        p = solve(A, g)
        p[:, 2] = np.where(f.flat, f.z, p[:, 2])
        return p


def flattened(A: Array, g: Array, flat: np.ndarray) -> None:
    """Leave z out of the equations A (N, 3, 3), g (N, 3) of the fixes that are `flat` (N,)."""
    A[flat, 2, :2] = A[flat, :2, 2] = g[flat, 2] = 0.0
    A[flat, 2, 2] = A[flat, 0, 0] + A[flat, 1, 1]


def prepared(
    measured: tuple[Array, ...], s: Array, R: Array, height: float, numbers: Array | None = None
) -> tuple[Fixes, Lines, Array]:
    """Fixes, their lines and the centres (N, 3) m of the anchors used, from angles and weights
    (N, B), with ranges and their weights (N, B) if there are any, and anchors (N, B, ...);
    `height` is NaN where the target's is not known; numbers (N, B) tell anchors apart, None: each
    stands for itself.
    """
    phi, theta, wa, we, *ranges = measured
    r, wr = ranges or (np.zeros_like(wa), np.zeros_like(wa))
    used, line = wa > 0, we > 0
    n = np.maximum(used.sum(axis=1), 1)[:, None]
    centre = np.where(used[..., None], s, 0.0).sum(axis=1) / n
    s = np.where(used[..., None], s - centre[:, None], 0.0)
    u = _turned(to_unit(phi, theta), R)
    v = _turned(np.stack([-np.sin(phi), np.cos(phi), np.zeros_like(phi)], axis=-1), R)
    along = np.where(line[..., None], u, v)
    A = (1.0 * used - 2.0 * line)[..., None, None] * (along[..., :, None] * along[..., None, :])
    A += line[..., None, None] * np.eye(3)
    up, across = (v[..., 2] ** 2 * used).sum(axis=1), ((v[..., :2] ** 2).sum(-1) * used).sum(axis=1)
    level = ~line.any(axis=1) & (up <= FLAT * across)
    known = bool(np.isfinite(height))
    flat = level | known
    z = np.where(flat & known, height - centre[:, 2], 0.0)
    g = (A @ s[..., None])[..., 0]
    slot, unknowns = slots(used, numbers), np.where(flat, 2, 3)
    redundancy = (1 * used + line + (wr > 0)).sum(axis=1) - unknowns
    different = sum(distinct_places(kind, slot) for kind in (used, line, wr > 0)) - unknowns
    f = Fixes(phi, theta, wa, we, r, wr, s, R, flat, z, u, slot, redundancy, different)
    return f, Lines(A, g), centre


def slots(used: np.ndarray, numbers: Array | None) -> np.ndarray:
    """The places (N, B) of the anchors used among those of their fix, in the order of their first
    measurements, by their numbers (N, B); -1 where not used.
    """
    if numbers is None:
        return np.where(used, used.cumsum(axis=1) - 1, -1)
    same = (numbers[:, :, None] == numbers[:, None, :]) & used[:, None, :]
    first = same.argmax(axis=2)
    place = (used & (first == np.arange(used.shape[1]))).cumsum(axis=1) - 1
    return np.where(used, np.take_along_axis(place, first, axis=1), -1)


def _turned(u: Array, R: Array) -> Array:
    return np.asarray((u[..., None, :] @ R)[..., 0, :])


class State(NamedTuple):
    """Cost (N,) at a position, normal equations A (N, 3, 3) and g (N, 3), weights (N, B) of both
    angles, sum (N,) of the weighted squared deviations, the largest one (N,), and the distance (N,)
    m from the nearest pole.
    """

    cost: Array
    A: Array
    g: Array
    by_azimuth: Array
    by_elevation: Array
    squares: Array
    largest: Array
    pole: Array


def state(f: Fixes, p: Array, loss: Loss, m: Array | float = STEEP, capped: bool = False) -> State:
    """The likelihood and the Gauss-Newton equations of positions p (N, 3) m, with the weights of
    the loss. Equations for a covariance are `capped`: near an anchor's pole, its azimuth counts as
    at one deviation of the elevation from it.
    """
    m = np.asarray(m)[..., None] if np.ndim(m) else m
    u, v, w = np.moveaxis((f.R @ (p[:, None] - f.s)[..., None])[..., 0], -1, 0)
    rho2 = np.maximum(u * u + v * v, TINY)
    rho, r2 = np.sqrt(rho2), rho2 + w * w
    da, de = wrap(f.phi - np.arctan2(v, u)), f.theta - np.arctan2(w, rho)
    sa, se = f.wa * da * da, f.we * de * de
    wa, we = loss.weight(sa, m), loss.weight(se, m)
    ga = np.stack([-v, u, np.zeros_like(u)], axis=-1) / rho2[..., None]
    ge = np.stack([-u * w / rho, -v * w / rho, rho], axis=-1) / r2[..., None]
    ga, ge = _turned(ga, f.R), _turned(ge, f.R)
    dr = f.r - np.sqrt(r2)
    sr = f.wr * dr * dr
    wr = loss.weight(sr, m)
    gr = _turned(np.stack([u, v, w], axis=-1) / np.sqrt(r2)[..., None], f.R)
    ca, ce, cr = f.wa * wa, f.we * we, f.wr * wr
    if capped:
        ca = np.where(f.we > 0, ca * np.minimum(1.0, rho2 * f.we / r2), ca)
    each = (ca, da, ga), (ce, de, ge), (cr, dr, gr)
    A = sum(np.einsum("nb,nbi,nbj->nij", c, x, x) for c, _, x in each)
    g = sum(np.einsum("nb,nbi->ni", c * y, x) for c, y, x in each)
    flattened(A, g, f.flat)
    cost = 0.5 * (loss.of(sa, m) + loss.of(se, m) + loss.of(sr, m)).sum(axis=1)
    squares = (wa * sa + we * se + wr * sr).sum(axis=1)
    pole = np.where(f.wa > 0, rho, np.inf).min(axis=1, initial=np.inf)
    largest = np.maximum(np.maximum(sa, se), sr).max(axis=1, initial=0.0)
    return State(cost, A, g, wa, we, squares, largest, pole)
