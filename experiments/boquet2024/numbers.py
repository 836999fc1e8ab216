"""Boquet et al. 2024: the numbers behind each figure, one function per item, each giving one frame.

A replication is a campaign with a channel of its own, so standard errors are over campaigns; what
needs a quantile of all fixes leaves out one campaign at a time (jackknife). Errors are horizontal.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml
from scipy import optimize

from aoabench import bounds
from aoabench.config.compose import compose_cells
from aoabench.engine.tiles import Draws, estimate_tile
from aoabench.estimators.plane import on_plane
from aoabench.maths import statistics
from aoabench.maths.geometry import in_frames, to_azel, to_unit, wrap
from aoabench.maths.statistics import Estimate
from aoabench.store.fixes import Fixes
from aoabench.types import Anchors

Runs = Iterable[tuple[Any, dict[str, Fixes]]]  # a cell and the fixes of each of its estimators
METHODS = (
    "single_anchor_1",
    "single_anchor_2",
    "single_anchor_3",
    "best_anchor",
    "rssi_anchor",
    "anchor_mean",
    "ls_lines",
    "ls_anchor_discarding",
    "vmf_ml",
)
SCORED = (
    "anchor_mean",
    "ls_lines",
    "ls_anchor_discarding",
    "vmf_ml",
)  # those that tell how badly anchors agree
ERRORS = np.round(np.arange(0.0, 6.01, 0.05), 2)  # m, where distribution functions are told


def printed_grids() -> dict[str, np.ndarray]:
    """Printed medians (42,) m of Figure 8, in the order of the scenario's points."""
    nodes = yaml.safe_load((Path(__file__).parent / "grids.yaml").read_text(encoding="utf-8"))
    return {name: np.array(rows)[::-1].ravel() for name, rows in nodes.items()}


# --- statistics over campaigns (R, T) -------------------------------------------------------------


def error(f: Fixes) -> np.ndarray:
    """Horizontal errors (R, T) m; NaN where there is no fix."""
    return f.error_xy_m.astype(float)


def within(e: np.ndarray, limit_m: float = 1.0) -> Estimate:
    """Share of the given fixes (R, T) whose error is at most `limit_m`."""
    return statistics.ratio((e <= limit_m).sum(axis=1), np.isfinite(e).sum(axis=1))


def jackknife(e: np.ndarray, number: Callable[[np.ndarray], float]) -> Estimate:
    """A number of all errors (R, T), with its standard error from leaving out each campaign in
    turn.
    """
    whole, left = number(e), np.array([number(np.delete(e, i, axis=0)) for i in range(len(e))])
    return Estimate(
        whole, float(np.sqrt((len(e) - 1) / len(e) * ((left - left.mean()) ** 2).sum()))
    )


def rms(e: np.ndarray) -> float:
    """Root mean square of the given errors."""
    return float(np.sqrt(np.nanmean(e**2)))


def lost(f: Fixes) -> Estimate:
    """R_d, the share of fixes that are rejected, among those for which anything was measured."""
    tried = f.outcome != 4
    return statistics.ratio((f.outcome == 1).sum(axis=1), tried.sum(axis=1))


def discarded(f: Fixes, all_of_them: Fixes) -> Estimate:
    """The other reading of R_d: the share of measurements that no fix rests on."""
    there = all_of_them.anchors_used.sum(axis=1)
    return statistics.ratio(there - np.nan_to_num(f.anchors_used).sum(axis=1), there)


