"""Ellipses and boxes in the plane: common points, crossings, areas.

The functions are the plain and slow reference: one pair or one set at a time.

An ellipse is E = {m + L x : |x| <= 1}, centre m (2,) and L (2, 2), so that Sigma = L L^T and

    E = {p : (p - m)^T Sigma^-1 (p - m) <= 1}                          [Boquet 2024, 5.3]
"""

from __future__ import annotations

import math

import numpy as np

from aoabench.maths.geometry import Array

TOUCH = 1e-9  # tolerance for rounding of a level of 1: sets that touch have a common point
GRID = np.linspace(-np.pi, np.pi, 17)


def levels(points: Array, m: Array, L: Array) -> Array:
    """(p - m)^T Sigma^-1 (p - m), (K, B), of points (K, 2) in ellipses m (B, 2), L (B, 2, 2)."""
    x = np.linalg.solve(L, (points[:, None] - m)[..., None])[..., 0]
    return (x**2).sum(-1)


def boundary(t: Array, m: Array, L: Array) -> Array:
    """The points m + L (cos t, sin t), (K, 2), at angles (K,)."""
    return m + np.stack([np.cos(t), np.sin(t)], axis=-1) @ L.T


def crossings(m: Array, L: Array, m2: Array, L2: Array) -> Array:
    """Points (K, 2), K <= 4, where the boundaries of two ellipses cross, or the one point where
    they touch from outside.

    Along the first ellipse, the level of the second is a trigonometric polynomial of degree 2 in t.
    Its derivative is, except for a factor, a self-reciprocal quartic in exp(i t), whose roots on
    the unit circle are the extrema. Between neighbouring extrema the level is monotone, and a
    change of sign brackets one crossing. Roots off the circle and the grid only add brackets. The
    result is empty if one ellipse touches the other from inside, and if both are equal.
    """
    u0, U = np.linalg.solve(L2, m - m2), np.linalg.solve(L2, L)
    (ux, uy), ((uxc, uxs), (uyc, uys)) = u0.tolist(), U.tolist()

    def excess(t: float) -> float:  # the level minus 1
        c, s = math.cos(t), math.sin(t)
        return (ux + uxc * c + uxs * s) ** 2 + (uy + uyc * c + uys * s) ** 2 - 1.0

    M, b = U.T @ U, U.T @ u0
    c1, c2 = (
        b[0] - 1j * b[1],
        (M[0, 0] - M[1, 1]) / 4 - 1j * M[0, 1] / 2,
    )  # of exp(i t) and exp(2 i t)
    extrema = np.angle(np.roots([2 * c2, c1, 0, -np.conj(c1), -2 * np.conj(c2)]))
    t = sorted([*GRID.tolist(), *extrema.tolist()])
    g = [excess(x) for x in t]
    if max(map(abs, g)) <= TOUCH:
        return np.empty((0, 2))
    found = []
    for low, high, before, after in zip(t, t[1:], g, g[1:]):
        if (before > 0) != (after > 0):
            for _ in range(60):
                middle = (low + high) / 2
                if (excess(middle) > 0) == (before > 0):
                    low = middle
                else:
                    high = middle
            found.append((low + high) / 2)
    if not found and 0 < min(g) <= TOUCH:
        found = [t[g.index(min(g))]]
    return boundary(np.array(found), m, L)


def all_crossings(m: Array, L: Array) -> dict[tuple[int, int], Array]:
    """Crossings (K, 2) of each pair of ellipses m (B, 2), L (B, 2, 2), by the pair's indices."""
    B = range(len(m))
    return {(i, j): crossings(m[i], L[i], m[j], L[j]) for i in B for j in B if i < j}


def same(m: Array, L: Array, m2: Array, L2: Array) -> bool:
    """Whether two ellipses are equal except for rounding."""
    return bool(np.all(np.abs(levels(boundary(GRID, m, L), m2[None], L2[None]) - 1.0) <= TOUCH))


def areas(m: Array, L: Array) -> tuple[float, float]:
    """Areas of the intersection and of the union of ellipses m (B, 2), L (B, 2, 2), by Green's
    theorem.

    The boundary of the intersection consists of the arcs between crossings that are inside all
    other ellipses; the boundary of the union, with its holes, of those outside all others. The
    integral (x dy - y dx) / 2 over an arc from t1 to t2 is (det L (t2 - t1) + m x (p2 - p1)) / 2.
    Equal ellipses are counted once.
    """
    keep = [i for i in range(len(m)) if not any(same(m[i], L[i], m[j], L[j]) for j in range(i))]
    m, L = m[keep] - m[keep].mean(axis=0), L[keep]
    points = all_crossings(m, L)
    common = union = 0.0
    for i in range(len(m)):
        others = [j for j in range(len(m)) if j != i]
        on = np.concatenate([np.empty((0, 2)), *(p for pair, p in points.items() if i in pair)])
        x = np.linalg.solve(L[i], (on - m[i]).T)
        t = np.sort(np.arctan2(x[1], x[0]))
        t = np.append(t, t[0] + 2 * np.pi) if len(t) else np.array([-np.pi, np.pi])
        p = boundary(t, m[i], L[i])
        middle = levels(boundary((t[1:] + t[:-1]) / 2, m[i], L[i]), m[others], L[others])
        turned = m[i, 0] * np.diff(p[:, 1]) - m[i, 1] * np.diff(p[:, 0])
        arcs = (np.linalg.det(L[i]) * np.diff(t) + turned) / 2
        common += arcs[(middle < 1).all(axis=1)].sum()
        union += arcs[(middle > 1).all(axis=1)].sum()
    return float(common), float(union)


def half_widths(L: Array) -> Array:
    """Half sides (..., 2) of the bounding boxes of ellipses L (..., 2, 2): the roots of Sigma's
    diagonal.
    """
    return np.sqrt((L**2).sum(-1))


def box_areas(lower: Array, upper: Array) -> tuple[float, float]:
    """Areas of the intersection and of the union of boxes with corners (B, 2), on the grid of all
    their sides.
    """
    common = np.prod(np.maximum(upper.min(axis=0) - lower.max(axis=0), 0.0))
    x, y = (np.unique([lower[:, k], upper[:, k]]) for k in range(2))
    covered = [
        (lower[:, k, None] <= (a[:-1] + a[1:]) / 2) & ((a[:-1] + a[1:]) / 2 <= upper[:, k, None])
        for k, a in enumerate((x, y))
    ]
    union = np.diff(x) @ (covered[0][:, :, None] & covered[1][:, None, :]).any(axis=0) @ np.diff(y)
    return float(common), float(union)


def largest(inside: np.ndarray) -> list[np.ndarray]:
    """The largest sets (18) of anchors, in the order of anchor numbers, from the mask (K, B) of the
    ellipses that contain each of K points.
    """
    count = inside.sum(axis=1)
    return [np.flatnonzero(M) for M in np.unique(inside[count == count.max()], axis=0)[::-1]]


def fused(m: Array, L: Array) -> tuple[Array, Array]:
    """S3: mean (2,) and covariance (2, 2) of the product of normals m (B, 2), Sigma = L L^T (B, 2,
    2)  (20), (21).
    """
    information = np.linalg.inv(L @ np.swapaxes(L, -1, -2))
    covariance = np.linalg.inv(information.sum(axis=0))
    return m[0] + covariance @ (information @ (m - m[0])[..., None]).sum(axis=0)[:, 0], covariance
