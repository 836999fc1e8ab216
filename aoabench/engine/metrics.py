"""Metrics of one replication: errors over its accepted fixes, outcomes, consistency."""

from __future__ import annotations

import numpy as np

from aoabench.maths.geometry import Array
from aoabench.types import Estimates, Outcome


def per_replication(estimates: Estimates, truth: Array) -> dict[str, np.ndarray]:
    """Columns of the replications table, one value (R,) each, from estimates and true positions (R,
    T, 3) m.

    Accepted fixes are those that give a position: ok, oscillated and diverged. Errors cover the
    accepted fixes whose true x and y are known (not NaN, which a recording may contain). `nees` is
    the mean of e^T P^-1 e (3 degrees of freedom). Where a method gives no z (NaN), the 3-D error is
    the error in the plane, and `rmse_z_m` and `nees` are NaN.
    """
    outcome = estimates.outcome
    error = estimates.position - truth
    accepted = (outcome != Outcome.FAILED) & (outcome != Outcome.REJECTED)
    scored = accepted & np.isfinite(truth[..., :2]).all(-1)
    columns: dict[str, np.ndarray] = {
        "rmse_3d_m": root_mean_square(distance(error), scored),
        "rmse_xy_m": root_mean_square(np.hypot(error[..., 0], error[..., 1]), scored),
        "rmse_z_m": root_mean_square(error[..., 2], scored),
        "outcome": np.array(
            [Outcome(int(o)).name.lower() for o in outcome.max(axis=1)], dtype=object
        ),
        "n_fixes": np.full(len(outcome), outcome.shape[1]),
    }
    for name in ("ok", "diverged", "oscillated", "failed", "rejected"):
        columns[f"n_{name}"] = (outcome == Outcome[name.upper()]).sum(axis=1)
    nothing = np.full(len(outcome), np.nan)
    columns["iterations"] = (
        nothing if estimates.iterations is None else _mean(estimates.iterations, accepted)
    )
    columns["nees"] = nothing
    if estimates.covariance is not None:
        value = nees(error, estimates.covariance)
        columns["nees"] = _mean(
            value, accepted & np.isfinite(value)
        )  # NaN for a singular covariance
    return columns


def per_step(estimates: Estimates, truth: Array) -> dict[str, np.ndarray]:
    """Estimated positions, errors and outcomes, each (R, T)."""
    error = estimates.position - truth
    return {
        **{f"{axis}_m": estimates.position[..., i] for i, axis in enumerate("xyz")},
        "error_3d_m": distance(error),
        "error_xy_m": np.hypot(error[..., 0], error[..., 1]),
        "error_z_m": error[..., 2],
        "outcome": np.array([o.name.lower() for o in Outcome], dtype=object)[estimates.outcome],
    }


def per_fix(estimates: Estimates, truth: Array) -> dict[str, np.ndarray]:
    """Columns of the fixes table, each (R, T), for replications that share their true positions:
    errors in m, iterations, score and anchors_used (float32), outcome (int8) and place (int32).

    Fixes of one true position have one place, numbered from 0 in the order of their first fix.
    """
    error, nothing = (
        estimates.position - truth,
        np.full(estimates.outcome.shape, np.nan, dtype=np.float32),
    )
    given = {name: getattr(estimates, name) for name in ("iterations", "score", "anchors_used")}
    return {
        "error_3d_m": distance(error).astype(np.float32),
        "error_xy_m": np.hypot(error[..., 0], error[..., 1]).astype(np.float32),
        **{
            name: nothing if value is None else value.astype(np.float32)
            for name, value in given.items()
        },
        "outcome": estimates.outcome.astype(np.int8),
        "place": np.broadcast_to(places(truth[0]), estimates.outcome.shape),
    }


def places(truth: Array) -> np.ndarray:
    """Numbers (T,) from 0 of the different true positions (T, 3) m, in the order of their first
    appearance.
    """
    _, first, seat = np.unique(truth, axis=0, return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first))[seat.ravel()].astype(np.int32)


def distance(error: Array) -> Array:
    """Lengths (...) m of errors (..., 3) m; in the plane where z is NaN."""
    z = np.where(np.isnan(error[..., 2]), 0.0, error[..., 2])
    return np.asarray(np.sqrt(error[..., 0] ** 2 + error[..., 1] ** 2 + z**2))


def root_mean_square(error: Array, accepted: np.ndarray) -> Array:
    """Root mean square (R,) of errors (R, T) over the accepted fixes; NaN without any, or where the
    error is NaN.
    """
    return np.sqrt(_mean(error**2, accepted))


def nees(error: Array, covariance: Array) -> Array:
    """Normalised estimation error squared e^T P^-1 e (R, T) of errors (R, T, 3) m with covariances
    (R, T, 3, 3) m^2.

    NaN where an error is NaN or a covariance is nearly singular (smallest eigenvalue below 1e-6 of
    the largest, as in a particle filter with few distinct particles).
    """
    usable: np.ndarray = np.asarray(
        np.isfinite(error).all(-1) & np.isfinite(covariance).all((-1, -2))
    )
    P = np.where(usable[..., None, None], covariance, np.eye(3))
    spread = np.linalg.eigvalsh(P)
    usable &= spread[..., 0] > 1e-6 * spread[..., -1]
    P = np.where(usable[..., None, None], P, np.eye(3))
    e = np.where(usable[..., None], error, 0.0)
    value = (e[..., None, :] @ np.linalg.solve(P, e[..., None]))[..., 0, 0]
    return np.where(usable, value, np.nan)


def _mean(value: Array, accepted: np.ndarray) -> Array:
    count = accepted.sum(axis=1)
    total = np.where(accepted, value, 0.0).sum(axis=1)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)
