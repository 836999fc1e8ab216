"""Figures 2 and 3 and the rule of the square root of three: one anchor, or the mean of two."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from scipy import optimize

from aoabench import bounds
from aoabench.estimators.lines import nearest_point
from aoabench.estimators.rays import rays
from aoabench.maths import statistics
from aoabench.maths.geometry import in_frames, to_azel
from aoabench.types import Batch

from .common import ERRORS, columns, in_threads
from .floor import ROOM, Turns, floor_of, normal_errors, single_positions, standard_room, upright

PART = 8192  # samples at once, few enough for the processor's cache
GAMMAS = np.round(np.arange(1.0, 2.51, 0.05), 2)  # ratios of B's deviation to A's
LAYOUTS = {
    f"{number} anchor{'s' * (i > 0)}": f"_{i + 1}"
    for i, number in enumerate(("one", "two", "three", "four"))
}


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


def fig3a(scale: str) -> pd.DataFrame:
    """Position samples of a node at (8.5, 3.0) m from B alone and from the mean of A and B,
    unclipped, and 95th percentiles of their errors.
    """
    n = 10_000 if scale == "quick" else 1_000_000
    node, rows = np.array([8.5, 3.0, 0.0]), []
    pair, turns = standard_room().position[0, 0, :2], Turns.of(normal_errors(n, 2))
    for clip in (False, True):
        xy = single_positions(node, pair, turns, clip)
        for name, found in (("B", xy[:, 1]), ("mean of A and B", xy.mean(axis=1))):
            q95 = statistics.quantile(np.hypot(found[0] - node[0], found[1] - node[1]), 0.95)
            q95 = q95.columns("q95_m", "q95_se")
            rows.append(
                {"kind": "clipped" if clip else "unclipped", "who": name, "samples": n, **q95}
            )
            if not clip:
                rows += [
                    {"kind": "sample", "who": name, "x_m": p, "y_m": q} for p, q in found[:, :400].T
                ]
    return pd.DataFrame(rows)


def fig3b(scale: str) -> pd.DataFrame:
    """RMSE of C alone and of the mean of A and B over the room, positions clipped to it, with
    standard errors.
    """
    n, step = (2_000, 1.0) if scale == "quick" else (1_000_000, 0.5)
    room, anchors = floor_of(step), standard_room().position[0, 0]
    errors = normal_errors(n, 3)
    parts = np.array_split(errors, -(-n // PART), axis=1)
    sums = sum(in_threads(lambda part: _powers(room, anchors, Turns.of(part)), parts))
    rows = []
    for (x, y, _), each in zip(room, sums):
        row = {"x_m": x, "y_m": y}
        for name, powers in zip(("single", "pair"), each):
            rmse = statistics.mean_of_sums(errors.shape[1], *powers).root()
            row |= rmse.columns(f"{name}_m", f"{name}_se")
        rows.append(row)
    return pd.DataFrame(rows)


def _powers(room: np.ndarray, anchors: np.ndarray, turns: Turns) -> np.ndarray:
    """Sums over samples of the first three powers of the squared errors of C alone and of the mean
    of A and B at the points `room` (P, 3) m: (P, 2, 3).
    """
    found = np.empty((len(room), 2, 3))
    for node, sums in zip(room, found):
        away = single_positions(node, anchors, turns, clip=True) - node[:2, None, None]
        for (x, y), powers in zip((away[:, 2], (away[:, 0] + away[:, 1]) / 2), sums):
            square = x * x + y * y
            powers[:] = square.sum(), (square**2).sum(), (square * square**2).sum()
    return found


def fig3c(scale: str) -> pd.DataFrame:
    """CDF of the mean of A and B over the room for separations of 1 to 9 m, and of C alone
    (separation 0); `more` is the CDF minus that of C alone. Standard errors are over the draws,
    which all points share.
    """
    n, step = (100, 1.0) if scale == "quick" else (2_000, 0.25)
    room, turns = floor_of(step), Turns.of(normal_errors(n, 2))
    shares = in_threads(lambda apart: _shares(room, apart, turns), range(10))
    rows = []
    for apart, share in enumerate(shares):
        for limit, own, more in zip(ERRORS, share.T, (share - shares[0]).T):
            found = columns(cdf=statistics.mean(own), more=statistics.mean(more))
            rows.append({"separation_m": apart, "error_m": limit, "samples": n, **found})
    return pd.DataFrame(rows)


def _shares(room: np.ndarray, apart: float, turns: Turns) -> np.ndarray:
    """Share of the points (P, 3) m with an error up to each of ERRORS, for each of N draws of the
    angle errors: (N, len(ERRORS)). The estimate is the mean from two anchors that lie `apart` m
    from one another, for 0 that of the one at C.
    """
    pair = np.array([[5 - apart / 2, 5.0, 3.0], [5 + apart / 2, 5.0, 3.0]])
    shape = turns.sin.shape[2], len(ERRORS) + 1
    first = shape[1] * np.arange(shape[0])  # of each draw's counts of errors between the limits
    count = np.zeros(shape[0] * shape[1], dtype=int)
    for node in room:
        xy = single_positions(node, pair, turns, clip=True)
        x, y = (xy[:, 0] if apart == 0 else xy.mean(axis=1)) - node[:2, None]
        count[first + np.searchsorted(ERRORS, np.hypot(x, y))] += 1
    return np.asarray(np.cumsum(count.reshape(shape), axis=1)[:, :-1] / len(room))


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
        a, b = (rng.standard_normal((n, k, 2)).mean(axis=1).T.copy() for k in (of_a, of_b))
        rows += in_threads(partial(_mean_of_both, of_a, a, of_b, b), GAMMAS)
    return pd.DataFrame(rows + _nearest_to_both(rng, n // 10))


def _mean_of_both(
    of_a: int, a: np.ndarray, of_b: int, b: np.ndarray, gamma: float
) -> dict[str, Any]:
    """A row `mean` of `rule` from the means a and b (2, N) of `of_a` and `of_b` estimates."""
    beta = of_b / of_a
    both = (of_a * a + of_b * gamma * b) / (of_a + of_b)
    closed = np.sqrt(1 + beta * gamma**2) / (1 + beta)
    return _ratio("mean", beta, gamma, both, a) | {"closed": closed}


def _nearest_to_both(rng: np.random.Generator, n: int) -> list[dict[str, Any]]:
    """Rows `ls` of `rule`: a node in the middle between A and B, angle deviations of 1 deg at A."""
    node, places = np.array([5.0, 5.0, 0.0]), standard_room().position[0, 0, :2]
    anchors = upright(places)
    true = to_azel(*in_frames(node[None, None], anchors.position, anchors.rotation))
    normal = np.deg2rad(1.0) * rng.standard_normal((2, n, 2))
    turns = Turns.of(normal)
    alone = single_positions(node, places, turns, clip=False)[:, 0] - node[:2, None]
    rows = []
    for gamma in GAMMAS:
        angles = [t[0] + e * [1.0, gamma] for t, e in zip(true, normal)]
        batch = Batch(angles[0][None], angles[1][None], anchors)
        both = nearest_point(rays(batch), batch.anchors.position).position[0, :, :2] - node[:2]
        rows.append(_ratio("ls", 1.0, gamma, both.T, alone) | {"closed": np.nan})
    return rows


def _ratio(
    kind: str, beta: float, gamma: float, both: np.ndarray, alone: np.ndarray
) -> dict[str, Any]:
    """A row of `rule` from errors (2, N)."""
    ratio = statistics.ratio((both**2).sum(axis=0), (alone**2).sum(axis=0)).root()
    row = {"kind": kind, "beta": beta, "gamma": gamma, "samples": both.shape[1]}
    return row | columns(ratio=ratio)
