"""aoabench: the Monte Carlo simulation-and-benchmark framework for angle-of-arrival (AoA)
positioning.

`run` simulates, `load` reads the tables of a run, `compare` compares its estimators, `plot` draws
them, `export` gives their table for a paper, `locate` gives the positions of the tags in a
recording. Everything else is imported from its module.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from aoabench import loaded  # noqa: F401 - first: it records the modules below
from aoabench.errors import BadValue, RunError, UserError, shorten
from aoabench.params import param
from aoabench.roles import Estimator, Filter, Measurement, Motion, Noise, Scenario
from aoabench.types import Anchors, Batch, Estimates, Measurements, Outcome

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from aoabench.filters.gaussian import Gaussian
    from aoabench.filters.recursion import KalmanFilter

__version__ = "0.2.0"
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
    "export",
    "load",
    "locate",
    "param",
    "plot",
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
    """Run one cell, or a sweep if an override holds commas, and return its tidy frame.

    Overrides are those of the command line: groups (`scenario`, `noise`, `filter`, `estimator`,
    `experiment`, `runner`; `aoabench list` shows their presets, `aoabench list NAME` the parameters
    of one), parameters of what they choose, and `reps`, `seed`:

        aoabench.run("scenario=square_track", "noise=vmf", "noise.sigma_deg=2,5",
                     "filter=[ekf_vmf,ukf_vmf]", "filter.ekf_vmf.extent_factor=20", "reps=200")

    estimators: objects of your own by name, `Estimator`s or other callables (batch, scenario,
    streams) -> Estimates; they get the same draws as the presets. out: the folder of the tables
    (runner.out); results that are stored there are reused, unless `fresh` computes them again and
    replaces them. config_dir: a folder with presets of your own; plugins: packages that its presets
    may name. progress: print what the run does, and a bar, on standard error.

    The frame has a row per cell, estimator and replication, the columns of replications.parquet and
    one per swept parameter; see `load` for its `attrs`. `attrs["notes"]` has remarks about the
    input, such as the presets that `filter=all` leaves out. Raises UserError for a mistake in the
    input, and RunError for an error that stops the run later.
    """
    from aoabench.config.compose import compose_cells
    from aoabench.config.fit import left_out_text
    from aoabench.engine import faults, runner

    _check_words(overrides)
    if estimators is not None and not isinstance(estimators, Mapping):
        raise BadValue("estimators", estimators, 'a dict such as {"mine": MyEstimator()}')
    cells = compose_cells(
        overrides,
        config_dir=config_dir,
        plugins=plugins,
        extra=estimators,
        out=None if out is None else _path("out", out),
        say=faults.report if progress else None,
    )
    frame = load(runner.run(cells, progress, fresh).out)
    mine = {(cell.id, name) for cell in cells for name in cell.estimators}
    kept = [pair in mine for pair in zip(frame["cell"], frame["estimator"])]
    frame = frame[kept].reset_index(drop=True)
    frame.attrs["cells"] = frame["cell"].unique().tolist()
    notes = dict.fromkeys(line for cell in cells for line in cell.notes)
    frame.attrs["notes"] = [*notes, *left_out_text(cells)]
    return frame


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

    The arguments are those of `aoabench locate`. log, anchors: the files; settings: overrides of
    the reader such as "scenario.window_s=0.1"; format: the log's, None: recognised; estimator or
    filter: the method, None for both: robust_ml; truth: a file of true positions; max_sigma_m:
    reject fixes whose ellipse has a larger half-axis in m. See `deployment.fixes.COLUMNS` for the
    columns. Raises UserError for a mistake in the input.
    """
    from aoabench.deployment import located
    from aoabench.deployment.request import Request
    from aoabench.engine.faults import explained

    _check_words(settings)
    path = _path("log", log, _FILE)
    given = {"anchors": anchors, "truth": truth}
    files = [None if file is None else _path(key, file, _FILE) for key, file in given.items()]
    with explained():
        request = Request(path, files[0], format, estimator, filter, files[1], settings)
        return located.locate(request.asked(), max_sigma_m).frame


def load(out: str | os.PathLike[str]) -> pd.DataFrame:
    """Return the table of the run in folder `out`: one row per cell x estimator x replication, and
    one column per swept parameter.

    Its `attrs` hold the `folder`, the ids of the `cells` and the `units` of the columns that have
    one. Raises UserError for a folder without a run, and RunError if its tables are torn.
    """
    from aoabench.columns import unit_of
    from aoabench.engine.faults import explained
    from aoabench.store import tables

    with explained(Path(_path("out", out))):
        frame = tables.load(_literal(out))
    units = {name: unit for name in frame if (unit := unit_of(str(name)))}
    cells = frame["cell"].unique().tolist()
    frame.attrs = {"folder": os.fspath(out), "cells": cells, "units": units}
    return frame