def medians(e: np.ndarray, points: int) -> np.ndarray:
    """Each campaign's median error (R, P) m at each point; NaN where all its fixes are rejected."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        return np.nanmedian(e.reshape(len(e), points, -1), axis=2)


def filters(fixes: dict[str, Fixes], kind: str = "boxes") -> dict[float, Fixes]:
    """The discrepancy filters of a run by R_sigma; df_boxes_04 is that of 0.4."""
    return {int(name[-2:]) / 10: f for name, f in fixes.items() if name.startswith(f"df_{kind}_")}


def only(runs: Runs) -> tuple[Any, dict[str, Fixes]]:
    """The one cell of a run."""
    return next(iter(runs))


# --- Figure 2 -------------------------------------------------------------------------------------

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
    return compose_cells(words)[0].scenario.known_anchors


def upright(position: np.ndarray) -> Anchors:
    """Anchors (B, 3) m whose frames are the global one."""
    return Anchors(position[None], np.broadcast_to(np.eye(3), (1, len(position), 3, 3)))


def fig2(scale: str) -> pd.DataFrame:
    """GDOP in m at z = 0 over the room for each layout, and what the text says of the single
    anchor.
    """
    step = 0.25 if scale == "quick" else 0.1
    side = np.arange(step / 2, ROOM, step)
    x, y = (a.ravel() for a in np.meshgrid(side, side))
    rows = []
    for name, which in LAYOUTS.items():
        g = bounds.gdop(np.stack([x, y, 0 * x], axis=-1), standard_room(which), known_z=True)
        rows += [{"layout": name, "x_m": a, "y_m": b, "gdop_m": v} for a, b, v in zip(x, y, g)]

    one = standard_room("_1")

    def single(away: float) -> float:
        return float(bounds.gdop(np.array([5.0 + away, 5.0, 0.0]), one, known_z=True))

    least = optimize.minimize_scalar(
        single, bounds=(1e-4, 5.0), method="bounded", options={"xatol": 1e-6}
    )
    root3 = optimize.brentq(lambda away: single(away) - np.sqrt(3) * single(1e-4), 0.1, 5.0)
    rows += [
        {"layout": "minimum", "x_m": least.x, "y_m": np.nan, "gdop_m": least.fun},
        {"layout": "sqrt 3", "x_m": root3, "y_m": np.nan, "gdop_m": single(root3)},
    ]
    return pd.DataFrame(rows)


# --- Figure 3 -------------------------------------------------------------------------------------


def single_positions(
    node: np.ndarray, anchors: np.ndarray, e: np.ndarray, clip: bool
) -> np.ndarray:
    """Positions (N, B, 2) m from each anchor (B, 3) by itself for a node (3,) and angle errors e
    (2, N, B) rad.
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
    """Samples at (8.5, 3.0) m from B and of the mean of A and B, unclipped; and 95th percentiles of
    their errors.
    """
    n = 10_000 if scale == "quick" else 1_000_000
    node, rows = np.array([8.5, 3.0, 0.0]), []
    pair = standard_room().position[0, :2]
    for clip in (False, True):
        xy = single_positions(node, pair, normal_errors(n, 2), clip)
        for name, found in (("B", xy[:, 1]), ("mean of A and B", xy.mean(axis=1))):
            e = np.hypot(*(found - node[:2]).T)
            rows.append(
                {"kind": "clipped" if clip else "unclipped", "who": name, "samples": n, **q95(e)}
            )
            if not clip:
                rows += [
                    {"kind": "sample", "who": name, "x_m": p, "y_m": q} for p, q in found[:400]
                ]
    return pd.DataFrame(rows)


def q95(e: np.ndarray) -> dict[str, float]:
    """95th percentile of errors (N,) m with its standard error."""
    q = statistics.quantile(e, 0.95)
    return {"q95_m": q.value, "q95_se": q.se}


def fig3b(scale: str) -> pd.DataFrame:
    """RMSE of C alone and of the mean of A and B over the room, positions clipped to it, with
    standard errors.
    """
    n, step = (2_000, 1.0) if scale == "quick" else (1_000_000, 0.5)
    errors, side, rows = normal_errors(n, 3), np.arange(step / 2, ROOM, step), []
    anchors = standard_room().position[0]
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
        q = statistics.ratio((mean**2).sum(-1), (a**2).sum(-1))
        rows.append(
            {
                "gamma": gamma,
                "samples": n,
                "ratio": np.sqrt(q.value),
                "ratio_se": q.se / (2 * np.sqrt(q.value)),
                "closed": np.sqrt(1 + gamma**2) / 2,
            }
        )
    return pd.DataFrame(rows)


# --- Figures 5 and 6 ------------------------------------------------------------------------------


