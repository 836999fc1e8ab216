"""Speed of the snapshot estimators against NumPy and SciPy, and of the office room's estimators."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from aoabench.cell import Cell
from aoabench.engine.draws import Draws
from aoabench.maths.geometry import wrap
from aoabench.models.azel import AzEl
from aoabench.streams import Streams
from aoabench.types import Batch
from benchmarks.timing import Laps, Row, both_engines, cell_of, in_turn

CALLS = 100  # of a batch of one fix
FIXES = 20  # that SciPy solves in a call


def snapshot(repeats: int) -> Iterator[Row]:
    """Fixes per second of the snapshot estimators, with their start, against NumPy and SciPy; the
    time of one fix alone.
    """
    names = ["ls", "ml_arctan", "ml_atan2", "ml_kcorr"]
    words = ["scenario=bs_grid", "noise=ae_normal", "noise.sigma_deg=2"]
    cell = cell_of(*words, estimators=names)
    laps = both_engines(cell, names, tiles=8, numpy_tiles=8)
    _, batch = Draws(cell.scenario, cell.noise, cell.seed).tile(0, 1)
    streams = laps["ls"].streams[0]
    alone, scipys = _alone(cell, batch, streams), _scipys(cell, batch, streams)
    found = in_turn({**laps, "alone": alone, "scipy": scipys}, repeats)
    how = (
        f"median of {repeats}, in turn; 1000 positions, 12 base stations, 2 deg; "
        "one core, least-squares start included"
    )
    rate = {name: lap.steps / found[name] for name, lap in laps.items()}
    for name in names:
        target = "at least 300000" if name == "ml_kcorr" else ""
        yield Row("fixes per second", name, rate[name], "/s", target, how)
        yield Row("fixes per second in NumPy", name, rate[f"{name} numpy"], "/s", "", how)
    us, how = 1e6 * found["alone"] / CALLS, f"a batch of one; median of {CALLS} calls"
    yield Row("one fix", "ml_kcorr", us, "us", "at most 50", how)
    times = found["scipy"] / FIXES * rate["ml_kcorr"]
    how = "Levenberg-Marquardt (MINPACK) on our residual, fix by fix, from the same start"
    yield Row("against SciPy", "ml_kcorr", times, "x", "", how)


def _alone(cell: Cell, batch: Batch, streams: Streams) -> Callable[[], Any]:
    """The corrected maximum likelihood on the first fix alone, CALLS times."""
    fields = ("azimuth", "elevation", "azimuth_sigma", "elevation_sigma")
    one = replace(batch, **{f: getattr(batch, f)[:, :1] for f in fields})
    estimator = cell.estimators["ml_kcorr"]
    return lambda: [estimator(one, cell.scenario, streams) for _ in range(CALLS)]


def _scipys(cell: Cell, batch: Batch, streams: Streams) -> Callable[[], Any]:
    """SciPy's least squares on our residual, for the first FIXES fixes, from `ls`' positions."""
    from scipy.optimize import least_squares

    h, anchors = AzEl(1.0), cell.scenario.true_anchors
    y = np.stack([batch.azimuth[0], batch.elevation[0]], axis=-1)
    y = y.reshape(len(y), -1)
    begin = cell.estimators["ls"](batch, cell.scenario, streams).position[0]

    def solve(i: int) -> Any:
        return least_squares(
            lambda x: wrap(y[i] - h.predict(x[None], anchors)[0]), begin[i], method="lm", xtol=1e-5
        )

    return lambda: [solve(i) for i in range(FIXES)]


def room(repeats: int) -> Iterator[Row]:
    """Microseconds per fix of the office room's estimators, three anchors."""
    names = ["anchor_mean", "ls_lines", "ls_anchor_discarding", "vmf_ml"]
    names += ["discrepancy", "discrepancy_exact"]
    words = ["scenario=ble_room", "noise=ble_multipath", "scenario.packets=24"]
    cell = cell_of(*words, estimators=names)
    laps = {name: Laps(cell, name) for name in names}
    found = in_turn(laps, repeats)
    how = (
        f"median of {repeats}, in turn; 42 points x 24 packets, 3 anchors, "
        "the shipped noise; one core"
    )
    targets = {"discrepancy": "at most 0.8", "discrepancy_exact": "at most 18"}
    for name, lap in laps.items():
        us = 1e6 * found[name] / lap.steps
        yield Row("time per fix", name, us, "us", targets.get(name, ""), how)
