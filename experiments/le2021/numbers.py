"""Le, Slock, Rossi 2021: the numbers behind each table and figure, one function per item, each
giving one frame.

Every fix of a replication has another position, and all replications have the same positions:
standard errors are over positions, from each position's mean over the replications' draws.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import pandas as pd

from aoabench import bounds
from aoabench.cell import Cell
from aoabench.config.compose import compose_cells
from aoabench.engine.tiles import Draws, estimate_tile
from aoabench.maths import statistics
from aoabench.maths.statistics import Estimate
from aoabench.roles import Scenario
from aoabench.store.fixes import Fixes
from aoabench.types import Outcome, Reason

Runs = Iterable[tuple[Cell, dict[str, Fixes]]]  # a cell and the fixes of each of its estimators
PROPOSED = "ml_kcorr"
FEW = 10  # positions; a class with fewer gets no standard error
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


def rms(square: np.ndarray) -> Estimate:
    """Root of the mean of mean squares (P,) of independent positions."""
    return statistics.pooled_rmse(np.sqrt(square))


def standing(above: Estimate, z: float = 3.0) -> str:
    """Whether the proposed estimator's value is lower, higher or a tie, by the paired difference
    `above` (another estimator's value minus its own).
    """
    return (
        "lower"
        if above.value > z * above.se
        else "higher"
        if above.value < -z * above.se
        else "tie"
    )


def accuracy(cell: Cell, fixes: dict[str, Fixes]) -> list[dict[str, Any]]:
    """A row per estimator of one cell: RMSE, its ratio to the bound and iterations, with RMSE and
    iterations compared with those of the proposed estimator.
    """
    crb, crb_xy = bound(cell)
    proposed = fixes[PROPOSED]
    rows = []
    for name, f in fixes.items():
        draws, points = f.outcome.shape
        square = mean_square(f.error_3d_m)
        above = (statistics.ratio(square, mean_square(proposed.error_3d_m)).root() - 1).percent()
        row = {"sigma_deg": deviation_deg(cell), "estimator": name}
        row |= {"positions": points, "draws": draws}
        row |= rms(square).columns("rmse_m", "rmse_se") | rms(crb).columns("bound_m", "bound_se")
        row |= statistics.ratio(square, crb).root().columns("ratio")
        row |= statistics.ratio(mean_square(f.error_xy_m), crb_xy).root().columns("ratio_xy")
        row |= above.columns("above_percent", "above_se")
        row |= {"rmse_of_proposed_is": standing(above), **updates(name, f, proposed)}
        for word, outcome in CLASSES.items():
            row[f"share_{word}"] = float((iterated(f) == outcome).mean())
        rows.append(row)
    return rows


def iterated(f: Fixes) -> np.ndarray:
    """Outcomes (R, T) of the iterations: OK too where a fix has converged behind an anchor."""
    if f.reason is None:
        return f.outcome
    return np.where(f.reason == Reason.BEHIND, Outcome.OK, f.outcome)


def updates(name: str, f: Fixes, proposed: Fixes) -> dict[str, Any]:
    """Columns of an estimator's iterations, and of their excess over the proposed estimator's."""
    if name == "ls":  # solves one linear system
        count = more = Estimate(float("nan"), float("nan"))
    else:
        mine, theirs = (np.nanmean(e.iterations.astype(float), axis=0) for e in (f, proposed))
        count, more = statistics.mean(mine), statistics.mean(mine - theirs)
    row = count.columns("iterations") | more.columns("more_iterations", "more_se")
    return row | {"iterations_of_proposed_are": standing(more)}


# --- Figure 5 -------------------------------------------------------------------------------------


def fig5(scale: str) -> pd.DataFrame:
    """Positions and base stations."""
    cell = compose_cells(["scenario=bs_grid", "noise=ae_normal", "estimator=[ls]"])[0]
    kinds = {"position": positions(cell), "base station": cell.scenario.true_anchors.position[0, 0]}
    return pd.DataFrame(
        [(kind, *x) for kind, found in kinds.items() for x in found],
        columns=["kind", "x_m", "y_m", "z_m"],
    )


# --- Figures 6 and 7 ------------------------------------------------------------------------------


def fig6(runs: Runs) -> pd.DataFrame:
    """Per deviation and estimator the columns of `accuracy`, and the share of the squared bias in
    the mean square error.
    """
    rows = []
    for cell, fixes in runs:
        share = bias(cell, PROPOSED, len(fixes[PROPOSED].outcome))
        for row in accuracy(cell, fixes):
            mine = row["estimator"] == PROPOSED
            row |= {
                "bias_percent": share.value if mine else np.nan,
                "bias_se": share.se if mine else np.nan,
            }
            rows.append(row)
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


# --- Table I --------------------------------------------------------------------------------------


def table1(runs: Runs) -> pd.DataFrame:
    """Per estimator and class: shares, errors and iterations, over all deviations (sigma_deg NaN)
    and for each deviation.
    """
    kept: dict[tuple[str, float], Fixes] = {}
    for cell, fixes in runs:
        kept |= {(name, deviation_deg(cell)): f for name, f in fixes.items() if name != "ls"}
    rows = []
    for name in dict.fromkeys(name for name, _ in kept):
        each = {sigma: [f] for (other, sigma), f in kept.items() if other == name}
        for sigma, some in {np.nan: [f for one in each.values() for f in one], **each}.items():
            rows += classes(name, sigma, some)
    return pd.DataFrame(rows)


def classes(name: str, sigma_deg: float, some: list[Fixes]) -> list[dict[str, Any]]:
    """A row for each class of an estimator's fixes; standard errors over positions (of the median:
    by jackknife).
    """
    error, iterations = (
        np.concatenate([getattr(f, field) for f in some]) for field in ("error_3d_m", "iterations")
    )
    outcome = np.concatenate([iterated(f) for f in some])

    def sums(member: np.ndarray, values: np.ndarray) -> np.ndarray:
        return np.where(member, values, 0.0).sum(axis=0)

    square, converged = error.astype(float) ** 2, outcome == Outcome.OK
    rows = []
    for word, value in CLASSES.items():
        member = outcome == value
        n = member.sum(axis=0)
        row = {"estimator": name, "sigma_deg": sigma_deg, "class": word, "fixes": int(n.sum())}
        row |= statistics.ratio(n, np.full(len(n), len(member))).columns("share")
        if n.sum():
            mine, theirs = sums(member, square), sums(converged, square)
            over = over_converged(mine, n, theirs, converged.sum(axis=0))
            row |= statistics.ratio(mine, n).root().columns("rmse_m", "rmse_se")
            row |= median(error, member).columns("median_m", "median_se")
            row |= statistics.ratio(sums(member, iterations), n).columns("iterations")
            row |= over.columns("over_converged")
            if (n > 0).sum() < FEW:
                row |= {key: np.nan for key in row if key.endswith("_se")}
        rows.append(row)
    return rows


def over_converged(square: np.ndarray, n: np.ndarray, other: np.ndarray, m: np.ndarray) -> Estimate:
    """Ratio of a class's RMSE to that of the converged fixes, from the sums (P,) of squared errors
    and the numbers (P,) of fixes at each position.
    """
    return statistics.ratio_of_ratios(square, n, other, m).root()


def median(error: np.ndarray, member: np.ndarray, groups: int = 20) -> Estimate:
    """Median error of some fixes (R, P); its standard error by leaving out each of `groups` groups
    of positions in turn.
    """

    def middle(e: np.ndarray) -> float:
        given = e[np.isfinite(e)]
        return float(np.median(given)) if len(given) else float("nan")

    return statistics.jackknife(np.where(member, error, np.nan).T, middle, groups)


# --- errata, zones, pole --------------------------------------------------------------------------


def errata(runs: Runs) -> pd.DataFrame:
    """Per deviation and variant: the columns of `accuracy`, and the RMSE above that of the
    corrected variant ("meant").
    """
    rows, squares = [], {}
    for cell, fixes in runs:
        options = cell.config["estimator"][PROPOSED]
        invariant = options["start"] == "invariant"
        if options["as_printed"] and invariant:
            continue
        variant = options["as_printed"] or ("invariant" if invariant else "meant")
        for row in accuracy(cell, fixes):
            name = row["estimator"]
            if name == "ls" and variant not in ("meant", "invariant"):
                continue
            squares[row["sigma_deg"], name, variant] = mean_square(fixes[name].error_3d_m)
            rows.append({"variant": variant, **row})
    for row in rows:
        key = row["sigma_deg"], row["estimator"]
        change = statistics.ratio(squares[*key, row["variant"]], squares[*key, "meant"]).root() - 1
        row |= change.percent().columns("above_meant_percent", "above_meant_se")
    return pd.DataFrame(rows)


def zones(runs: Runs) -> pd.DataFrame:
    """Per zone, deviation and estimator the columns of `accuracy`."""
    return pd.DataFrame(
        [{"zone": zone(cell.scenario), **row} for cell, f in runs for row in accuracy(cell, f)]
    )


def zone(scenario: Scenario) -> str:
    """The name of a zone in tables and figures."""
    return "none" if scenario.zone == "none" else f"{scenario.zone} {scenario.clearance_m:g} m"


def pole(runs: Runs) -> pd.DataFrame:
    """Per horizontal distance from a column, deviation and estimator the columns of `accuracy`."""
    return pd.DataFrame(
        [
            {"distance_m": cell.scenario.clearance_m, **row}
            for cell, f in runs
            for row in accuracy(cell, f)
        ]
    )