def curve(name: str, e: np.ndarray, **more: Any) -> list[dict[str, Any]]:
    """Rows of the distribution function of the given errors (R, T), with standard errors over
    campaigns.
    """
    n = np.isfinite(e).sum(axis=1)
    found = [statistics.ratio((e <= limit).sum(axis=1), n) for limit in ERRORS]
    return [
        {
            "method": name,
            "error_m": limit,
            "cdf": p.value,
            "cdf_se": p.se,
            "fixes": int(n.sum()),
            **more,
        }
        for limit, p in zip(ERRORS, found)
    ]


def fig5(runs: Runs) -> pd.DataFrame:
    """CDFs of the discrepancy filter for each R_sigma, and with its second stage left out (R_sigma
    NaN).
    """
    _, fixes = only(runs)
    rows = []
    for r, f in filters(fixes).items():
        rows += curve(f"df {r:g}", error(f), r_sigma=r, lost=lost(f).value)
    return pd.DataFrame(
        rows + curve("no vote", error(fixes["df_without_vote"]), r_sigma=np.nan, lost=0.0)
    )


def fig6(runs: Runs) -> pd.DataFrame:
    """RMSE, CEP90, P(error <= 1 m) and both discard ratios against R_sigma; and their steps between
    R_sigmas.
    """
    _, fixes = only(runs)
    found, rows, before = filters(fixes), [], None
    for r in sorted(found):
        f = found[r]
        numbers = {
            "rmse_m": jackknife(error(f), rms),
            "cep90_m": jackknife(error(f), lambda e: float(np.nanquantile(e, 0.9))),
            "within_1m": within(error(f)),
            "lost": lost(f),
            "discarded": discarded(f, fixes["df_without_vote"]),
        }
        row = {"r_sigma": r, "fixes": int(np.isfinite(error(f)).sum()), "campaigns": len(f.outcome)}
        for key, value in numbers.items():
            row |= {key: value.value, f"{key}_se": value.se}
        if before is not None:  # paired: the same packets
            step = statistics.mean(
                np.mean((before.outcome == 1).astype(float) - (f.outcome == 1), axis=1)
            )
            row |= {"lost_less": step.value, "lost_less_se": step.se}
        rows.append(row)
        before = f
    return pd.DataFrame(rows)


# --- Figure 7 -------------------------------------------------------------------------------------


def difference(a: np.ndarray, b: np.ndarray, limit_m: float = 1.0) -> Estimate:
    """P(error <= limit) of errors a minus that of errors b (R, T), paired over campaigns (delta
    method).
    """
    parts = []
    for e in (a, b):
        hit, n = (e <= limit_m).sum(axis=1).astype(float), np.isfinite(e).sum(axis=1).astype(float)
        parts.append((hit.sum() / n.sum(), (hit - hit.sum() / n.sum() * n) / n.mean()))
    influence = parts[0][1] - parts[1][1]
    R = len(influence)
    se = float(influence.std(ddof=1) / np.sqrt(R)) if R > 1 else float("nan")
    return Estimate(float(parts[0][0] - parts[1][0]), se)


def at_lost(fixes: dict[str, Fixes], share: float) -> tuple[float, Fixes]:
    """The discrepancy filter whose R_d is nearest to a share, and its R_sigma."""
    found = filters(fixes)
    r = min(found, key=lambda r: abs(lost(found[r]).value - share))
    return r, found[r]


def fig7(runs: Runs) -> pd.DataFrame:
    """CDFs of all methods, the discrepancy filter in three readings, and each method on the fixes
    that those accept.
    """
    _, fixes = only(runs)
    df = {"df R_sigma = 1": filters(fixes)[1.0], "df R_sigma = 0.2": filters(fixes)[0.2]}
    r, f = at_lost(fixes, 0.2)
    df[f"df R_d = 0.2 (R_sigma = {r:g})"] = f
    rows = []
    for name, f in (*((m, fixes[m]) for m in METHODS), *df.items()):
        e = error(f)
        rows += curve(name, e, on="own fixes")
        if name not in df:
            for other, g in df.items():
                rows += curve(name, np.where(np.isfinite(error(g)), e, np.nan), on=other)
    return pd.DataFrame(rows)


