"""What `locate` says about the fixes of a recording, as lines for a terminal."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from aoabench.columns import WITHIN_M
from aoabench.deployment.fixes import MAX_SIGMA
from aoabench.deployment.solving import Residuals
from aoabench.types import SENTENCES, Reason

if TYPE_CHECKING:
    import pandas as pd

LARGE_DEG = 15.0  # of 90 % of the azimuth residuals; noise and reflections leave some 10 deg
ODD_DEG = 20.0  # median of an anchor with another facing, or without line of sight
_FEW = 4  # measurements of an anchor below which nothing is said about it
_WITHIN_95 = 5.991464547107979  # chi-square quantile, two degrees of freedom
_MOST_ANCHORS = 5


_HEAD = ("time_s", "fix", "tag", "x_m", "y_m", "z_m", "sigma_major_m", "anchors_used", "outcome")


def head(frame: pd.DataFrame, most: int) -> Iterator[str]:
    """The first rows of the table, without columns that are empty throughout."""
    shown = frame.loc[:, [name for name in _HEAD if frame[name].notna().any()]].head(most)
    shown = shown.astype({name: "Int64" for name in shown if name == "anchors_used"})
    text = shown.to_string(index=False, na_rep="", float_format=lambda value: f"{value:.3f}")
    yield from text.splitlines()
    if len(frame) > most:
        yield f"... {len(frame) - most} more"


def lines(frame: pd.DataFrame, name: str) -> Iterator[str]:
    """Fixes given and not given, anchors used, stated deviations, residuals."""
    F = len(frame)
    tags = frame["tag"].nunique()
    tracks = frame["track"].nunique()
    of = f" of {_many(tags, 'tag')}" if tags else ""
    of += f" in {tracks} tracks" if tracks > max(tags, 1) else ""
    given = frame["x_m"].notna()
    yield f"{name}: {_many(F, 'fix')}{of}, {given.sum()} with a position ({percent(given.mean())})"
    yield from _not_ok(frame)
    used = frame["anchors_used"].where(given).fillna(frame["anchors_heard"].where(given)).dropna()
    if len(used):
        yield f"anchors used: median {used.median():g}, {used.min():g} to {used.max():g}"
    major = frame["sigma_major_m"].where(given).replace([np.inf], np.nan).dropna()
    if len(major):
        half, most = major.quantile([0.5, 0.95])
        yield f"stated deviation: median {half:.3g} m, 95 % below {most:.3g} m (longer half-axis)"


def _not_ok(frame: pd.DataFrame) -> Iterator[str]:
    """A line for each outcome and reason of fixes that are not ok, the commonest first."""
    bad = frame[frame["outcome"] != "ok"]
    counts = Counter(zip(bad["outcome"], bad["reason"]))
    for (outcome, reason), n in counts.most_common():
        yield f"  {n} {outcome} ({percent(n / len(frame))}): {sentence(reason)}"


def sentence(reason: str) -> str:
    """A reason of the table of fixes in words."""
    if reason == MAX_SIGMA:
        return "the stated deviation exceeds --max-sigma"
    return SENTENCES[Reason[reason.upper()]]


def residual_lines(found: Residuals, ids: Sequence[str], sense: str) -> Iterator[str]:
    """The size of the residuals, and a line on what large ones may mean.

    ids: the anchors' names; sense: the declared sense of azimuths.
    """
    known = np.isfinite(found.azimuth)
    if not known.any():
        return
    azimuth, anchor = np.degrees(found.azimuth[known]), found.anchor[known]
    text = f"azimuth residuals: {_quantiles(azimuth)}"
    elevation = np.degrees(found.elevation[np.isfinite(found.elevation)])
    yield text + (f"; elevation: {_quantiles(elevation)}" if len(elevation) else "")
    large = list(_odd_anchors(azimuth, anchor))
    for b, middle, rest in large[:_MOST_ANCHORS]:
        yield (
            f"large residuals of anchor {ids[b]}: its azimuths differ by {middle:.0f} deg from the "
            f"fixes (median; other anchors {rest:.2g} deg): is its facing_deg right, and does it "
            "see the tag? estimator.robust_ml.loss=truncated locates without it"
        )
    many, most = len(azimuth) >= _FEW, np.quantile(np.abs(azimuth), 0.9)
    if many and most > LARGE_DEG and (not large or np.median(np.abs(azimuth)) > LARGE_DEG):
        other = "counterclockwise" if sense == "clockwise" else "clockwise"
        yield (
            f"large residuals: 10 % of the azimuths differ by more than {most:.0f} deg from the "
            "fixes, where some 10 deg are usual: is scenario.azimuth_sense right "
            f"(now {sense}, else {other}), are scenario.frame and azimuth_zero_deg, and are the "
            "anchors' positions and facing_deg?"
        )


def _odd_anchors(azimuth: np.ndarray, anchor: np.ndarray) -> Iterator[tuple[int, float, float]]:
    """Anchors whose azimuths are far from the fixes while those of the others are near: number,
    median residual in deg and the median size of the others' residuals.
    """
    for b in np.unique(anchor):
        own, others = azimuth[anchor == b], np.abs(azimuth[anchor != b])
        if len(own) < _FEW or len(others) < _FEW:
            continue
        size, rest = float(np.median(np.abs(own))), float(np.median(others))
        if size > ODD_DEG and rest < size / 3:
            yield int(b), _middle(own), rest


def _middle(angles: np.ndarray) -> float:
    """The median of angles (N,) deg about their mean direction."""
    mean = np.degrees(np.angle(np.exp(1j * np.radians(angles)).sum()))
    found = mean + np.median((angles - mean + 180) % 360 - 180)
    return float((found + 180) % 360 - 180)


def accuracy(frame: pd.DataFrame, by_mark: bool = False) -> dict[str, float]:
    """Errors in the plane of the fixes with a known truth: their number `fixes`; shares of all of
    them `coverage` (with a position) and `p_within_<d>m`; of those with a position `cep50_m`,
    `cep90_m`, `cep95_m`, `rmse_xy_m`, `rmse_3d_m`, and `inside_95`, the share whose truth lies in
    the stated ellipse of 95 % (NaN without deviations).

    Each fix counts alike or, `by_mark`, each true position.
    """
    known = frame[frame["true_x_m"].notna() & frame["true_y_m"].notna()]
    weight = np.ones(len(known))
    if by_mark:
        weight = 1.0 / known.groupby("mark")["mark"].transform("size").to_numpy()
    error = known["error_xy_m"].to_numpy()
    given = np.isfinite(error)
    found: dict[str, Any] = {"fixes": len(known), "coverage": _mean(given, weight)}
    for limit in WITHIN_M:
        found[f"p_within_{limit}m"] = _mean(error <= limit, weight)
    for q in (50, 90, 95):
        found[f"cep{q}_m"] = _quantile(error[given], q / 100, weight[given] if by_mark else None)
    for axis in ("xy", "3d"):
        square = known[f"error_{axis}_m"].to_numpy() ** 2
        some = np.isfinite(square)
        found[f"rmse_{axis}_m"] = np.sqrt(_mean(square[some], weight[some]))
    inside = _distances(known)
    some = np.isfinite(inside)
    return found | {"inside_95": _mean(inside[some] <= _WITHIN_95, weight[some])}


def _mean(values: np.ndarray, weight: np.ndarray) -> float:
    return float(np.average(values, weights=weight)) if len(values) else np.nan


def _quantile(values: np.ndarray, probability: float, weight: np.ndarray | None) -> float:
    if not len(values):
        return np.nan
    if weight is None:
        return float(np.quantile(values, probability))
    return float(np.quantile(values, probability, weights=weight, method="inverted_cdf"))


def _distances(known: pd.DataFrame) -> np.ndarray:
    """The squared distances (N,) of truths from the fixes, in standard deviations in the plane; NaN
    without deviations.
    """
    x, y = known["x_m"] - known["true_x_m"], known["y_m"] - known["true_y_m"]
    xx, xy, yy = (known[f"cov_{pair}_m2"] for pair in ("xx", "xy", "yy"))
    with np.errstate(all="ignore"):
        square = (yy * x**2 - 2 * xy * x * y + xx * y**2) / (xx * yy - xy**2)
    return np.asarray(square, dtype=float)


def accuracy_lines(found: dict[str, float], by_mark: bool = False) -> Iterator[str]:
    """The errors of `accuracy`."""
    shares = ", ".join(f"P(<= {d:g} m) {percent(found[f'p_within_{d}m'])}" for d in WITHIN_M)
    coverage = percent(found["coverage"])
    each = ", each true position alike" if by_mark else ""
    of = f"{found['fixes']} fixes with truth{each}"
    yield f"errors in the plane, {of}: {shares}, coverage {coverage}"
    if found["coverage"] > 0:
        inside = found["inside_95"]
        more = f"; truth in the 95 % ellipse: {percent(inside)}" if inside == inside else ""
        yield (
            f"  CEP50 {found['cep50_m']:.3g} m, CEP90 {found['cep90_m']:.3g} m, CEP95 "
            f"{found['cep95_m']:.3g} m, RMSE {found['rmse_xy_m']:.3g} m (3-D "
            f"{found['rmse_3d_m']:.3g} m){more}"
        )


def _quantiles(angles: np.ndarray) -> str:
    half, most = np.quantile(np.abs(angles), [0.5, 0.9])
    return f"median {half:.3g} deg, 90 % below {most:.3g} deg"


def _many(n: int, word: str) -> str:
    return f"{n} {word}{'' if n == 1 else 'es' if word.endswith('x') else 's'}"


def percent(share: float) -> str:
    return f"{100 * share:.3g} %"
