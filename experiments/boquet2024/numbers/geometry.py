"""Figures 2 and 3 and the rule of the square root of three: one anchor, or the mean of two."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from scipy import optimize

from aoabench import bounds
from aoabench.config.compose import compose_cells
from aoabench.estimators.plane import on_plane
from aoabench.maths import statistics
from aoabench.maths.geometry import in_frames, to_azel, to_unit, wrap
from aoabench.types import Anchors

from .common import ERRORS, columns

ROOM = 10.0  # m, the sides of the standard room
LAYOUTS = {
    f"{number} anchor{'s' * (i > 0)}": f"_{i + 1}"
    for i, number in enumerate(("one", "two", "three", "four"))
}


def standard_room(which: str = "") -> Anchors:
    """Anchors of scenario=standard_room, A, B and C of Figure 3, or of standard_room_1 ... _4,
    those of Figure 2.
    """
    words = [f"scenario=standard_room{which}", "noise=ae_normal", "estimator=[anchor_mean]"]
    return compose_cells(words)[0].scenario.true_anchors


def upright(position: np.ndarray) -> Anchors:
    """Anchors (B, 3) m whose frames are the global one."""
    return Anchors(position, np.broadcast_to(np.eye(3), (len(position), 3, 3)))


def fig2(scale: str) -> pd.DataFrame:
    """GDOP in m at z = 0 over the room for each layout, and the text's numbers on one anchor."""
    step = 0.25 if scale == "quick" else 0.1
    side = np.arange(step / 2, ROOM, step)
    x, y = (a.ravel() for a in np.meshgrid(side, side))
    rows = []
    for name, which in LAYOUTS.items():
        g = bounds.gdop(np.stack([x, y, 0 * x], axis=-1), standard_room(which), known_z=True)
        rows += [{"layout": name, "x_m": a, "y_m": b, "gdop_m": v} for a, b, v in zip(x, y, g)]
    return pd.DataFrame(rows + one_anchor())


def one_anchor() -> list[dict[str, Any]]:
    """The least GDOP of one anchor, and the distance from the anchor at which the GDOP is sqrt(3)
    times the value below the anchor.
    """
    anchors = standard_room("_1")

    def single(away: float) -> float:
        return float(bounds.gdop(np.array([5.0 + away, 5.0, 0.0]), anchors, known_z=True))

    least = optimize.minimize_scalar(
        single, bounds=(1e-4, 5.0), method="bounded", options={"xatol": 1e-6}
    )
    root3 = optimize.brentq(lambda away: single(away) - np.sqrt(3) * single(1e-4), 0.1, 5.0)
    return [
        {"layout": "minimum", "x_m": least.x, "y_m": np.nan, "gdop_m": least.fun},
        {"layout": "sqrt 3", "x_m": root3, "y_m": np.nan, "gdop_m": single(root3)},
    ]


def single_positions(
    node: np.ndarray, anchors: np.ndarray, e: np.ndarray, clip: bool
) -> np.ndarray:
    """Positions (N, B, 2) m of a node (3,) m, each from one of the anchors (B, 3) m alone, with
    angle errors e (2, N, B) rad.
    """
    a = upright(anchors)
    azimuth, elevation = to_azel(*in_frames(node[None, None], a.position, a.rotation))
    u = to_unit(wrap(azimuth[0] + e[0]), elevation[0] + e[1])
    xy = on_plane(u[None], a, float(node[2]), np.deg2rad(0.1))[0]
    return np.clip(xy, 0.0, ROOM) if clip else xy


def normal_errors(n: int, anchors: int) -> np.ndarray:
    """Angle errors (2, n, anchors) rad of 10 deg, the same for every point."""
    return np.deg2rad(10.0) * np.random.default_rng(2024).standard_normal((2, n, anchors))