def ranking(runs: Runs) -> pd.DataFrame:
    """P(error <= 1 m) of each method minus that of others, paired over campaigns.

    `at`: `all` (each on its own fixes), `accepted` (both on the fixes that the filter gives),
    `coverage` (the method rejects the fixes of the worst score until it gives as many as the
    filter).
    """
    _, fixes = only(runs)
    rows = []

    def add(at: str, name: str, other: str, a: np.ndarray, b: np.ndarray) -> None:
        d = difference(a, b)
        share = np.isfinite(a).mean()
        rows.append(
            {
                "at": at,
                "method": name,
                "other": other,
                "more": d.value,
                "more_se": d.se,
                "coverage": share,
            }
        )

    for r, f in filters(fixes).items():
        e = error(f)
        for m in METHODS:
            other = error(fixes[m])
            add("all", f"df {r:g}", m, e, other)
            add("accepted", f"df {r:g}", m, e, np.where(np.isfinite(e), other, np.nan))
            if m in SCORED:
                add("coverage", f"df {r:g}", m, e, thresholded(fixes[m], np.isfinite(e).mean()))
    for m in METHODS:
        for other in METHODS:
            if m != other:
                add("all", m, other, error(fixes[m]), error(fixes[other]))
    return pd.DataFrame(rows)


def thresholded(f: Fixes, coverage: float) -> np.ndarray:
    """Errors (R, T) with the fixes of the worst scores rejected, so that this share of all is
    given.

    A fix without a score (one anchor alone) counts as the worst: nothing vouches for it.
    """
    e = error(f)
    score = np.where(np.isfinite(f.score), f.score, np.inf)
    score = np.where(np.isfinite(e), score, np.nan)
    order = np.sort(score[np.isfinite(e)])
    keep = min(round(coverage * e.size), len(order))
    return np.where(score <= order[max(keep - 1, 0)], e, np.nan)


def rejection(runs: Runs) -> pd.DataFrame:
    """P(error <= 1 m) and RMSE against coverage: scores thresholded, and the discrepancy filter's
    R_sigma sweep.
    """
    _, fixes = only(runs)
    rows = []

    def add(name: str, e: np.ndarray, r: float = np.nan) -> None:
        p, given = within(e), np.isfinite(e).mean(axis=1)
        c, q = statistics.mean(given), jackknife(e, rms)
        rows.append(
            {
                "method": name,
                "r_sigma": r,
                "coverage": c.value,
                "coverage_se": c.se,
                "within_1m": p.value,
                "within_1m_se": p.se,
                "rmse_m": q.value,
                "rmse_se": q.se,
            }
        )

    for m in METHODS:
        for coverage in np.round(np.arange(0.1, 1.01, 0.05), 2) if m in SCORED else (1.0,):
            add(m, thresholded(fixes[m], coverage) if m in SCORED else error(fixes[m]))
    for kind in ("boxes", "exact"):
        for r, f in filters(fixes, kind).items():
            add(f"df {kind}", error(f), r)
    return pd.DataFrame(rows)


# --- Figure 8 -------------------------------------------------------------------------------------


def fig8(runs: Runs) -> pd.DataFrame:
    """Per method and point: the median error as a mean over campaigns, its standard error and its
    spread from campaign to campaign (5 and 95 %), and the printed one."""
    cell, fixes = only(runs)
    points = np.array(cell.scenario.points_m)
    printed = printed_grids()
    shown = {m: fixes[m] for m in METHODS} | {"discrepancy": filters(fixes)[1.0]}
    rows = []
    for name, f in shown.items():
        m = medians(error(f), len(points))
        for i, (x, y) in enumerate(points):
            each = m[:, i][np.isfinite(m[:, i])]
            found = statistics.mean(each)
            low, high = np.quantile(each, [0.05, 0.95]) if len(each) else (np.nan, np.nan)
            rows.append(
                {
                    "method": name,
                    "x_m": x,
                    "y_m": y,
                    "median_m": found.value,
                    "median_se": found.se,
                    "low_m": low,
                    "high_m": high,
                    "printed_m": printed[name][i] if name in printed else np.nan,
                    "unnamed_m": printed["unnamed"][i]
                    if name in ("ls_anchor_discarding", "rssi_anchor")
                    else np.nan,
                }
            )
    return pd.DataFrame(rows)


