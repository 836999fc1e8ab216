"""Levenberg-Marquardt steps of `vmf_likelihood.py` in NumPy, all fixes at a time."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from aoabench.estimators.rays import FAR, behind
from aoabench.maths.geometry import Array
from aoabench.maths.linalg import EPS, solve
from aoabench.types import Outcome, Reason

TIE = 1.0 - 1e-12  # a cost above this share of another one equals it but for rounding


class Minimum(NamedTuple):
    """Result of the iterations: position (N, 3) m, outcome, updates, cost and reason (N,)."""

    position: Array
    outcome: np.ndarray
    updates: Array
    cost: Array
    reason: np.ndarray


def minimise(
    p: Array, d: Array, w: Array, s: Array, far: Array, free: bool, options: tuple[float, int]
) -> Minimum:
    """Minima from starts p (N, 3) m, directions d, weights w and anchors s (N, B, ...); z is
    fixed unless `free`.

    options: the step in m that ends the iteration, and the largest number of steps.
    `far` (N,) m is the distance from the anchors' centre beyond which a fix is DIVERGED. A
    minimum behind an anchor may be a saddle or a maximum of the likelihood; the iteration is
    then repeated from the best point on the rays, and the smaller cost counts.
    """
    found = _descend(p, d, w, s, far, free, options)
    back = behind(d[:, None], s[:, None], found.position[:, None])[:, 0]
    again = np.flatnonzero(back & (found.outcome != Outcome.FAILED))
    if len(again):
        part = d[again], w[again], s[again]
        start = _in_front(found.position[again], *part, far[again] / FAR, free)
        second = _descend(start, *part, far[again], free, options)
        better = second.cost < found.cost[again]
        for kept, new in zip(found, second):
            kept[again[better]] = new[better]
    return found


def _descend(
    p: Array, d: Array, w: Array, s: Array, far: Array, free: bool, options: tuple[float, int]
) -> Minimum:
    """Levenberg-Marquardt steps from starts p (N, 3) m."""
    tolerance, updates = options
    p, damping, count = p.copy(), np.full(len(p), 1e-3), np.zeros(len(p))
    started: np.ndarray = np.asarray(np.isfinite(p).all(axis=-1))
    outcome = np.where(started, Outcome.OSCILLATED, Outcome.FAILED).astype(np.int8)
    reason = np.where(started, Reason.NO_CONVERGENCE, Reason.UNDETERMINED).astype(np.int8)
    cost = np.where(outcome == Outcome.FAILED, np.nan, _expected(p, d, w, s)[2])
    centre = s.mean(axis=1)
    left = np.flatnonzero(started)
    for _ in range(updates):
        if not len(left):
            break
        A, g = _normal_equations(p[left], d[left], w[left], s[left], free)
        damped = A.copy()
        damped[:, range(3), range(3)] *= 1.0 + damping[left, None]
        step = solve(damped, g)
        tried = p[left] + step
        new = _expected(tried, d[left], w[left], s[left])[2]
        count[left] += 1
        with np.errstate(invalid="ignore"):
            better = new <= cost[left]
            length = np.linalg.norm(step, axis=-1)
            lost = ~(np.linalg.norm(tried - centre[left], axis=-1) <= far[left])
        p[left[better]], cost[left[better]] = tried[better], new[better]
        damping[left] = np.clip(damping[left] * np.where(better, 0.1, 10.0), 1e-12, 1e12)
        singular = np.isnan(length)
        outcome[left[lost]], reason[left[lost]] = Outcome.DIVERGED, Reason.TOO_FAR
        reason[left[singular]] = Reason.NO_DESCENT
        converged = ~lost & (length < tolerance)
        near = np.flatnonzero(converged)  # damping alone makes a step short, too
        full = solve(A[near], g[near])
        gain = (full * g[near]).sum(axis=-1)
        rounding = 16 * EPS * np.sqrt(2 * cost[left[near]] * w[left[near]].sum(axis=-1))
        short = np.linalg.norm(full, axis=-1) < tolerance
        converged[near] = short | (gain <= rounding)
        outcome[left[converged]], reason[left[converged]] = Outcome.OK, Reason.NONE
        left = left[~lost & ~converged]
    return Minimum(p, outcome, count, cost, reason)


def _normal_equations(p: Array, d: Array, w: Array, s: Array, free: bool) -> tuple[Array, Array]:
    """A (N, 3, 3) and g (N, 3) of a Gauss-Newton step from p (N, 3) m; z is fixed unless `free`."""
    u, r, _ = _expected(p, d, w, s)
    J, e = w / r, d - u  # (I - u u^T) d = (I - u u^T) e, with less rounding error
    g = (J[..., None] * (e - u * (u * e).sum(axis=-1)[..., None])).sum(axis=1)
    J = (J / r)[..., None, None]
    A = (J * (np.eye(3) - u[..., :, None] * u[..., None, :])).sum(axis=1)
    if not free:
        A[:, 2, :2] = A[:, :2, 2] = g[:, 2] = 0.0
        A[:, 2, 2] = A[:, 0, 0] + A[:, 1, 1]
    return A, g


def _in_front(p: Array, d: Array, w: Array, s: Array, length: Array, free: bool) -> Array:
    """The points (N, 3) m of least cost among points on the rays, at multiples of `length` (N,) m
    from the anchors, and p (N, 3) m itself; of points with equal cost the first one.
    """
    best, least = p.copy(), _expected(p, d, w, s)[2]
    for multiple in (0.25, 1.0, 4.0):
        for j in range(d.shape[1]):
            tried = s[:, j] + multiple * length[:, None] * d[:, j]
            if not free:
                tried[:, 2] = p[:, 2]
            cost = np.where(w[:, j] > 0, _expected(tried, d, w, s)[2], np.inf)
            less = cost < TIE * least
            best[less], least[less] = tried[less], cost[less]
    return best


def _expected(p: Array, d: Array, w: Array, s: Array) -> tuple[Array, Array, Array]:
    """Directions u (N, B, 3) and distances r (N, B) m of points (N, 3) from the anchors, and the
    cost (N,).
    """
    u = p[:, None] - s
    r = np.maximum(np.sqrt((u**2).sum(axis=-1)), 1e-9)
    u = u / r[..., None]
    return u, r, 0.5 * (w * ((d - u) ** 2).sum(axis=-1)).sum(axis=-1)
