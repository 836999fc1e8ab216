"""aoabench: the Monte Carlo simulation-and-benchmark framework for angle-of-arrival (AoA)
positioning.

`run` simulates, `load` reads the tables of a run, `compare` compares its estimators, `locate` gives
the positions of the tags in a recording. Everything else is imported from its module.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from aoabench import loaded  # noqa: F401 - first: it records the modules below
from aoabench.errors import RunError, UserError
from aoabench.params import param
from aoabench.roles import Estimator, Filter, Measurement, Motion, Noise, Scenario
from aoabench.types import Anchors, Batch, Estimates, Measurements, Outcome

if TYPE_CHECKING:
    import pandas as pd

    from aoabench.filters.gaussian import Gaussian
    from aoabench.filters.recursion import KalmanFilter

__version__ = "0.1.0"
__all__ = [
    "Anchors",
    "Batch",
    "Estimates",
    "Estimator",
    "Filter",
    "Gaussian",
    "KalmanFilter",
    "Measurement",
    "Measurements",
    "Motion",
    "Noise",
    "Outcome",
    "RunError",
    "Scenario",
    "UserError",
    "compare",
    "load",
    "locate",
    "param",
    "run",
]


def __getattr__(name: str) -> Any:
    """The base class of Kalman filters and its distributions, whose modules load SciPy."""
    if name not in ("Gaussian", "KalmanFilter"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from aoabench.filters import gaussian, recursion

    return {"Gaussian": gaussian.Gaussian, "KalmanFilter": recursion.KalmanFilter}[name]


def run(
    *overrides: str,
    estimators: Mapping[str, Estimator] | None = None,
    out: str | os.PathLike[str] | None = None,
    config_dir: str | None = None,
    plugins: Sequence[str] = (),
    progress: bool = False,
    fresh: bool = False,
) -> pd.DataFrame:
    """Run one cell, or a sweep if an override holds commas, and return its tidy frame (see `load`).

    Overrides are those of the command line: `run("noise=vmf", "filter=[ekf_vmf]",
    "noise.sigma_deg=2,5", "reps=200")`. `estimators` adds objects of your own by name: callables
    (batch, scenario, streams) -> Estimates, which get the same draws as the presets. `out` is the
    folder of the tables (runner.out); results that are stored there are reused, unless `fresh`
    computes them again and replaces them. Raises UserError for a mistake in the input, and RunError
    for an error that stops the run later.
    """
    from aoabench.config.compose import compose_cells
    from aoabench.engine import faults, runner

    cells = compose_cells(
        overrides,
        config_dir=config_dir,
        plugins=plugins,
        extra=estimators,
        out=None if out is None else os.fspath(out),
        say=faults.report if progress else None,
    )
    frame = load(runner.run(cells, progress, fresh).out)
    mine = {(cell.id, name) for cell in cells for name in cell.estimators}
    return frame[[pair in mine for pair in zip(frame["cell"], frame["estimator"])]].reset_index(
        drop=True
    )


def locate(
    log: str | os.PathLike[str],
    anchors: str | os.PathLike[str],
    *settings: str,
    format: str | None = None,
    estimator: str | None = None,
    filter: str | None = None,
    truth: str | os.PathLike[str] | None = None,
    max_sigma_m: float | None = None,
) -> pd.DataFrame:
    """Return the fixes of all tags in a device's log, a row for each fix of each tag.

    The arguments are those of `aoabench locate`: `locate("capture.log", "anchors.csv",
    "scenario.window_s=0.1", filter="ekf_vmf")`; see `deployment.fixes.COLUMNS` for the columns.
    Raises UserError for a mistake in the input.
    """
    from aoabench.deployment import located
    from aoabench.deployment.request import Request
    from aoabench.engine.faults import explained

    files = (os.fspath(log), os.fspath(anchors), None if truth is None else os.fspath(truth))
    with explained():
        request = Request(files[0], files[1], format, estimator, filter, files[2], settings)
        return located.locate(request.asked(), max_sigma_m).frame


def load(out: str | os.PathLike[str]) -> pd.DataFrame:
    """Return the table of the run in folder `out`: one row per cell x estimator x replication, and
    one column per swept parameter.
    """
    from aoabench.engine.faults import explained
    from aoabench.store import tables

    with explained(Path(out)):
        return tables.load(_literal(out))


def compare(
    run: str | os.PathLike[str], baseline: str | None = None, metric: str = "rmse_3d_m"
) -> pd.DataFrame:
    """Paired comparison of the estimators of the run in folder `run`, a row per cell and estimator.

    Each row holds the change against `baseline` (None: the estimator with the smallest mean in each
    cell) with its interval, the p-value by Holm's method over the table, and a summary line. See
    `store.compare.compare` for the columns.
    """
    from aoabench.engine.faults import explained
    from aoabench.store import compare as compare_module

    with explained(Path(run)):
        return compare_module.compare(_literal(run), baseline, metric)


def _literal(path: str | os.PathLike[str]) -> str:
    """The path with a leading ~ as part of the name, which Arrow would take for a home folder."""
    text = os.fspath(path)
    return os.path.abspath(text) if text.startswith("~") else text