def compare(
    run: str | os.PathLike[str], baseline: str | None = None, metric: str = "rmse_3d_m"
) -> pd.DataFrame:
    """Paired comparison of the estimators of the run in folder `run`, a row per cell and estimator.

    Each row holds the change of the mean of `metric`, a column of numbers of replications.parquet
    or failure_rate, against `baseline` (None: the estimator with the smallest mean in each cell)
    with its interval, the p-value by Holm's method over the table, and a summary line. See
    `store.compare.compare` for the columns. Raises UserError for a run, metric or baseline that
    does not exist.
    """
    from aoabench.engine.faults import explained
    from aoabench.store import compare as compare_module

    with explained(Path(_path("run", run))):
        return compare_module.compare(_literal(run), baseline, metric)


def plot(
    source: str | os.PathLike[str] | pd.DataFrame,
    kind: str | None = None,
    metric: str | None = None,
    by: str | None = None,
    over: str | Sequence[str] = (),
    where: str | Sequence[str] = (),
    baseline: str | None = None,
) -> Figure:
    """Return a figure of the run in the folder `source`, or of a frame of `load` or `run`.

    `kind`: cdf, box, violin, curve, heatmap, time or pairs; None: a curve if one parameter with
    numbers was swept, a heat map if several were, else a cdf. `metric`: a column of the
    replications (rmse_3d_m ...), of the summary (cep50_m ...), or the error of each fix
    (error_3d_m, error_xy_m, error_z_m). `by`: the column with a colour for each value (default
    estimator). `over`: the swept parameters of the axes of a curve (one) or heat map (two); others
    have a panel for each value. `where`: conditions "KEY=VALUE[,VALUE]". `baseline`: the estimator
    with which pairs are compared (default: the one with the smallest mean).

    From a frame alone all intervals are over replications, and the errors of fixes and the steps
    are unknown. The figure is not pyplot's: save it with `figure.savefig`, or let a notebook show
    it. Raises UserError for a wish that does not fit the run, and RunError for torn tables.
    """
    import pandas as pd

    from aoabench.engine.faults import explained
    from aoabench.report.runs import drawing

    if isinstance(source, pd.DataFrame):
        return drawing.plot(source, kind, metric, by, over, where, baseline)
    with explained(Path(_path("source", source, f"{_FOLDER}, or a frame of `load` or `run`"))):
        return drawing.plot(_literal(source), kind, metric, by, over, where, baseline)


def export(
    run: str | os.PathLike[str],
    form: str = "latex",
    metrics: str | Sequence[str] = (),
    by: str | None = None,
    digits: int = 2,
) -> Any:
    """Return the summary of the run in the folder `run`, a row for each cell and estimator, as
    `aoabench export` writes it. form: latex, markdown or csv, which are texts, json, a dict, or
    xarray, an xarray.Dataset.

    metrics: names of columns of summary.parquet or timing.parquet, or `all`. by: a key with several
    values, each of which gets a column per metric in latex and markdown. digits: significant digits
    of an interval's half-width, to which these two round. Raises UserError for a mistake in the
    input, and where xarray is not installed.
    """
    from aoabench.engine.faults import explained
    from aoabench.errors import check_choice
    from aoabench.report import export as export_module

    check_choice("form", form, list(export_module.FORMATS))
    names = [metrics] if isinstance(metrics, str) else metrics
    with explained(Path(_path("run", run))):
        return export_module.export(Path(_literal(run)), form, names, by, digits)


def __dir__() -> list[str]:
    """The public names, without the modules that they come from."""
    return sorted([*__all__, "__version__"])


_FOLDER = "the folder of a run, such as frame.attrs['folder'] of a frame of `run`"
_FILE = "the path of a file; a table in memory is written first, with its `to_csv`"


def _path(key: str, value: object, allowed: str = _FOLDER) -> str:
    """The argument `key` as a path; UserError if it is none."""
    if not isinstance(value, str | os.PathLike):
        raise UserError(f"{key}: a {type(value).__name__} is not allowed; allowed: {allowed}")
    return os.fspath(value)


def _check_words(words: Sequence[object]) -> None:
    """UserError for overrides that are not text, such as a list of them or a dict."""
    for word in words:
        if not isinstance(word, str):
            raise UserError(
                f"{shorten(repr(word))}: a {type(word).__name__} is not allowed as an override; "
                'allowed: texts, each an argument of its own: "noise=vmf", "reps=9"'
            )


def _literal(path: str | os.PathLike[str]) -> str:
    """The path with a leading ~ as part of the name, which Arrow would take for a home folder."""
    text = os.fspath(path)
    return os.path.abspath(text) if text.startswith("~") else text
