"""Metrics of one replication: errors over its accepted fixes, outcomes, consistency."""

from __future__ import annotations

import math

import numpy as np

from aoabench.maths.geometry import Array
from aoabench.maths.linalg import quadratic
from aoabench.types import Estimates, Outcome, Reason

OUTCOMES = np.array([outcome.name.lower() for outcome in Outcome], dtype=object)
REASONS = np.array(["", *(r.name.lower() for r in Reason if r)], dtype=object)  # "" for NONE
_NONE, _NOT_STATED = np.int8(Reason.NONE), np.int8(Reason.NOT_STATED)
_SINGULAR = 1e-6  # of the smallest eigenvalue of a covariance relative to the largest
_PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


def per_replication(estimates: Estimates, truth: Array) -> dict[str, np.ndarray]:
    """Columns of the replications table, one value (R,) each, from estimates and true positions (R,
    T, 3) m.

    Accepted fixes are those that give a position: ok, oscillated and diverged. Errors cover the
    accepted fixes whose true x and y are known (not NaN, which a recording may contain). `nees` is
    the mean of e^T P^-1 e (3 degrees of freedom). Where a method gives no z (NaN), the 3-D error is
    the error in the plane, and `rmse_z_m` and `nees` are NaN. `reason` is the commonest of the
    fixes that are not ok.
    """
    outcome = estimates.outcome
    error = estimates.position - truth
    accepted = (outcome != Outcome.FAILED) & (outcome != Outcome.REJECTED)
    scored = accepted & np.isfinite(truth[..., 0]) & np.isfinite(truth[..., 1])
    columns: dict[str, np.ndarray] = {
        "rmse_3d_m": root_mean_square(distance(error), scored),
        "rmse_xy_m": root_mean_square(np.hypot(error[..., 0], error[..., 1]), scored),
        "rmse_z_m": root_mean_square(error[..., 2], scored),
        "outcome": OUTCOMES[outcome.max(axis=1)],
        "n_fixes": np.full(len(outcome), outcome.shape[1]),
    }
    for name in ("ok", "diverged", "oscillated", "failed", "rejected"):
        columns[f"n_{name}"] = np.count_nonzero(outcome == Outcome[name.upper()], axis=1)
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
    columns["reason"] = REASONS[_commonest(reasons(estimates))]
    return columns


def commonest_outcome(estimates: Estimates) -> np.ndarray:
    """The commonest outcome (R,) of the fixes; the worst of those that are equally common."""
    count = np.stack([(estimates.outcome == one).sum(axis=1) for one in Outcome][::-1])
    return np.asarray(OUTCOMES[::-1][count.argmax(axis=0)])


def reasons(estimates: Estimates) -> np.ndarray:
    """The Reason (R, T) of each fix: NONE where the outcome is OK, and NOT_STATED where it is not
    OK and the estimator states none.
    """
    bad = estimates.outcome != Outcome.OK
    if estimates.reason is None:
        return np.where(bad, _NOT_STATED, _NONE)
    reason = np.asarray(estimates.reason).astype(np.int8, copy=False)
    return np.where(bad, np.where(reason == _NONE, _NOT_STATED, reason), _NONE)


def _commonest(reason: np.ndarray) -> np.ndarray:
    """The commonest Reason (R,) of the fixes (R, T) with a reason; of two, the one with the lower
    number; NONE without any.
    """
    R, K = len(reason), len(REASONS)
    i, step = np.nonzero(reason)
    count = np.bincount(K * i + reason[i, step], minlength=R * K)
    return np.asarray(count.reshape(R, K).argmax(axis=1))


def reason_counts(estimates: Estimates) -> dict[str, np.ndarray]:
    """For each replication, outcome and reason of fixes that are not ok, the index of the
    replication, the names of both, and the number `n` of such fixes; arrays (K,).
    """
    i, step = np.nonzero(estimates.outcome != Outcome.OK)
    shape = len(estimates.outcome), len(OUTCOMES), len(REASONS)
    three = i, estimates.outcome[i, step], reasons(estimates)[i, step]
    count = np.bincount(np.ravel_multi_index(three, shape), minlength=math.prod(shape))
    code = np.flatnonzero(count)
    index, outcome, reason = np.unravel_index(code, shape)
    names = {"outcome": OUTCOMES[outcome], "reason": REASONS[reason]}
    return {"replication": index, **names, "n": count[code]}


def per_step(estimates: Estimates, truth: Array) -> dict[str, np.ndarray]:
    """Estimated positions with their deviations and covariances (NaN where the estimator gives
    none), errors, outcomes, reasons, anchors_used and score, each (R, T).
    """
    error, P = estimates.position - truth, estimates.covariance
    nothing = np.full(estimates.outcome.shape, np.nan)
    given = {"anchors_used": estimates.anchors_used, "score": estimates.score}
    return {
        **{f"{axis}_m": estimates.position[..., i] for i, axis in enumerate("xyz")},
        "error_3d_m": distance(error),
        "error_xy_m": np.hypot(error[..., 0], error[..., 1]),
        "error_z_m": error[..., 2],
        "outcome": OUTCOMES[estimates.outcome],
        "reason": REASONS[reasons(estimates)],
        **{name: nothing if value is None else value for name, value in given.items()},
        **deviations(estimates),
        **{
            f"cov_{'xyz'[a]}{'xyz'[b]}_m2": nothing if P is None else P[..., a, b]
            for a, b in _PAIRS
        },
    }


def deviations(estimates: Estimates) -> dict[str, np.ndarray]:
    """Columns sigma_x_m, sigma_y_m and sigma_z_m (R, T); NaN without a covariance or where a
    variance is negative.
    """
    P = estimates.covariance
    nothing = np.full(estimates.outcome.shape, np.nan)
    variance = [nothing if P is None else P[..., i, i] for i in range(3)]
    return {
        f"sigma_{axis}_m": np.sqrt(np.where(v >= 0, v, np.nan)) for axis, v in zip("xyz", variance)
    }


def per_fix(estimates: Estimates, truth: Array) -> dict[str, np.ndarray]:
    """Columns of the fixes table, each (R, T): errors and standard deviations in m, iterations,
    score and anchors_used (float32), outcome and reason (int8).
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
        "reason": reasons(estimates),
        **{name: value.astype(np.float32) for name, value in deviations(estimates).items()},
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
    value = np.full(error.shape[:-1], np.nan)
    known = np.isfinite(error[..., 2]) & np.isfinite(error[..., 0]) & np.isfinite(error[..., 1])
    if known.all():
        flat = quadratic(covariance.reshape(-1, 3, 3), error.reshape(-1, 3), _SINGULAR)
        return flat.reshape(value.shape)
    value[known] = quadratic(covariance[known], error[known], _SINGULAR)
    return value


def _mean(value: Array, accepted: np.ndarray) -> Array:
    count = np.count_nonzero(accepted, axis=1)
    total = np.where(accepted, value, 0.0).sum(axis=1)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)