def fig3a(scale: str) -> pd.DataFrame:
    """Position samples of a node at (8.5, 3.0) m from B alone and from the mean of A and B,
    unclipped, and 95th percentiles of their errors.
    """
    n = 10_000 if scale == "quick" else 1_000_000
    node, rows = np.array([8.5, 3.0, 0.0]), []
    pair = standard_room().position[0, 0, :2]
    for clip in (False, True):
        xy = single_positions(node, pair, normal_errors(n, 2), clip)
        for name, found in (("B", xy[:, 1]), ("mean of A and B", xy.mean(axis=1))):
            q95 = statistics.quantile(np.hypot(*(found - node[:2]).T), 0.95)
            q95 = q95.columns("q95_m", "q95_se")
            rows.append(
                {"kind": "clipped" if clip else "unclipped", "who": name, "samples": n, **q95}
            )
            if not clip:
                rows += [
                    {"kind": "sample", "who": name, "x_m": p, "y_m": q} for p, q in found[:400]
                ]
    return pd.DataFrame(rows)


def fig3b(scale: str) -> pd.DataFrame:
    """RMSE of C alone and of the mean of A and B over the room, positions clipped to it, with
    standard errors.
    """
    n, step = (2_000, 1.0) if scale == "quick" else (1_000_000, 0.5)
    errors, side, rows = normal_errors(n, 3), np.arange(step / 2, ROOM, step), []
    anchors = standard_room().position[0, 0]
    for x in side:
        for y in side:
            squares = []
            for part in np.array_split(errors, max(n // 50_000, 1), axis=1):
                xy = single_positions(np.array([x, y, 0.0]), anchors, part, clip=True)
                pair = np.stack([xy[:, 2], xy[:, :2].mean(axis=1)], axis=1)
                squares.append(((pair - [x, y]) ** 2).sum(axis=-1))
            square = np.concatenate(squares)
            found = [statistics.pooled_rmse(np.sqrt(square[:, i])) for i in (0, 1)]
            rows.append((x, y, found[0].value, found[0].se, found[1].value, found[1].se))
    return pd.DataFrame(rows, columns=["x_m", "y_m", "single_m", "single_se", "pair_m", "pair_se"])


def fig3c(scale: str) -> pd.DataFrame:
    """CDF of the mean of A and B over the room for separations of 1 to 9 m, and of C alone
    (separation 0).
    """
    n, step = (100, 1.0) if scale == "quick" else (2_000, 0.25)
    side, errors = np.arange(step / 2, ROOM, step), normal_errors(n, 2)
    rows = []
    for apart in range(10):
        pair = np.array([[5 - apart / 2, 5.0, 3.0], [5 + apart / 2, 5.0, 3.0]])
        count, total = np.zeros(len(ERRORS)), 0
        for x in side:
            for y in side:
                xy = single_positions(np.array([x, y, 0.0]), pair, errors, clip=True)
                mean = xy[:, 0] if apart == 0 else xy.mean(axis=1)
                e = np.sort(np.hypot(*(mean - [x, y]).T))
                count, total = count + np.searchsorted(e, ERRORS, side="right"), total + n
        rows += [
            {"separation_m": apart, "error_m": a, "cdf": c / total} for a, c in zip(ERRORS, count)
        ]
    return pd.DataFrame(rows)


def rule(scale: str) -> pd.DataFrame:
    """(9), (40): RMSE of the mean of one estimate from A and beta from B over that of A alone,
    against the deviations' ratio; by samples and in closed form."""
    n = 20_000 if scale == "quick" else 1_000_000
    rng = np.random.default_rng(9)
    a, b = rng.standard_normal((2, n, 2))
    rows = []
    for gamma in np.round(np.arange(1.0, 2.51, 0.05), 2):
        mean = (a + gamma * b) / 2
        rows.append(
            {
                "gamma": gamma,
                "samples": n,
                **columns(ratio=statistics.ratio((mean**2).sum(-1), (a**2).sum(-1)).root()),
                "closed": np.sqrt(1 + gamma**2) / 2,
            }
        )
    return pd.DataFrame(rows)
