"""Le, Slock, Rossi 2021: the numbers behind each table and figure, one function per item, each
giving one frame.

Every fix of a replication stands at another position, and each position is seen in all
replications: standard errors are over positions, from each position's mean over the draws.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import pandas as pd

from aoabench import bounds
from aoabench.config.compose import compose_cells
from aoabench.engine.tiles import Draws, estimate_tile
from aoabench.maths import statistics
from aoabench.maths.statistics import Estimate
from aoabench.store.fixes import Fixes
from aoabench.types import Outcome

Runs = Iterable[tuple[Any, dict[str, Fixes]]]  # a cell and the fixes of each of its estimators
PROPOSED = "ml_kcorr"
FEW = 10  # positions; with fewer there is no telling a standard error
CLASSES = {
    "convergence": Outcome.OK,
    "divergence": Outcome.DIVERGED,
    "oscillation": Outcome.OSCILLATED,
}


def positions(cell: Any) -> np.ndarray:
    """True positions (P, 3) m of a cell."""
    return Draws(cell.scenario, cell.noise, cell.seed).tile(0, 1)[0][0]


def bound(cell: Any) -> tuple[np.ndarray, np.ndarray]:
    """Trace of the Cramér-Rao bound (P,) m^2 at each position [(30), (31)], and its horizontal
    part.
    """
    C = bounds.crb(cell.noise.information(positions(cell), cell.scenario.known_anchors))
    return np.trace(C, axis1=-2, axis2=-1), C[:, 0, 0] + C[:, 1, 1]


def rms(square: np.ndarray) -> Estimate:
    """Root of the mean of mean squares (P,) of independent positions."""
    return statistics.pooled_rmse(np.sqrt(square))


def root_of_ratio(numerator: np.ndarray, denominator: np.ndarray) -> Estimate:
    """sqrt(sum of numerators / sum of denominators) over positions (P,): the ratio of two RMSEs."""
    q = statistics.ratio(numerator, denominator)
    return Estimate(float(np.sqrt(q.value)), q.se / (2 * float(np.sqrt(q.value))))


def standing(above: Estimate, z: float = 3.0) -> str:
    """The proposed one's standing by a paired difference (another one's minus its own)."""
    return (
        "lower"
        if above.value > z * above.se
        else "higher"
        if above.value < -z * above.se
        else "tie"
    )


def accuracy(cell: Any, fixes: dict[str, Fixes]) -> list[dict[str, Any]]:
    """A row per estimator of one cell: RMSE, its ratio to the bound, iterations, and both against
    the proposed one.
    """
    crb, crb_xy = bound(cell)
    square = {
        name: np.nanmean(f.error_3d_m.astype(float) ** 2, axis=0) for name, f in fixes.items()
    }
    updates = {
        name: np.nanmean(f.iterations.astype(float), axis=0)
        for name, f in fixes.items()
        if name != "ls"
    }
    rows = []
    for name, f in fixes.items():
        draws, points = f.outcome.shape
        rmse, ratio = rms(square[name]), root_of_ratio(square[name], crb)
        above = root_of_ratio(square[name], square[PROPOSED])
        ratio_xy = root_of_ratio(np.nanmean(f.error_xy_m.astype(float) ** 2, axis=0), crb_xy)
        above = Estimate(100 * (above.value - 1), 100 * above.se)
        nothing = np.full(points, np.nan)
        count = statistics.mean(updates.get(name, nothing))
        more = statistics.mean(updates.get(name, nothing) - updates[PROPOSED])
        rows.append(
            {
                "sigma_deg": round(float(np.rad2deg(cell.noise.sigma)), 9),
                "estimator": name,
                "positions": points,
                "draws": draws,
                "rmse_m": rmse.value,
                "rmse_se": rmse.se,
                "bound_m": rms(crb).value,
                "bound_se": rms(crb).se,
                "ratio": ratio.value,
                "ratio_se": ratio.se,
                "ratio_xy": ratio_xy.value,
                "ratio_xy_se": ratio_xy.se,
                "above_percent": above.value,
                "above_se": above.se,
                "rmse_of_proposed_is": standing(above),
                "iterations": count.value,
                "iterations_se": count.se,
                "more_iterations": more.value,
                "more_se": more.se,
                "iterations_of_proposed_are": standing(more),
            }
            | {
                f"share_{word}": float((f.outcome == outcome).mean())
                for word, outcome in CLASSES.items()
            }
        )
    return rows


# --- Figure 5 -------------------------------------------------------------------------------------


def fig5(scale: str) -> pd.DataFrame:
    """Positions and base stations."""
    cell = compose_cells(["scenario=bs_grid", "noise=ae_normal", "estimator=[ls]"])[0]
    kinds = {"position": positions(cell), "base station": cell.scenario.known_anchors.position[0]}
    return pd.DataFrame(
        [(kind, *x) for kind, found in kinds.items() for x in found],
        columns=["kind", "x_m", "y_m", "z_m"],
    )


# --- Figures 6 and 7 ------------------------------------------------------------------------------


def fig6(runs: Runs) -> pd.DataFrame:
    """Per deviation and estimator what `accuracy` says, and the share of the squared bias in the
    mean square error.
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
    """Per deviation and estimator what `accuracy` says."""
    return pd.DataFrame([row for cell, fixes in runs for row in accuracy(cell, fixes)])