# --- what the synthetic campaign was fitted to ----------------------------------------------------

DAYS = {
    "azimuth_mean": (3.2, 1.3),
    "azimuth_sd": (8.1, 2.3),
    "elevation_mean": (4.7, 5.9),
    "elevation_sd": (11.1, 8.2),
}
SWEEP = {0.4: (0.86, 0.52), 2.0: (0.69, 0.10)}  # R_sigma: P(error <= 1 m), R_d


def day_statistics(
    scenario: Any, noise: Any, seed: int, first: int, count: int
) -> dict[str, np.ndarray]:
    """Mean size and standard deviation of the first anchor's angle errors in deg, (campaigns, days)
    each.

    The mean of a campaign's day over the room, its size (the paper's are "average errors" of ten
    places).
    """
    found: dict[str, list[list[float]]] = {key: [] for key in DAYS}
    draws = Draws(scenario, noise, seed)
    a, days = scenario.known_anchors, scenario.days_of
    for r in range(first, first + count):
        truth, batch = draws.tile(r, 1)
        true = to_azel(*in_frames(truth[..., :3], a.position, a.rotation))
        for key, measured, straight in zip(
            ("azimuth", "elevation"), (batch.azimuth, batch.elevation), true
        ):
            e = np.rad2deg(wrap(measured[0, :, 0] - straight[0, :, 0]))
            found[f"{key}_mean"].append([abs(np.nanmean(e[days == d])) for d in (0, 1)])
            found[f"{key}_sd"].append([np.nanstd(e[days == d]) for d in (0, 1)])
    return {key: np.array(value) for key, value in found.items()}


def misfits(
    fixes: dict[str, Fixes], days: dict[str, np.ndarray], points: int
) -> Iterator[dict[str, Any]]:
    """A row per printed number that the noise is fitted to: printed, ours with its standard error
    over campaigns, and the misfit in units of `tolerance`, which weighs the fit."""
    for r, (p, share) in SWEEP.items():
        f = filters(fixes)[r]
        yield _misfit(
            f"P(error <= 1 m) at R_sigma = {r:g}", f"within/{r:g}", p, within(error(f)), 0.02
        )
        yield _misfit(f"R_d at R_sigma = {r:g}", f"lost/{r:g}", share, lost(f), 0.02)
    for key, printed in DAYS.items():
        for d, value in enumerate(printed):
            ours = statistics.mean(days[key][:, d])
            yield _misfit(
                f"{key.replace('_', ' ')}, day {d + 1} [deg]",
                f"days/{key}/{d + 1}",
                value,
                ours,
                1.5,
            )
    for name, grid in printed_grids().items():
        if name in fixes:
            m = medians(error(fixes[name]), points)
            yield _misfit(
                f"mean of {name}'s medians [m]",
                f"grid/{name}",
                grid.mean(),
                statistics.mean(np.nanmean(m, 1)),
                0.1,
            )
            off, inside = (
                jackknife(m, partial(_log_ratio, grid)),
                jackknife(m, partial(_inside, grid)),
            )
            for key, what, ours in (
                ("ratio", f"root mean square log ratio to {name}'s grid", off),
                ("inside", f"share of {name}'s grid within 5..95 % of our campaigns", inside),
            ):
                yield {"what": what, "id": f"{key}/{name}", "ours": ours.value, "se": ours.se}


def _log_ratio(grid: np.ndarray, m: np.ndarray) -> float:
    """Root mean square log ratio of the mean campaign median (R, P) to a printed grid (P,)."""
    return float(np.sqrt(np.nanmean(np.log(np.nanmean(m, axis=0) / grid) ** 2)))


def _inside(grid: np.ndarray, m: np.ndarray) -> float:
    """Share of a printed grid (P,) within the middle 90 % of campaigns' medians (R, P)."""
    return float(
        np.mean(
            (grid >= np.nanquantile(m, 0.05, axis=0)) & (grid <= np.nanquantile(m, 0.95, axis=0))
        )
    )


