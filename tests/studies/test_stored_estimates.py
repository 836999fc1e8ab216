"""The studies' tables store the skewness and the units of estimates, and their numbers have them
again.
"""

import importlib
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from aoabench.maths import statistics
from aoabench.maths.estimate import Estimate
from aoabench.report import plots
from aoabench.studies import study

from .lu2019 import errata_runs, made_up, readings_of
from .test_claims import RESULTS

BOQUET, LE, LU, NURMINEN = (
    study.load(name) for name in ("boquet2024", "le2021", "lu2019", "nurminen2018")
)
SKEW, UNITS = 0.3, 9.0
TABLES = [
    pytest.param(s, i, id=f"{s.name}-{i.name}") for s in (BOQUET, LE, LU, NURMINEN) for i in s.items
]
SYMMETRIC = {
    "speed/",  # from quartiles of times
    "fig4/independent/crossing/",  # half of a bootstrap interval
    "fig4/common/crossing/",
}


@pytest.mark.parametrize(("s", "item"), TABLES)
def test_every_number_has_the_skewness_and_units_of_its_table(s, item):
    """The committed tables with a skewness and units beside each standard error."""
    frame = pd.read_parquet(study.table_path(RESULTS, s, item))
    errors = [c for c in frame if c == "se" or c.endswith("_se")]
    for column in errors:
        known, stem = frame[column] > 0, column.removesuffix("_se")
        frame[f"{stem}_skew"] = np.where(known, SKEW, np.nan)
        frame[f"{stem}_units"] = np.where(known, UNITS, np.nan)
    values = getattr(s.figures, f"{item.name}_values")(frame) if errors else {}
    for key, value in values.items():
        e = value[0] if isinstance(value, tuple) else value
        if e.se > 0 and not key.startswith(tuple(SYMMETRIC)):
            assert e.skew != 0, key
            assert np.isfinite(e.units), key


def laps(estimators, **columns):
    """Made-up RMSEs of 12 laps of each filter, skewed."""
    rng = np.random.default_rng(4)
    base = {"scenario": "square_track_far", "noise": "vmf", "filter.pf_vmf.particles": 10}
    return pd.DataFrame(
        base | columns | {"estimator": name, "replication": r, "rmse_3d_m": x}
        for name in estimators
        for r, x in enumerate(rng.lognormal(0, 0.8, 12))
    )


def of(runs, **where):
    """RMSEs (N,) of the rows with some values."""
    return runs[(runs[list(where)] == pd.Series(where)).all(axis=1)]["rmse_3d_m"].to_numpy()


def nurminen(item):
    """A table of made-up laps, and some of its numbers before they are stored."""
    if item == "table1":
        return _likelihoods()
    key = {"frames": "scenario.anchors.frame_rpy_deg", "particles": "filter.pf_vmf.particles"}
    levels = {"frames": ("[0, 0, 0]", "[9, 0, 0]"), "particles": (10, 100)}
    if item in key:
        parts = [laps(["pf_vmf"], **{key[item]: level}) for level in levels[item]]
        parts[1]["rmse_3d_m"] *= np.linspace(0.5, 3, 12) ** 2
        runs = pd.concat(parts, ignore_index=True)
        low, high = (of(runs, **{key[item]: level}) for level in levels[item])
        if item == "frames":
            change = statistics.paired(high, low).percent
            wanted = {"frames/pf_vmf/9,0,0/change": change}
            wanted["frames/pf_vmf/9,0,0/size"] = change * np.sign(change.value)
        else:
            wanted = {"particles/vmf/10/pf_vmf": statistics.paired(low, high).percent}
        return getattr(NURMINEN.numbers, item)(runs), wanted
    runs = laps(NURMINEN.figures.ORDER)
    a, b = of(runs, estimator="ekf_ae_adaptive"), of(runs, estimator="ekf_ae_fitted")
    paired = statistics.paired(a, b).percent
    at = f"{item}/far/vmf/ekf"
    if item == "adaptivity":
        return NURMINEN.numbers.adaptivity(runs), {f"{at}_ae_adaptive/above_ae_fitted": paired}
    vmf, pf = (of(runs, estimator=f"{family}_vmf") for family in ("ekf", "pf"))
    wanted = {
        f"{at}_ae_adaptive/above_ae_fitted": paired,
        f"{at}_ae_adaptive/above_own_vmf": statistics.paired(a, vmf).percent,
        f"{at}_vmf/mean": statistics.paired(vmf, pf).percent,
        f"{at}_vmf/median": statistics.quantile(100 * (vmf / pf - 1), 0.5),
    }
    return NURMINEN.numbers.layouts(runs), wanted


