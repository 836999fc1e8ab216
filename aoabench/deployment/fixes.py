"""The table of fixes: a row for each fix of each tag."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from aoabench.deployment.solving import Residuals, Solved
from aoabench.engine import metrics
from aoabench.maths.geometry import Array
from aoabench.types import Estimates, Outcome, Tracks

if TYPE_CHECKING:
    import pandas as pd

MAX_SIGMA = "max_sigma"  # the reason of a fix that is rejected for its stated deviation
COVARIANCES = tuple(f"cov_{pair}_m2" for pair in ("xx", "xy", "xz", "yy", "yz", "zz"))
# anchors_used are all heard where the method does not count them, as filters do not.
# A position is given where the outcome is ok, oscillated or diverged. sigma_major_m and
# sigma_minor_m are the half-axes of the ellipse of one standard deviation in the plane,
# ellipse_deg is the direction of the longer one, counter-clockwise from +x. Residuals are the root
# mean squares over the anchors heard.
COLUMNS = (
    "track", "tag", "fix", "time_s", "x_m", "y_m", "z_m",
    "sigma_x_m", "sigma_y_m", "sigma_z_m", "sigma_major_m", "sigma_minor_m", "ellipse_deg",
    "outcome", "reason", "anchors_used", "anchors_heard", "packets", "score",
    "residual_azimuth_deg", "residual_elevation_deg", *COVARIANCES,
)  # fmt: skip
OF_TRUTH = ("mark", "true_x_m", "true_y_m", "true_z_m", "error_xy_m", "error_3d_m", "error_z_m")


def table(
    tracks: Tracks,
    solved: Solved,
    max_sigma_m: float | None = None,
    marks: np.ndarray | None = None,
    numbers: np.ndarray | None = None,
) -> pd.DataFrame:
    """`columns` as a table."""
    import pandas as pd

    return pd.DataFrame(columns(tracks, solved, max_sigma_m, marks, numbers))


def columns(
    tracks: Tracks,
    solved: Solved,
    max_sigma_m: float | None = None,
    marks: np.ndarray | None = None,
    numbers: np.ndarray | None = None,
) -> dict[str, np.ndarray]:
    """A value (F,) of each fix in the COLUMNS and, with `marks` (F,), the numbers of the true
    positions, in those of the truth.

    Rows are in order of time over all tracks; in order of the tracks where a time is unknown. A fix
    whose longer half-axis exceeds `max_sigma_m` is rejected and has no position. numbers (R,): the
    numbers of the tracks, None for 0, 1, ...
    """
    estimates, F = solved.estimates, len(tracks.fix)
    found = {n: a[0] for n, a in metrics.per_step(estimates, tracks.truth[None]).items()}
    major, minor, turn = ellipses(estimates)
    found |= {"sigma_major_m": major, "sigma_minor_m": minor, "ellipse_deg": turn}
    tag = np.array([tag or None for tag in tracks.tags], dtype=object)
    numbers = np.arange(len(tracks.counts)) if numbers is None else numbers
    found |= {"track": np.repeat(numbers, tracks.counts)}
    found |= {"tag": np.repeat(tag, tracks.counts), "fix": tracks.fix, "time_s": tracks.time}
    found |= {"anchors_heard": heard(tracks), "packets": tracks.packets}
    if estimates.anchors_used is None:
        given = np.isfinite(estimates.position[0, :, 0])
        found["anchors_used"] = np.where(given, found["anchors_heard"], np.nan)
    for name in ("azimuth", "elevation"):
        rms = _root_mean_square(solved.residuals, name, F)
        found[f"residual_{name}_deg"] = np.degrees(rms)
    if max_sigma_m is not None:
        _reject(found, major > max_sigma_m)
    names = list(COLUMNS)
    if marks is not None:
        found["mark"] = marks
        found |= {f"true_{axis}_m": tracks.truth[:, i] for i, axis in enumerate("xyz")}
        names += OF_TRUTH
    if np.isnan(tracks.time).any():
        return {name: found[name] for name in names}
    order = np.argsort(tracks.time, kind="stable")
    return {name: found[name][order] for name in names}


def heard(tracks: Tracks) -> np.ndarray:
    """The number (F,) of anchors that measured something in each fix."""
    arrays = (tracks.measured.azimuth, tracks.measured.elevation, tracks.measured.delay)
    seen = np.any([np.isfinite(a) for a in arrays if a is not None], axis=0)
    if len(np.unique(tracks.columns)) == len(tracks.columns):
        return np.asarray(seen.sum(axis=1))
    anchors = range(int(tracks.columns.max(initial=-1)) + 1)
    each = [seen[:, tracks.columns == anchor].any(axis=1) for anchor in anchors]
    return np.asarray(np.sum(each, axis=0))


def ellipses(estimates: Estimates) -> tuple[Array, Array, Array]:
    """Half-axes (F,) m of the ellipses of one standard deviation in the plane, the longer ones
    first, and the direction (F,) deg of the longer one in (-90, 90]; NaN without a covariance.
    """
    P = estimates.covariance
    if P is None:
        nothing = np.full(estimates.outcome.shape[1], np.nan)
        return nothing, nothing, nothing
    xx, xy, yy = P[0, :, 0, 0], P[0, :, 0, 1], P[0, :, 1, 1]
    middle, apart = (xx + yy) / 2, np.hypot((xx - yy) / 2, xy)
    with np.errstate(invalid="ignore"):
        minor = np.sqrt(np.maximum(middle - apart, 0.0))
        turn = np.degrees(np.arctan2(2 * xy, xx - yy) / 2)
    return np.sqrt(middle + apart), minor, np.where(turn <= -90.0, 90.0, turn)


def _root_mean_square(residuals: Residuals, name: str, F: int) -> Array:
    """Root mean square (F,) rad of the residuals of each fix; NaN without any."""
    value = getattr(residuals, name)
    known = np.isfinite(value)
    where = residuals.fix[known]
    total = np.bincount(where, value[known] ** 2, minlength=F)
    count = np.bincount(where, minlength=F)
    return np.where(count > 0, np.sqrt(total / np.maximum(count, 1)), np.nan)


_GIVEN = ("x_m", "y_m", "z_m", "error_xy_m", "error_3d_m", "error_z_m")


def _reject(found: dict[str, np.ndarray], wrong: np.ndarray) -> None:
    """Reject the fixes that are `wrong` (F,) and have a position."""
    names = [metrics.OUTCOMES[outcome] for outcome in (Outcome.FAILED, Outcome.REJECTED)]
    wrong = wrong & ~np.isin(found["outcome"], names)
    found["outcome"] = np.where(wrong, metrics.OUTCOMES[Outcome.REJECTED], found["outcome"])
    found["reason"] = np.where(wrong, MAX_SIGMA, found["reason"])
    for name in _GIVEN:
        found[name] = np.where(wrong, np.nan, found[name])