def _misfit(
    what: str, key: str, printed: float, ours: Estimate, tolerance: float
) -> dict[str, Any]:
    off = (ours.value - printed) / tolerance
    return {
        "what": what,
        "id": key,
        "printed": printed,
        "ours": ours.value,
        "se": ours.se,
        "misfit": off,
    }


def misfit(runs: Runs) -> pd.DataFrame:
    """What `misfits` says of campaigns that the fit has not seen."""
    cell, fixes = only(runs)
    count = len(fixes["vmf_ml"].outcome)
    days = day_statistics(cell.scenario, cell.noise, cell.seed, 0, count)
    return pd.DataFrame(list(misfits(fixes, days, len(cell.scenario.points_m))))


# --- boxes and exact, errata, time ----------------------------------------------------------------


def boxes(runs: Runs) -> pd.DataFrame:
    """Boxes against exact ellipses per R_sigma: how often outcome or number of anchors differ, and
    what each gives.
    """
    _, fixes = only(runs)
    exact, rows = filters(fixes, "exact"), []
    for r, f in filters(fixes).items():
        if r not in exact:
            continue
        g = exact[r]
        other = (f.outcome != g.outcome) | (f.anchors_used != g.anchors_used)
        moved = other | (np.abs(error(f) - error(g)) > 1e-4)
        row = {"r_sigma": r}
        values = {
            "other_set": statistics.mean(other.mean(axis=1)),
            "other_position": statistics.mean(moved.mean(axis=1)),
        }
        for kind, h in (("boxes", f), ("exact", g)):
            values |= {
                f"within_1m_{kind}": within(error(h)),
                f"lost_{kind}": lost(h),
                f"rmse_{kind}_m": jackknife(error(h), rms),
            }
        values["more"] = difference(error(g), error(f))
        for key, value in values.items():
            row |= {key: value.value, f"{key}_se": value.se}
        rows.append(row)
    return pd.DataFrame(rows)


def errata(runs: Runs) -> pd.DataFrame:
    """What each erratum does alone at R_sigma = 1: P(error <= 1 m) put right minus as the paper ran
    it, in percent points, and the share of the packets that it moves."""
    _, fixes = only(runs)
    ran = filters(fixes)[1.0]
    rows = []
    for name in ("df_area_of_ties", "df_centre_of_estimate"):
        f = fixes[name]
        d = difference(error(f), error(ran))
        moved = np.abs(error(ran) - error(f)) > 1e-4
        moved |= ran.outcome != f.outcome
        m = statistics.mean(moved.mean(axis=1))
        rows.append(
            {
                "variant": name,
                "more": 100 * d.value,
                "more_se": 100 * d.se,
                "moved": 100 * m.value,
                "moved_se": 100 * m.se,
            }
        )
    return pd.DataFrame(rows)


def speed(scale: str) -> pd.DataFrame:
    """Time per fix of every method on this machine, serially: median of several passes over the
    same campaigns.
    """
    names = [*METHODS, "discrepancy", "discrepancy_exact"]
    cell = compose_cells(
        ["scenario=ble_room", "noise=ble_multipath", f"estimator=[{','.join(names)}]"]
    )[0]
    draws, rows = Draws(cell.scenario, cell.noise, cell.seed), []
    for name, estimator in cell.estimators.items():
        seconds = []
        for _ in range(4 if scale == "quick" else 12):
            draws.tile(0, 8)
            begin = time.perf_counter()
            truth, _ = estimate_tile(draws, estimator, 0)
            seconds.append((time.perf_counter() - begin) / (truth.shape[0] * truth.shape[1]))
        q = np.quantile(seconds[1:], [0.25, 0.5, 0.75])
        se = 1.2533 * (q[2] - q[0]) / 1.349 / np.sqrt(len(seconds) - 1)
        rows.append({"method": name, "us_per_fix": 1e6 * q[1], "us_se": 1e6 * se})
    return pd.DataFrame(rows)