def _likelihoods():
    models = importlib.import_module(f"{NURMINEN.numbers.__name__}.models")
    logliks = -np.random.default_rng(1).lognormal(0, 0.8, (4, 50))
    residuals = np.random.default_rng(2).lognormal(-3, 0.8, (2, 50))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(models, "samples", lambda *_: (logliks, residuals))
        table = NURMINEN.numbers.table1("quick")
    share = np.exp(logliks.mean(axis=1))
    share /= share.sum()
    sigma = statistics.mean(residuals[0] ** 2).root() * np.rad2deg(1.0)
    of_vmf = statistics.from_influence(share[3], share[3] * (logliks[3] - share @ logliks))
    below = statistics.mean(logliks[3] - logliks[0])
    return table, {
        "table1/model1/ae_fitted/sigma_azimuth_deg": sigma,
        "table1/model1/vmf/share": of_vmf,
        "table1/model1/ae_nominal/below_vmf": below,
    }


def lu(item):
    """A table of made-up trials, and some of its numbers before they are stored."""
    rng = np.random.default_rng(9)
    if item == "errata":
        runs = errata_runs(rng)
        first = runs[runs["cell"] == "5.0[][]"]
        median = statistics.quantile(of(first, estimator="ekf_aoa"), 0.5)
        return LU.numbers.errata(runs), {"errata/meant/5/ekf_aoa/median": median}
    if item == "readings":
        with pytest.MonkeyPatch.context() as patch:
            table = readings_of(rng, patch)
        share = statistics.rate(8, 8).percent()
        return table, {"readings/chosen/common/5/ekf_aoa/worse_3d": share}
    if item == "fig3":
        return _pilots(rng)
    runs = made_up([0.5, 5.0], rng, trials=12, shape=2)
    at = {"noise.an_error": "common", "noise.an_sigma_m": 5.0}
    a, b = (of(runs, estimator=name, **at) for name in ("ekf_aoa", "wcg"))
    return LU.numbers.fig4(runs), {
        "fig4/common/5/ekf_aoa/rmse_3d": statistics.pooled_rmse(a),
        "fig4/common/5/ekf_aoa/mean_3d/above_wcg": statistics.paired(a, b).percent,
    }


def _pilots(rng):
    setting = importlib.import_module(f"{LU.numbers.__name__}.setting")
    names = ("toa_m", "azimuth_deg", "elevation_deg", "thermal_cm", "across_m")
    trials = [{n: rng.lognormal(0, s, 20) for n in names} for s in (0.2, 0.4, 0.5, 2.0)]
    cell = SimpleNamespace(scenario=0, noise=SimpleNamespace(clock_ns=10.0), seed=0)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(setting, "cell_of", lambda *_: cell)
        patch.setattr(setting, "Draws", lambda *_: None)
        patch.setattr(setting, "tile_errors", lambda *_: trials)
        table = LU.numbers.fig3("quick")
    number = setting.NUMBERS["thermal_median_cm"][1]
    return table, {"fig3/thermal_median_cm": statistics.mean([number(e) for e in trials])}


def boquet(item):
    """A table of made-up errors, and some of its numbers before they are stored."""
    if item == "fig3a":
        table = BOQUET.numbers.fig3a("quick")
        geometry = importlib.import_module(f"{BOQUET.numbers.__name__}.geometry")
        places = geometry.standard_room().position[0, 0, :2]
        turns = geometry.Turns.of(geometry.normal_errors(10_000, 2))
        xy = geometry.single_positions(np.array([8.5, 3.0, 0.0]), places, turns, clip=False)[:, 1]
        q95 = statistics.quantile(np.hypot(*(xy.T - [8.5, 3.0]).T), 0.95)
        return table, {"fig3a/unclipped/B": q95}
    if item == "fig3b":
        return _room()
    fit = importlib.import_module(f"{BOQUET.numbers.__name__}.fit")
    days = {key: np.random.default_rng(5).lognormal(0, 0.8, (9, 2)) for key in fit.DAYS}
    ours = statistics.mean(days["azimuth_sd"][:, 1])
    row = fit._misfit("w", "days/azimuth_sd/2", 8.0, ours, 1.5)
    angles = np.random.default_rng(6).lognormal(0, 0.8, (7, 2, 5, 3))
    rms = statistics.jackknife(angles[:, 0], lambda e: float(np.sqrt((e[..., 0] ** 2).mean())))
    grid, medians = np.array([1.0, 2.0]), np.random.default_rng(7).lognormal(0, 0.8, (9, 2))
    rows = [row, *fit._anchor_rows(angles), *fit._grid_rows("vmf_ml", grid, medians)]
    mean = statistics.mean(medians.mean(axis=1))
    wanted = {"days/azimuth_sd/2": ours, "angles/azimuth/1/rms": rms, "grid/vmf_ml": mean}
    return pd.DataFrame(rows), {f"misfit/{key}": e for key, e in wanted.items()}


