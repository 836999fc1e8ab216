"""Figure 8 by area: median errors of the methods over parts of the room."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from aoabench import bounds
from aoabench.maths import statistics
from aoabench.maths.estimate import Estimate
from aoabench.roles import Scenario
from aoabench.types import Anchors

from .common import METHODS, Runs, columns, error, filters, medians, only

INNER_M = 4.0  # y above which the paper's inner area lies
NEAR_M = 1.0  # horizontal distance from the nearest anchor
AROUND_M = 1.7  # points up to here lie around the point nearest to an anchor
SINGLE = ("single_anchor_1", "single_anchor_2", "single_anchor_3")


def areas(runs: Runs) -> pd.DataFrame:
    """Median errors over parts of the room: means over an area's points of each campaign's medians.

    `other` empty: the method's median in m; else its median minus that of the other, paired over
    campaigns. The discrepancy filter has R_sigma = 1; the areas `... accepted` are of the fixes
    that it gives. Areas `gdop` (rank correlation of a single anchor's medians with its GDOP) and
    `below` (median at the point nearest to the anchor minus that of the points around it, m) have
    rows for each single anchor.
    """
    cell, fixes = only(runs)
    scenario = cell.scenario
    points = np.array(scenario.points_m)
    errors = {m: error(fixes[m]) for m in METHODS}
    df = error(filters(fixes)[1.0])
    given = {m: medians(e, len(points)) for m, e in errors.items()}
    accepted = {
        m: medians(np.where(np.isfinite(df), e, np.nan), len(points)) for m, e in errors.items()
    }
    own = medians(df, len(points))
    rows = list(_anchor_rows(scenario, points, given))
    for area, inside in parts(scenario, points).items():
        for m, e in {**given, "discrepancy": own}.items():
            rows.append(_row(area, inside, m, "", _over(e, inside)))
            for other in METHODS if m == "discrepancy" else [s for s in SINGLE if s != m]:
                rows.append(_row(area, inside, m, other, _over(e - given[other], inside)))
        for other in METHODS:
            more = _over(own - accepted[other], inside)
            rows.append(_row(f"{area} accepted", inside, "discrepancy", other, more))
    return pd.DataFrame(rows)


def parts(scenario: Scenario, points: np.ndarray) -> dict[str, np.ndarray]:
    """Masks (P,) of the points in each area."""
    away = _away(scenario, points).min(axis=1)
    y = points[:, 1]
    return {
        "room": np.ones(len(points), dtype=bool),
        "inner": y > INNER_M,
        "outer": y <= INNER_M,
        "farthest": y == y.min(),
        "near": away <= NEAR_M,
        "away": away > NEAR_M,
    }


def _away(scenario: Scenario, points: np.ndarray) -> np.ndarray:
    """Horizontal distances (P, B) m of the points from the anchors."""
    s = scenario.true_anchors.position[0, 0, :, :2]
    return np.asarray(np.linalg.norm(points[:, None] - s, axis=-1))


def _over(m: np.ndarray, inside: np.ndarray) -> Estimate:
    """Mean over an area's points of medians (R, P) m, with its standard error over campaigns."""
    return statistics.mean(np.nanmean(m[:, inside], axis=1))


def _row(area: str, inside: np.ndarray, method: str, other: str, value: Estimate) -> dict[str, Any]:
    row = {"area": area, "method": method, "other": other, "points": int(inside.sum())}
    return row | columns(value=value)


def _anchor_rows(
    scenario: Scenario, points: np.ndarray, given: dict[str, np.ndarray]
) -> Iterator[dict[str, Any]]:
    """Rows `gdop` and `below` of each single anchor from the medians (R, P) m."""
    away = _away(scenario, points)
    everywhere = np.ones(len(points), dtype=bool)
    for b, name in enumerate(SINGLE):
        m = given[name]
        rank = statistics.jackknife(m, partial(_rank_correlation, _gdop(scenario, points, b)))
        yield _row("gdop", everywhere, name, "", rank)
        nearest = np.arange(len(points)) == away[:, b].argmin()
        around = (away[:, b] <= AROUND_M) & ~nearest
        below = statistics.mean(m[:, nearest].mean(axis=1) - m[:, around].mean(axis=1))
        yield _row("below", nearest | around, name, "", below)


def _gdop(scenario: Scenario, points: np.ndarray, b: int) -> np.ndarray:
    """GDOP (P,) m of one anchor at the points, the height known."""
    height = np.full((len(points), 1), scenario.known_height_m)
    a = scenario.true_anchors
    alone = Anchors(a.position[:, :, [b]], a.rotation[:, :, [b]])
    return bounds.gdop(np.concatenate([points, height], axis=1), alone, known_z=True)


def _rank_correlation(gdop: np.ndarray, m: np.ndarray) -> float:
    """Spearman's rank correlation of the mean medians (R, P) with the GDOP (P,)."""
    return float(np.corrcoef(_ranks(m.mean(axis=0)), _ranks(gdop))[0, 1])


def _ranks(x: np.ndarray) -> np.ndarray:
    """Ranks (P,) from 1 of values, the mean rank where some are equal; NaN if one is NaN."""
    if np.isnan(x).any():
        return np.full(len(x), np.nan)
    _, place, count = np.unique(x, return_inverse=True, return_counts=True)
    return np.asarray((np.cumsum(count) - (count - 1) / 2)[place])
