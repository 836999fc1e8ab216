"""Figures 5 to 7: positions, errors against the bound, iterations."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from aoabench.cell import Cell
from aoabench.config.compose import compose_cells
from aoabench.engine.draws import Draws
from aoabench.engine.tiles import estimate_tile
from aoabench.maths import statistics
from aoabench.maths.estimate import Estimate
from aoabench.store.fixes import Fixes
from aoabench.types import Outcome

from .common import (
    CLASSES,
    PROPOSED,
    Runs,
    bound,
    capped,
    deviation_deg,
    iterated,
    mean_square,
    median_ratio,
    positions,
    rms,
)

GROSS = 10.0  # an error above this many times the square root of the bound at its position is gross
LEVEL = 0.997  # of intervals


def standing(above: Estimate) -> str:
    """Whether the proposed estimator's value is lower, higher or a tie, by the interval of the
    confidence LEVEL of the paired difference `above` (another estimator's value minus its own).
    """
    low, high = above.interval(LEVEL)
    return "lower" if low > 0 else "higher" if high < 0 else "tie"


def accuracy(cell: Cell, fixes: dict[str, Fixes]) -> list[dict[str, Any]]:
    """A row per estimator of one cell: RMSE, its ratio to the bound and iterations, with RMSE,
    iterations and convergence compared with those of the proposed estimator.
    """
    crb, crb_xy = bound(cell)
    proposed = fixes[PROPOSED]
    rows = []
    for name, f in fixes.items():
        draws, points = f.outcome.shape
        square = mean_square(f.error_3d_m)
        row = {"sigma_deg": deviation_deg(cell), "estimator": name}
        row |= {"positions": points, "draws": draws}
        row |= rms(square).columns("rmse_m", "rmse_se") | rms(crb).columns("bound_m", "bound_se")
        row |= statistics.ratio(square, crb).root().columns("ratio")
        row |= statistics.ratio(mean_square(f.error_xy_m), crb_xy).root().columns("ratio_xy")
        above = excess(square, mean_square(proposed.error_3d_m))
        row |= above.columns("above_percent", "above_se")
        row |= {"rmse_of_proposed_is": standing(above), **updates(f, proposed)}
        for word, outcome in CLASSES.items():
            row[f"share_{word}"] = float((iterated(f) == outcome).mean())
        rows.append(row)
    return rows


def excess(square: np.ndarray, other: np.ndarray) -> Estimate:
    """Excess in percent of an RMSE over another one, from the mean squares (P,) m^2 of both at each
    position.
    """
    return (statistics.ratio(square, other).root() - 1).percent()


def updates(f: Fixes, proposed: Fixes) -> dict[str, Any]:
    """Columns of an estimator's iterations and of their excess over the proposed estimator's (NaN
    without iterations), and of the percentage points by which fewer of its iterations converge.
    """
    count = more = Estimate(float("nan"), float("nan"))
    if np.isfinite(f.iterations).any():
        mine, theirs = (np.nanmean(e.iterations.astype(float), axis=0) for e in (f, proposed))
        count, more = statistics.mean(mine), statistics.mean(mine - theirs)
    converged, others = ((iterated(e) == Outcome.OK).mean(axis=0) for e in (f, proposed))
    row = count.columns("iterations") | more.columns("more_iterations", "more_se")
    row |= statistics.mean(others - converged).percent().columns("fewer_converged", "fewer_se")
    return row | {"iterations_of_proposed_are": standing(more)}


def tails(cell: Cell, fixes: dict[str, Fixes]) -> list[dict[str, Any]]:
    """A row per estimator of one cell, of numbers that few large errors do not decide: the share of
    gross errors in percent, and in percent of the proposed estimator's the excess of the RMSE with
    capped errors (over the RMSE of all its fixes), of the RMSE without gross errors, and of the
    median.
    """
    crb, _ = bound(cell)
    limit = GROSS * np.sqrt(crb)
    theirs = fixes[PROPOSED].error_3d_m.astype(float)
    rows = []
    for f in fixes.values():
        error = f.error_3d_m.astype(float)
        (mine, n), (other, m) = (_kept(e, e <= limit) for e in (error, theirs))
        kept = statistics.ratio_of_ratios(mine, n, other, m).root() - 1
        row = statistics.mean((error > limit).mean(axis=0)).percent().columns("gross_percent")
        row |= excess(mean_square(capped(error)), mean_square(theirs)).columns("capped_percent")
        row |= kept.percent().columns("kept_percent")
        middle = (median_ratio(error, theirs) - 1).percent()
        rows.append(row | middle.columns("median_percent"))
    return rows


def _kept(error: np.ndarray, kept: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sums (P,) of the squares of the errors (R, P) that are kept, and their numbers (P,)."""
    return np.where(kept, error**2, 0.0).sum(axis=0), kept.sum(axis=0)


def fig5(scale: str) -> pd.DataFrame:
    """Positions and base stations."""
    cell = compose_cells(["scenario=bs_grid", "noise=ae_normal", "estimator=[ls]"])[0]
    kinds = {"position": positions(cell), "base station": cell.scenario.true_anchors.position[0, 0]}
    return pd.DataFrame(
        [(kind, *x) for kind, found in kinds.items() for x in found],
        columns=["kind", "x_m", "y_m", "z_m"],
    )


def fig6(runs: Runs) -> pd.DataFrame:
    """Per deviation and estimator the columns of `accuracy` and `tails`, and the share of the
    squared bias in the mean square error.
    """
    rows = []
    for cell, fixes in runs:
        share = bias(cell, PROPOSED, len(fixes[PROPOSED].outcome))
        unknown = Estimate(float("nan"), float("nan"))
        for row, more in zip(accuracy(cell, fixes), tails(cell, fixes)):
            mine = share if row["estimator"] == PROPOSED else unknown
            rows.append(row | more | mine.columns("bias_percent", "bias_se"))
    return pd.DataFrame(rows)


def fig7(runs: Runs) -> pd.DataFrame:
    """Per deviation and estimator the columns of `accuracy`."""
    return pd.DataFrame([row for cell, fixes in runs for row in accuracy(cell, fixes)])


def bias(cell: Cell, name: str, draws: int) -> Estimate:
    """Squared bias in percent of the mean square error: mean over positions, without the
    contribution of the noise to the squared mean error.
    """
    simulated, error = Draws(cell.scenario, cell.noise, cell.seed), []
    for r in range(draws):
        truth, found = estimate_tile(simulated, cell.estimators[name], r)
        error.append((found.position - truth[..., :3])[0])
    e = np.array(error)  # (R, P, 3)
    square = (e.mean(axis=0) ** 2 - e.var(axis=0, ddof=1) / len(e)).sum(-1)
    return statistics.ratio(square, (e**2).sum(-1).mean(axis=0)).percent()
