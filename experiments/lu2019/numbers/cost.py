"""Table II: multiplications of one step, printed, in dense matrices and ours, their growth, and
the time of a step.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from aoabench.engine.tiles import tile_of
from aoabench.engine.timing import time_estimators

from .common import METHODS, cell_of


def printed_count(method: str, M: int, n: int) -> int:
    """Multiplications of one step by the paper's formulas (V-B)."""
    if method == "wcg":
        return 11 * M
    a, b, c = (21, 144, 3) if method == "ekf_toa_aoa" else (14, 64, 2)
    return a * M * n**2 + b * M**2 * n + c * M * n


def textbook_count(m: int, n: int) -> int:
    """Multiplications of (17), (18) with dense matrices, m measurements and n states.

    F x; F P, (F P) F^T; H x is not needed; P H^T, H (P H^T); the inverse of S by Gauss and Jordan;
    K = (P H^T) S^-1; K v; K (H P).
    """
    return n**2 + 2 * n**3 + n**2 * m + n * m**2 + m**3 + n * m**2 + n * m + n**2 * m


def textbook_centroid_count(M: int) -> int:
    """Multiplications of (12), (14) as they are written: c tau cos(phi) cos(theta), c tau cos(phi)
    sin(theta) and c tau sin(phi) need 3, 3 and 2, and the product of a position and its weight 3.
    """
    return 11 * M


def our_count(method: str, M: int) -> int:
    """Multiplications and divisions of one step of our code with nine states, without trigonometric
    functions.

    For the filters, a test runs the kernel's source on numbers that count their multiplications:
    the prediction with the structure of (19), its Cholesky factor and a 3 x 3 update cost 966, each
    access node 148, with or without a measured time; the normalised innovation and the limit of
    the distance from an access node cost 10 more, and 10 for each node. For the centroid: range,
    direction, its rotation into the map's frame, weight, weighted sums.
    """
    return {"ekf_toa_aoa": 976 + 158 * M, "ekf_aoa": 976 + 158 * M, "wcg": 20 * M + 3}[method]


def table2(scale: str) -> pd.DataFrame:
    """Multiplications at M = 4, n = 9 and the measured time of one step, batched and for one trial
    alone.
    """
    M, n = 4, 9
    cell = cell_of("scenario.nearest=4", "noise.an_sigma_m=0.5")
    repeats = {"quick": 3, "paper": 15}[scale]
    reps = repeats * max(tile_of(e, cell.scenario) for e in cell.estimators.values())
    given = cell.scenario, cell.noise, cell.estimators, cell.seed
    timings = time_estimators(*given, reps + 1, repeats)
    rows = []
    for name in METHODS:
        m = {"ekf_toa_aoa": 3 * M, "ekf_aoa": 2 * M, "wcg": 0}[name]
        timing = timings[name]
        steps = timing.replications * timing.steps
        rows.append(
            {
                "estimator": name, "printed_formula": printed_count(name, M, n),
                "textbook": textbook_count(m, n) if m else np.nan, "ours": our_count(name, M),
                "microseconds_per_step": 1e6 * timing.seconds / steps,
            }
        )  # fmt: skip
    return pd.DataFrame(rows)


def operations(scale: str) -> pd.DataFrame:
    """Operations of one step over the number M of access nodes at n = 9 states and over n at M = 4,
    by form: the printed formula, the textbook's dense matrices, and ours, whose n is fixed.
    """
    few, many = 4, 9
    sizes = [(2**k, many) for k in range(11)] + [(few, many * 2**k) for k in range(1, 9)]
    rows = []
    for name in METHODS:
        for M, n in sizes:
            measured = {"ekf_toa_aoa": 3 * M, "ekf_aoa": 2 * M, "wcg": 0}[name]
            dense = textbook_count(measured, n) if measured else textbook_centroid_count(M)
            rows.append((name, "printed_formula", M, n, printed_count(name, M, n)))
            rows.append((name, "textbook", M, n, dense))
            if n == many:
                rows.append((name, "ours", M, n, our_count(name, M)))
    return pd.DataFrame(rows, columns=["estimator", "form", "M", "n", "operations"])