def bias(cell: Any, name: str, draws: int) -> Estimate:
    """Squared bias in percent of the mean square error: mean over positions, freed from the noise
    of the mean error.
    """
    simulated, error = Draws(cell.scenario, cell.noise, cell.seed), []
    for r in range(draws):
        truth, found = estimate_tile(simulated, cell.estimators[name], r)
        error.append((found.position - truth[..., :3])[0])
    e = np.array(error)  # (R, P, 3)
    square = (e.mean(axis=0) ** 2 - e.var(axis=0, ddof=1) / len(e)).sum(-1)
    q = statistics.ratio(square, (e**2).sum(-1).mean(axis=0))
    return Estimate(100 * q.value, 100 * q.se)


# --- Table I --------------------------------------------------------------------------------------


def table1(runs: Runs) -> pd.DataFrame:
    """Per estimator and class, over all deviations (sigma_deg NaN) and for each: shares, errors,
    iterations.
    """
    kept: dict[tuple[str, float], Fixes] = {}
    for cell, fixes in runs:
        kept |= {
            (name, round(float(np.rad2deg(cell.noise.sigma)), 9)): f
            for name, f in fixes.items()
            if name != "ls"
        }
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
    error, iterations, outcome = (
        np.concatenate([getattr(f, field) for f in some])
        for field in ("error_3d_m", "iterations", "outcome")
    )
    rows, converged = [], outcome == Outcome.OK
    for word, value in CLASSES.items():
        member = outcome == value
        n, square = member.sum(axis=0), np.where(member, error.astype(float) ** 2, 0.0).sum(axis=0)
        share = statistics.ratio(n, np.full(len(n), len(member)))
        row = {"estimator": name, "sigma_deg": sigma_deg, "class": word, "fixes": int(n.sum())}
        row |= {"share": share.value, "share_se": share.se}
        if n.sum():
            ms = statistics.ratio(square, n)
            count = statistics.ratio(np.where(member, iterations, 0.0).sum(axis=0), n)
            middle = median(error, member)
            other = np.where(converged, error.astype(float) ** 2, 0.0).sum(axis=0)
            over = over_converged(square, n, other, converged.sum(axis=0))
            row |= {"rmse_m": np.sqrt(ms.value), "rmse_se": ms.se / (2 * np.sqrt(ms.value))}
            row |= {"median_m": middle.value, "median_se": middle.se}
            row |= {"iterations": count.value, "iterations_se": count.se}
            row |= {"over_converged": over.value, "over_converged_se": over.se}
            if (n > 0).sum() < FEW:
                row |= {key: np.nan for key in row if key.endswith("_se")}
        rows.append(row)
    return rows


def over_converged(square: np.ndarray, n: np.ndarray, other: np.ndarray, m: np.ndarray) -> Estimate:
    """RMSE of a class over the converged fixes', from both sums (P,) of squares and of fixes at
    each position.
    """
    ratio = np.sqrt((square.sum() / n.sum()) / (other.sum() / m.sum()))
    influence = [(s - k * s.sum() / k.sum()) / (2 * s.sum()) for s, k in ((square, n), (other, m))]
    return Estimate(
        float(ratio), float(ratio * np.sqrt(len(n)) * (influence[0] - influence[1]).std(ddof=1))
    )


def median(error: np.ndarray, member: np.ndarray, groups: int = 20) -> Estimate:
    """Median error of some fixes; its standard error by leaving out each of `groups` groups of
    positions in turn.
    """
    whole = float(np.median(error[member]))
    group = np.arange(error.shape[1]) % groups
    left = [error[:, group != g][member[:, group != g]] for g in range(groups)]
    each = np.array([np.median(e) for e in left if len(e)])
    if len(each) < groups:
        return Estimate(whole, float("nan"))
    return Estimate(
        whole, float(np.sqrt((groups - 1) / groups * ((each - each.mean()) ** 2).sum()))
    )


# --- errata, zones, pole --------------------------------------------------------------------------


def errata(runs: Runs) -> pd.DataFrame:
    """Per deviation and variant: what `accuracy` says, and the RMSE above the one as meant."""
    rows, squares = [], {}
    for cell, fixes in runs:
        options = cell.config["estimator"][PROPOSED]
        variant = options["as_printed"] or (
            "invariant" if options["start"] == "invariant" else "meant"
        )
        if options["as_printed"] and options["start"] == "invariant":
            continue
        for row in accuracy(cell, fixes):
            key = row["sigma_deg"], row["estimator"], variant
            if row["estimator"] == "ls" and variant not in ("meant", "invariant"):
                continue
            squares[key] = np.nanmean(fixes[row["estimator"]].error_3d_m.astype(float) ** 2, axis=0)
            rows.append({"variant": variant, **row})
    for row in rows:
        key = row["sigma_deg"], row["estimator"]
        change = root_of_ratio(squares[*key, row["variant"]], squares[*key, "meant"])
        row |= {"above_meant_percent": 100 * (change.value - 1), "above_meant_se": 100 * change.se}
    return pd.DataFrame(rows)


def zones(runs: Runs) -> pd.DataFrame:
    """What `accuracy` says per zone, deviation and estimator."""
    return pd.DataFrame(
        [{"zone": zone(cell.scenario), **row} for cell, f in runs for row in accuracy(cell, f)]
    )


def zone(scenario: Any) -> str:
    """A zone's name for people."""
    return "none" if scenario.zone == "none" else f"{scenario.zone} {scenario.clearance_m:g} m"


def pole(runs: Runs) -> pd.DataFrame:
    """What `accuracy` says per horizontal distance from a column, deviation and estimator."""
    return pd.DataFrame(
        [
            {"distance_m": cell.scenario.clearance_m, **row}
            for cell, f in runs
            for row in accuracy(cell, f)
        ]
    )
