"""Positions, bounds and mean squares of a cell."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from aoabench import bounds
from aoabench.cell import Cell
from aoabench.engine.draws import Draws
from aoabench.maths import statistics
from aoabench.maths.estimate import Estimate
from aoabench.store.fixes import Fixes
from aoabench.types import Outcome, Reason

Runs = Iterable[tuple[Cell, dict[str, Fixes]]]  # a cell and the fixes of each of its estimators
PROPOSED = "ml_kcorr"
CAP_M = 1000.0  # side of the area; larger errors count as this in `capped`
GROUPS = 20  # of positions, for the jackknife of medians
# of iterations; one that converges behind an anchor has converged
CLASSES = {
    "convergence": Outcome.OK,
    "divergence": Outcome.DIVERGED,
    "oscillation": Outcome.OSCILLATED,
}


def positions(cell: Cell) -> np.ndarray:
    """True positions (P, 3) m of a cell."""
    return Draws(cell.scenario, cell.noise, cell.seed).tile(0, 1)[0][0]


def bound(cell: Cell) -> tuple[np.ndarray, np.ndarray]:
    """Trace of the Cramér-Rao bound (P,) m^2 at each position [(30), (31)], and its horizontal
    part.
    """
    C = bounds.crb(cell.noise.information(positions(cell), cell.scenario.true_anchors))
    return np.trace(C, axis1=-2, axis2=-1), C[:, 0, 0] + C[:, 1, 1]


def deviation_deg(cell: Cell) -> float:
    """Deviation of a cell's angles in degrees, without the rounding error of radians."""
    return round(float(np.rad2deg(cell.noise.sigma)), 9)


def mean_square(error: np.ndarray) -> np.ndarray:
    """Mean square (P,) over the draws of errors (R, P) m at each position."""
    return np.nanmean(error.astype(float) ** 2, axis=0)


def capped(error: np.ndarray) -> np.ndarray:
    """Errors (R, P) m, those above CAP_M replaced by it: their RMSE is at most that of all, and its
    variance is finite whatever the errors are.
    """
    return np.minimum(error.astype(float), CAP_M)


def rms(square: np.ndarray) -> Estimate:
    """Root of the mean of mean squares (P,) of independent positions."""
    return statistics.pooled_rmse(np.sqrt(square))


def iterated(f: Fixes) -> np.ndarray:
    """Outcomes (R, T) of the iterations: OK too where a fix has converged behind an anchor."""
    if f.reason is None:
        return f.outcome
    return np.where(f.reason == Reason.BEHIND, Outcome.OK, f.outcome)


class Ascending:
    """Finite errors (R, P) in ascending order, with the position of each, for medians over some
    positions.
    """

    def __init__(self, error: np.ndarray) -> None:
        draw, position = np.nonzero(np.isfinite(error))
        values = error[draw, position]
        order = np.argsort(values)
        self.values, self.position = values[order], position[order]
        self.kept = np.zeros(error.shape[1], dtype=bool)

    def middle(self, positions: np.ndarray) -> float:
        """Median of the errors at some positions, given by their indices; NaN without any."""
        self.kept[:] = False
        self.kept[positions] = True
        places = np.flatnonzero(self.kept[self.position])
        n = len(places)
        return float(self.values[places[(n - 1) // 2 : n // 2 + 1]].mean()) if n else float("nan")


def median(error: np.ndarray, member: np.ndarray) -> Estimate:
    """Median error of some fixes (R, P); its standard error by leaving out each group of positions
    in turn.
    """
    found = Ascending(np.where(member, error, np.nan))
    return statistics.jackknife(np.arange(error.shape[1]), found.middle, GROUPS)


def median_ratio(error: np.ndarray, other: np.ndarray) -> Estimate:
    """Median of errors (R, P) over that of others at the same positions (NaN: none); its standard
    error by leaving out each group of positions in turn.
    """
    above, below = Ascending(error), Ascending(other)

    def ratio(positions: np.ndarray) -> float:
        least = below.middle(positions)
        return above.middle(positions) / least if least > 0 else float("nan")

    return statistics.jackknife(np.arange(error.shape[1]), ratio, GROUPS)
