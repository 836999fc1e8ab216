"""The numbers that the noise of the synthetic campaign is fitted to, and their misfits."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from aoabench import resources
from aoabench.engine.tiles import Draws
from aoabench.maths import statistics
from aoabench.maths.estimate import Estimate
from aoabench.maths.geometry import in_frames, to_azel, wrap
from aoabench.roles import Noise, Scenario
from aoabench.store.fixes import Fixes

from .common import (
    Runs,
    error,
    filters,
    lost,
    medians,
    only,
    printed_grids,
    rmse,
    root_mean_square,
    squares,
    tail,
    within,
)

ANGLES = ("azimuth", "elevation")
PRINTED = resources.printed("boquet2024")
DAYS = {  # deg, both days
    key: tuple(PRINTED[f"misfit/days/{key}/{day}"] for day in (1, 2))
    for key in ("azimuth_mean", "azimuth_sd", "elevation_mean", "elevation_sd")
}
SWEEP = {  # R_sigma: P(error <= 1 m), R_d
    r: (PRINTED[f"misfit/within/{r:g}"], PRINTED[f"misfit/lost/{r:g}"]) for r in (0.4, 2.0)
}


def angle_errors(
    scenario: Scenario, noise: Noise, seed: int, first: int, count: int
) -> Iterator[np.ndarray]:
    """Errors (2, T, B) deg of azimuth and elevation of each campaign; NaN: not measured."""
    draws = Draws(scenario, noise, seed)
    a = scenario.true_anchors
    for r in range(first, first + count):
        truth, batch = draws.tile(r, 1)
        true = to_azel(*in_frames(truth[..., :3], a.position, a.rotation))
        measured = (batch.azimuth, batch.elevation)
        yield np.rad2deg([wrap(m[0] - t[0]) for m, t in zip(measured, true)])


def day_statistics(
    scenario: Scenario, noise: Noise, seed: int, first: int, count: int
) -> dict[str, np.ndarray]:
    """Absolute mean and standard deviation over the room of the first anchor's angle errors, each
    (campaigns, days) deg.

    The paper prints "average errors" over ten places without naming them.
    """
    return by_day([e[..., 0] for e in angle_errors(scenario, noise, seed, first, count)], scenario)


def by_day(errors: Sequence[np.ndarray], scenario: Scenario) -> dict[str, np.ndarray]:
    """The numbers of `day_statistics` from an anchor's angle errors, (2, T) deg each campaign."""
    found: dict[str, list[list[float]]] = {key: [] for key in DAYS}
    for both in errors:
        days = scenario.day_of(both.shape[1])
        for key, e in zip(ANGLES, both):
            found[f"{key}_mean"].append([abs(np.nanmean(e[days == d])) for d in (0, 1)])
            found[f"{key}_sd"].append([np.nanstd(e[days == d]) for d in (0, 1)])
    return {key: np.array(value) for key, value in found.items()}


def misfits(
    fixes: Mapping[str, Fixes], days: dict[str, np.ndarray], points: int
) -> Iterator[dict[str, Any]]:
    """A row per number that the noise is fitted to: printed, ours with its standard error over
    campaigns, and the misfit in units of the tolerance with which the fit weighs it.

    After the mean of each grid two more rows compare it point by point, without a misfit.
    """
    for r, (p, share) in SWEEP.items():
        f = filters(fixes)[r]
        what = f"P(error <= 1 m) at R_sigma = {r:g}"
        yield _misfit(what, f"within/{r:g}", p, within(error(f)), 0.02)
        yield _misfit(f"R_d at R_sigma = {r:g}", f"lost/{r:g}", share, lost(f), 0.02)
    for key, values in DAYS.items():
        for d, value in enumerate(values):
            what = f"{key.replace('_', ' ')}, day {d + 1} [deg]"
            ours = statistics.mean(days[key][:, d])
            yield _misfit(what, f"days/{key}/{d + 1}", value, ours, 1.5)
    for name, grid in printed_grids().items():
        if name in fixes:
            yield from _grid_rows(name, grid, medians(error(fixes[name]), points))


def _grid_rows(name: str, grid: np.ndarray, m: np.ndarray) -> Iterator[dict[str, Any]]:
    """Rows of a printed grid (P,) from each campaign's medians (R, P)."""
    ours = statistics.mean(np.nanmean(m, 1))
    yield _misfit(f"mean of {name}'s medians [m]", f"grid/{name}", grid.mean(), ours, 0.1)
    for key, what, number in (
        ("ratio", f"root mean square log ratio to {name}'s grid", _log_ratio),
        ("inside", f"share of {name}'s grid within 5..95 % of our campaigns", _inside),
    ):
        ours = statistics.jackknife(m, partial(number, grid))
        yield {"what": what, "id": f"{key}/{name}", **ours.columns("ours", "se")}


def _log_ratio(grid: np.ndarray, m: np.ndarray) -> float:
    """Root mean square log ratio of the mean campaign median (R, P) to a printed grid (P,)."""
    return float(np.sqrt(np.nanmean(np.log(np.nanmean(m, axis=0) / grid) ** 2)))


def _inside(grid: np.ndarray, m: np.ndarray) -> float:
    """Share of a printed grid (P,) within the middle 90 % of campaigns' medians (R, P)."""
    quantile = np.nanquantile if np.isnan(m).any() else np.quantile
    low, high = quantile(m, (0.05, 0.95), axis=0)
    return float(np.mean((grid >= low) & (grid <= high)))


def _misfit(
    what: str, key: str, printed: float, ours: Estimate, tolerance: float
) -> dict[str, Any]:
    row = {"what": what, "id": key, "printed": printed, **ours.columns("ours", "se")}
    return row | {"misfit": (ours.value - printed) / tolerance}


def misfit(runs: Runs) -> pd.DataFrame:
    """The rows of `misfits` for campaigns that the fit has not seen, and rows of the anchors' angle
    errors, to which nothing is fitted.
    """
    cell, fixes = only(runs)
    count = len(fixes["vmf_ml"].outcome)
    errors = list(angle_errors(cell.scenario, cell.noise, cell.seed, 0, count))
    days = by_day([e[..., 0] for e in errors], cell.scenario)
    rows = misfits(fixes, days, len(cell.scenario.points_m))
    return pd.DataFrame([*rows, *_anchor_rows(np.array(errors))])


def _anchor_rows(errors: np.ndarray) -> Iterator[dict[str, Any]]:
    """Rows of the angle errors (R, 2, T, B) deg: each anchor's RMS, its RMS minus that of the first
    anchor, and the ratio of the quantiles 99 and 50 % of the magnitude.
    """
    for i, angle in enumerate(ANGLES):
        e = errors[:, i]
        for b in range(e.shape[-1]):
            of = f"{angle} error of anchor {b + 1}"
            tails = statistics.jackknife(np.abs(e[..., b]), tail)
            ours = {"rms": (f"RMS {of} [deg]", rmse(e[..., b]))}
            ours["tail"] = f"99 over 50 % of the {of}", tails
            if b:
                more = statistics.jackknife(
                    np.stack([squares(e[..., b]), squares(e[..., 0])], axis=1), _less_the_second
                )
                ours["more"] = f"RMS {of} minus that of anchor 1 [deg]", more
            for key, (what, number) in ours.items():
                where = f"angles/{angle}/{b + 1}/{key}"
                yield {"what": what, "id": where, **number.columns("ours", "se")}


def _less_the_second(sums: np.ndarray) -> float:
    """RMS of the first errors minus that of the second, from the `squares` (R, 2, 2) of both."""
    return root_mean_square(sums[:, 0]) - root_mean_square(sums[:, 1])