def _room():
    geometry = importlib.import_module(f"{BOQUET.numbers.__name__}.geometry")
    xy = np.random.default_rng(8).lognormal(0, 0.8, (2, 3, 40))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(geometry, "normal_errors", lambda *_: np.zeros((2, 40, 3)))
        patch.setattr(geometry, "single_positions", lambda *_, clip: xy)
        table = BOQUET.numbers.fig3b("quick")
    both = (xy[:, :2].mean(axis=1), xy[:, 2])
    pair, single = (statistics.pooled_rmse(np.hypot(*(e - 0.5))) for e in both)
    return table, {"fig3b/0.5,0.5": pair - single}


@pytest.mark.parametrize(("s", "item", "make"), [
    *((NURMINEN, i, nurminen) for i in ("table1", "layouts", "frames", "particles", "adaptivity")),
    *((LU, i, lu) for i in ("fig3", "fig4", "errata", "readings")),
    *((BOQUET, i, boquet) for i in ("fig3a", "fig3b", "misfit")),
])  # fmt: skip
def test_the_interval_of_a_stored_number_is_that_of_the_estimate(s, item, make, tmp_path):
    table, wanted = make(item)
    table.to_parquet(tmp_path / "table.parquet")
    found = getattr(s.figures, f"{item}_values")(pd.read_parquet(tmp_path / "table.parquet"))
    for key, e in wanted.items():
        got = found[key][0] if isinstance(found[key], tuple) else found[key]
        assert e.skew != 0, key
        assert got.interval(0.997) == pytest.approx(e.interval(0.997), rel=1e-9), key
        assert got.units == e.units, key


@pytest.mark.parametrize("figure", ["misfit", "intervals", "band", "diverged"])
def test_error_bars_end_where_the_intervals_do(figure, monkeypatch):
    e = Estimate(0.3, 0.02, 0.5, 12)
    ends, drawn = np.subtract(e.interval(plots.BARS), e.value), []
    axis = SimpleNamespace(
        errorbar=lambda *_, **given: drawn.append(given.get("xerr", given.get("yerr"))),
        fill_between=lambda _, low, high, **__: drawn.append([0.3 - low, high - 0.3]),
        **dict.fromkeys(("plot", "set", "set_yticks", "axvline", "axvspan"), lambda *_, **__: None),
    )
    frame = pd.DataFrame([{"x": 1.0, "error_m": 1.0, "an_sigma_m": 1.0, "what": "w"}])
    if figure == "misfit":
        ends = 2 * ends  # the tolerance is a half
        fit = importlib.import_module(f"{BOQUET.figures.__name__}.fit")
        monkeypatch.setattr(fit, "new", lambda *_: (None, axis))
        row = e.columns("ours", "se") | {"printed": 0.2, "misfit": 0.2}
        fit.misfit(frame.assign(**row))
    elif figure == "intervals":
        common = importlib.import_module(f"{BOQUET.figures.__name__}.common")
        ends = 100 * np.subtract(e.interval(common.CONFIDENCE), e.value)
        common.intervals(axis, frame.assign(**e.columns("y")), "y", np.zeros(1), scale=100)
    elif figure == "band":
        campaign = importlib.import_module(f"{BOQUET.figures.__name__}.campaign")
        campaign._band(axis, frame.assign(**e.columns("cdf")), color="black")
    else:
        drawing = importlib.import_module(f"{LU.figures.__name__}.drawing")
        ends = 100 * ends
        drawing._diverged(axis, frame.assign(**e.columns("diverged")), "wcg")
    assert np.ravel(drawn[0]) == pytest.approx([-ends[0], ends[1]])
