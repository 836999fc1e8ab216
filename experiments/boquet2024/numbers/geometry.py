"""Figures 2 and 3 and the rule of the square root of three: one anchor, or the mean of two."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from scipy import optimize

from aoabench import bounds
from aoabench.config.compose import compose_cells
from aoabench.estimators.lines import nearest_point
from aoabench.estimators.plane import on_plane
from aoabench.estimators.rays import rays
from aoabench.maths import statistics
from aoabench.maths.geometry import in_frames, to_azel, to_unit, wrap
from aoabench.types import Anchors, Batch

from .common import ERRORS, columns

ROOM = 10.0  # m, the sides of the standard room
GAMMAS = np.round(np.arange(1.0, 2.51, 0.05), 2)  # ratios of B's deviation to A's
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
            row = {"x_m": x, "y_m": y}
            for name, each in zip(("single", "pair"), square.T):
                rmse = statistics.pooled_rmse(np.sqrt(each))
                row |= rmse.columns(f"{name}_m", f"{name}_se")
            rows.append(row)
    return pd.DataFrame(rows)


def fig3c(scale: str) -> pd.DataFrame:
    """CDF of the mean of A and B over the room for separations of 1 to 9 m, and of C alone
    (separation 0); `more` is the CDF minus that of C alone. Standard errors are over the draws,
    which all points share.
    """
    n, step = (100, 1.0) if scale == "quick" else (2_000, 0.25)
    side, errors = np.arange(step / 2, ROOM, step), normal_errors(n, 2)
    room = [np.array([x, y, 0.0]) for x in side for y in side]
    alone, rows = None, []
    for apart in range(10):
        share = _shares(room, apart, errors)
        alone = share if alone is None else alone
        for limit, own, more in zip(ERRORS, share.T, (share - alone).T):
            found = columns(cdf=statistics.mean(own), more=statistics.mean(more))
            rows.append({"separation_m": apart, "error_m": limit, "samples": n, **found})
    return pd.DataFrame(rows)


def _shares(room: list[np.ndarray], apart: float, errors: np.ndarray) -> np.ndarray:
    """Share of the points with an error up to each of ERRORS, for each draw of the angle errors
    (2, N, 2): (N, len(ERRORS)). The estimate is the mean from two anchors that lie `apart` m from
    one another, for 0 that of the one at C.
    """
    pair = np.array([[5 - apart / 2, 5.0, 3.0], [5 + apart / 2, 5.0, 3.0]])
    count = np.zeros((errors.shape[1], len(ERRORS)))
    for node in room:
        xy = single_positions(node, pair, errors, clip=True)
        found = xy[:, 0] if apart == 0 else xy.mean(axis=1)
        count += np.hypot(*(found - node[:2]).T)[:, None] <= ERRORS
    return count / len(room)


def rule(scale: str) -> pd.DataFrame:
    """RMSE of an estimate from the anchors A and B over that from A alone, against the ratio gamma
    of their deviations.

    `kind` mean: the mean of estimates from A and beta times as many from B (9), by samples and in
    closed form (40); ls: M_LS with a ray from each of two anchors at equal distances.
    """
    n = 20_000 if scale == "quick" else 1_000_000
    rng = np.random.default_rng(9)
    rows = []
    for of_a, of_b in ((2, 1), (1, 1), (1, 2), (1, 3)):
        a = rng.standard_normal((n, of_a, 2)).mean(axis=1)
        b = rng.standard_normal((n, of_b, 2)).mean(axis=1)
        beta = of_b / of_a
        for gamma in GAMMAS:
            both = (of_a * a + of_b * gamma * b) / (of_a + of_b)
            closed = np.sqrt(1 + beta * gamma**2) / (1 + beta)
            rows.append(_ratio("mean", beta, gamma, both, a) | {"closed": closed})
    return pd.DataFrame(rows + _nearest_to_both(rng, n // 10))


def _nearest_to_both(rng: np.random.Generator, n: int) -> list[dict[str, Any]]:
    """Rows `ls` of `rule`: a node in the middle between A and B, angle deviations of 1 deg at A."""
    node, places = np.array([5.0, 5.0, 0.0]), standard_room().position[0, 0, :2]
    anchors = upright(places)
    true = to_azel(*in_frames(node[None, None], anchors.position, anchors.rotation))
    normal = np.deg2rad(1.0) * rng.standard_normal((2, n, 2))
    alone = single_positions(node, places, normal, clip=False)[:, 0] - node[:2]
    rows = []
    for gamma in GAMMAS:
        angles = [t[0] + e * [1.0, gamma] for t, e in zip(true, normal)]
        batch = Batch(angles[0][None], angles[1][None], anchors)
        both = nearest_point(rays(batch), batch.anchors.position).position[0, :, :2] - node[:2]
        rows.append(_ratio("ls", 1.0, gamma, both, alone) | {"closed": np.nan})
    return rows


def _ratio(
    kind: str, beta: float, gamma: float, both: np.ndarray, alone: np.ndarray
) -> dict[str, Any]:
    """A row of `rule` from errors (N, 2)."""
    ratio = statistics.ratio((both**2).sum(-1), (alone**2).sum(-1)).root()
    row = {"kind": kind, "beta": beta, "gamma": gamma, "samples": len(both)}
    return row | columns(ratio=ratio)
