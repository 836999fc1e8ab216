"""Influences of the true positions that all replications share, and the estimates that follow.

The fixes of one position depend on each other, and so may those of one replication, whose noise may
have a part that all its fixes share. Both are counted (`statistics.crossed`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields

import numpy as np

from aoabench.maths.intervals import by_place
from aoabench.maths.statistics import Array, Estimate, crossed, from_influence, ratio

CLUSTERED = ("rmse_3d_m", "rmse_xy_m", "rmse_z_m", "iterations")  # metrics of `influences`
AXES = ("3d", "xy", "z")


@dataclass(frozen=True)
class Clusters:
    """Sums over replications for each of P true positions that all replications share.

    In the last axis but one stand the squared errors in 3-D, in the plane and in z, m^2, and the
    iterations of the accepted fixes. A cell is a position in one replication.

    replications: number of replications with an accepted fix; fixes (P,): number of accepted fixes;
    totals (4, P): their sums; influence (3, P): sums of the influences on the replications' RMSE, m
    (see `influences`). Of each cell's number of fixes n, sum s and influence i: fixes_squared (P,),
    totals_squared (4, P), totals_fixes (4, P) and influence_squared (3, P) are sums of n^2, s^2,
    s n and i^2.
    """

    replications: int
    fixes: Array
    totals: Array
    influence: Array
    fixes_squared: Array
    totals_squared: Array
    totals_fixes: Array
    influence_squared: Array

    def __add__(self, other: Clusters) -> Clusters:
        return Clusters(*(getattr(self, f.name) + getattr(other, f.name) for f in fields(self)))

    def estimates(self, over: Mapping[str, Estimate]) -> dict[str, Estimate]:
        """The estimates over replications that are clustered here, by the names of the columns of
        the summary, with their errors clustered.
        """
        found = {}
        for i, axis in enumerate(AXES):
            pooled, mean = f"rmse_pooled_{axis}_m", f"rmse_mean_{axis}_m"
            square, within = self._ratio(i)
            of_root = within / (4 * square.value) if square.value > 0 else 0.0
            found[pooled] = crossed(over[pooled].value, square.root(), over[pooled], of_root)
            found[mean] = self._mean(i, over[mean])
        iterations, within = self._ratio(3)
        name = "iterations_mean"
        found[name] = crossed(over[name].value, iterations, over[name], within)
        return found

    def _ratio(self, i: int) -> tuple[Estimate, float]:
        """A sum per fix over the positions, and the sum of the squared influences of the cells."""
        some = self.fixes > 0
        found = ratio(self.totals[i, some], self.fixes[some])
        m, n = found.value, self.fixes.sum()
        squares = self.totals_squared[i] - 2 * m * self.totals_fixes[i] + m**2 * self.fixes_squared
        return found, float(squares.sum() / max(n, 1) ** 2)

    def _mean(self, i: int, over: Estimate) -> Estimate:
        """The mean of the replications' RMSE."""
        R = max(self.replications, 1)
        influence = self.influence.shape[1] * self.influence[i] / R
        curve = -1 / over.value if over.value > 0 else 0.0  # as of the root of one mean square
        units = from_influence(over.value, influence, curve)
        return crossed(over.value, units, over, float(self.influence_squared[i].sum()) / R**2)


def position_sums(
    error_3d: Array,
    error_xy: Array,
    iterations: Array,
    accepted: np.ndarray,
    place: np.ndarray | None = None,
) -> Clusters:
    """Sums per position from errors in m, iterations and whether a fix is accepted, each (R, T).

    `place` (T,) numbers the position of each fix from 0; None: each has its own.
    """
    a, square = accepted.astype(float), _squares(error_3d, error_xy, accepted)
    counted = np.where(accepted, iterations, 0.0)
    n = by_place(a, place)
    totals = np.stack([by_place(x, place) for x in (*square, counted)])
    cells = np.stack([by_place(_of_root(s, a), place) for s in square])
    return Clusters(
        replications=int(accepted.any(axis=1).sum()),
        fixes=n.sum(axis=0),
        totals=totals.sum(axis=1),
        influence=cells.sum(axis=1),
        fixes_squared=(n**2).sum(axis=0),
        totals_squared=(totals**2).sum(axis=1),
        totals_fixes=(totals * n).sum(axis=1),
        influence_squared=(cells**2).sum(axis=1),
    )


def influences(
    metric: str, error_3d: Array, error_xy: Array, iterations: Array, accepted: np.ndarray,
    place: np.ndarray | None = None,
) -> Array:  # fmt: skip
    """The influence (R, P) of each position in each replication on the mean over R replications of
    one of the CLUSTERED metrics: its first-order contribution to the mean's deviation.

    With n accepted fixes and mean square error s^2 in a replication, an accepted fix with error e
    has the influence (e^2 - s^2) / (2 s n) on its RMSE.
    """
    a = accepted.astype(float)
    if metric == "iterations":
        counted = np.where(accepted, iterations, 0.0)
        n = np.maximum(a.sum(axis=1, keepdims=True), 1)
        found = a * (counted - counted.sum(axis=1, keepdims=True) / n) / n
    else:
        square = _squares(error_3d, error_xy, accepted)
        found = _of_root(square[CLUSTERED.index(metric)], a)
    return by_place(found, place) / len(a)


def _squares(error_3d: Array, error_xy: Array, accepted: np.ndarray) -> tuple[Array, Array, Array]:
    """Squared errors (R, T) m^2 in 3-D, in the plane and in z; 0 where no fix is accepted."""
    whole, plane = (
        np.where(accepted, error, 0.0).astype(float) ** 2 for error in (error_3d, error_xy)
    )
    return whole, plane, np.maximum(whole - plane, 0.0)


def _of_root(square: Array, a: Array) -> Array:
    """The influence (R, T) of each fix on the root of the mean of `square` over the fixes of its
    replication with a = 1.
    """
    n = np.maximum(a.sum(axis=1, keepdims=True), 1)
    mean = square.sum(axis=1, keepdims=True) / n
    return np.asarray(a * (square - mean) / (2 * np.sqrt(np.where(mean > 0, mean, np.inf)) * n))
