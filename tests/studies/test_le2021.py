"""The study's own statistics: ratios, classes, medians and bias against plain ways, and every
printed id.
"""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from aoabench.config.compose import compose_cells
from aoabench.maths.statistics import Estimate
from aoabench.roles import Estimator
from aoabench.store.fixes import Fixes
from aoabench.studies import study
from aoabench.types import Estimates, Outcome

LE = study.load("le2021")
N = LE.numbers
NAMES = ["ls", "ml_arctan", "ml_atan2", "ml_kcorr"]


def cells(*words):
    return compose_cells(
        [
            "scenario=bs_grid",
            "noise=ae_normal",
            f"estimator=[{','.join(NAMES)}]",
            "scenario.positions=60",
            *words,
        ]
    )


def made_up(rng, R=8, P=60, scale=1.0):
    """Fixes whose error belongs to the position; a tenth diverges, a tenth oscillates."""
    error = scale * rng.uniform(1, 2, size=P) * np.abs(rng.normal(size=(R, P)))
    outcome = rng.choice(
        [Outcome.OK, Outcome.DIVERGED, Outcome.OSCILLATED], p=[0.8, 0.1, 0.1], size=(R, P)
    ).astype(np.int8)
    iterations = np.where(outcome == Outcome.OSCILLATED, 1000.0, rng.integers(2, 9, size=(R, P)))
    e, nothing = error.astype(np.float32), np.full(error.shape, np.nan)
    return Fixes(e, 0.9 * e, iterations.astype(np.float32), nothing, nothing, outcome)


def test_accuracy_is_the_plain_root_mean_square_over_the_bound(rng):
    cell = cells("noise.sigma_deg=2")[0]
    fixes = {name: made_up(rng, scale=i + 1) for i, name in enumerate(NAMES)}
    rows = {row["estimator"]: row for row in N.accuracy(cell, fixes)}
    crb, _ = N.bound(cell)
    for name, f in fixes.items():
        plain = np.sqrt(np.mean(f.error_3d_m.astype(float) ** 2))
        assert rows[name]["rmse_m"] == pytest.approx(plain)
        assert rows[name]["ratio"] == pytest.approx(plain / np.sqrt(crb.mean()))
        assert rows[name]["sigma_deg"] == 2.0
        assert (rows[name]["positions"], rows[name]["draws"]) == (60, 8)
    assert (
        rows["ml_kcorr"]["rmse_of_proposed_is"]
        == rows["ml_kcorr"]["iterations_of_proposed_are"]
        == "tie"
    )
    assert rows["ls"]["rmse_of_proposed_is"] == "higher"  # its error is a quarter
    assert rows["ls"]["iterations"] != rows["ls"]["iterations"]
    assert rows["ml_arctan"]["iterations"] == pytest.approx(fixes["ml_arctan"].iterations.mean())


@pytest.mark.parametrize(
    ("above", "word"),
    [((1, 0.1), "lower"), ((-1, 0.1), "higher"), ((0.2, 0.1), "tie"), ((0, 0), "tie")],
)
def test_standing(above, word):
    assert N.standing(Estimate(*above)) == word


def test_standard_error_of_a_ratio_of_classes_is_the_bootstraps(rng):
    """Within 15 % of the deviation over 2000 resamplings of the positions (its own error: 2 %)."""
    f = made_up(rng, 20, 300)
    square = f.error_3d_m.astype(float) ** 2
    sums = [
        (np.where(m, square, 0).sum(0), m.sum(0))
        for m in (f.outcome == Outcome.DIVERGED, f.outcome == Outcome.OK)
    ]
    found = N.over_converged(*sums[0], *sums[1])
    pick = rng.integers(300, size=(2000, 300))
    each = [np.sqrt(s[pick].sum(1) / n[pick].sum(1)) for s, n in sums]
    assert found.se == pytest.approx((each[0] / each[1]).std(), rel=0.15)
    assert found.value == pytest.approx(
        np.sqrt(
            square[f.outcome == Outcome.DIVERGED].mean() / square[f.outcome == Outcome.OK].mean()
        )
    )


def test_jackknife_of_the_median_covers(rng):
    """400 studies of 200 positions: 95 % intervals cover the median in 91 to 98 % (a jackknife of
    few groups is rough).
    """
    hits = 0
    for _ in range(400):
        error = np.exp(0.5 * rng.normal(size=200))[None] * np.exp(0.2 * rng.normal(size=(5, 200)))
        found = N.median(error, np.ones(error.shape, dtype=bool))
        hits += abs(found.value - 1) < 2.09 * found.se  # Student, 19 degrees of freedom
    assert 0.91 <= hits / 400 <= 0.985


def test_classes_count_everything_once(rng):
    f = made_up(rng)
    rows = N.classes("ml_kcorr", 1.0, [f, f])
    assert sum(r["fixes"] for r in rows) == 2 * f.outcome.size
    assert sum(r["share"] for r in rows) == pytest.approx(1)
    assert next(r for r in rows if r["class"] == "oscillation")["iterations"] == 1000
    outcome = np.full(f.outcome.shape, Outcome.OK, dtype=np.int8)
    outcome[:, :3] = Outcome.DIVERGED  # three positions tell no standard error
    few = {r["class"]: r for r in N.classes("ml_kcorr", 1.0, [replace(f, outcome=outcome)])}
    assert few["divergence"]["rmse_m"] > 0
    assert np.isnan(few["divergence"]["rmse_se"])
    assert "rmse_m" not in few["oscillation"]


@dataclass(frozen=True)
class Constant(Estimator):
    tile = 1

    def __call__(self, batch, scenario, streams):
        R, T, _ = batch.azimuth.shape
        return Estimates(np.full((R, T, 3), 7.0), None, None, np.zeros((R, T), dtype=np.int8))


def test_bias_of_a_constant_is_everything_and_of_the_estimator_nearly_nothing():
    cell = cells("noise.sigma_deg=1")[0]
    both = SimpleNamespace(
        scenario=cell.scenario,
        noise=cell.noise,
        seed=cell.seed,
        estimators={"constant": Constant(), **cell.estimators},
    )
    assert N.bias(both, "constant", 4).value == pytest.approx(100)
    share = N.bias(both, "ml_kcorr", 40)
    assert abs(share.value) < 4 * share.se  # false alarm below 1e-3
    assert share.se < 3


def test_every_printed_id_and_effect_is_found_and_every_figure_draws(rng):
    """On made-up fixes of the cells of each experiment."""
    import matplotlib.pyplot as plt

    found, drawn = set(), {"fig5": N.fig5("quick")}
    for item in LE.items:
        if item.experiment:
            runs = []
            for whole in compose_cells([f"experiment={item.experiment}"]):
                cell = replace(whole, scenario=replace(whole.scenario, positions=60))
                runs.append((cell, {name: made_up(rng, 3) for name in cell.estimators}))
            drawn[item.name] = getattr(N, item.name)(runs)
        values = getattr(LE.figures, f"{item.name}_values", None)
        found |= set(values(drawn[item.name])) if values else set()
        figure = getattr(LE.figures, item.name)(drawn[item.name])
        assert all(axis.get_xlabel() or figure.get_supxlabel() for axis in figure.axes)
        plt.close(figure)
    assert {e["id"] for e in LE.printed} <= found
    assert {e["effect"]["id"] for e in LE.errata if "effect" in e} <= found
    assert isinstance(drawn["fig6"], pd.DataFrame)
