"""The study's own statistics: ratios, classes, medians and bias against plain ways, and every id
of its claims.
"""

import re
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import yaml

from aoabench.config import catalogue
from aoabench.config.compose import compose_cells
from aoabench.maths.estimate import Estimate
from aoabench.roles import Estimator
from aoabench.store.fixes import Fixes
from aoabench.studies import stored, study
from aoabench.types import Estimates, Outcome

LE = study.load("le2021")
RESULTS = Path(__file__).parents[2] / "results"
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
    none = np.full_like(fixes["ls"].iterations, np.nan)
    fixes["ls"] = replace(fixes["ls"], iterations=none)
    rows = {row["estimator"]: row for row in N.curves.accuracy(cell, fixes)}
    crb, _ = N.common.bound(cell)
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
    [
        ((1, 0.1), "lower"),
        ((-1, 0.1), "higher"),
        ((0.2, 0.1), "tie"),
        ((0, 0), "tie"),
        ((0.23, 0.1, 0.4, 1000), "lower"),  # 2.3 standard errors, skewed away from 0
        ((-0.23, 0.1, -0.4, 1000), "higher"),
        ((0.35, 0.1, -0.4, 1000), "tie"),  # 3.5, skewed towards 0
    ],
)
def test_standing(above, word):
    assert N.curves.standing(Estimate(*above)) == word


def test_standard_error_of_a_ratio_of_classes_is_the_bootstraps(rng):
    """Within 15 % of the deviation over 2000 resamplings of the positions (its own error: 2 %)."""
    f = made_up(rng, 20, 300)
    square = f.error_3d_m.astype(float) ** 2
    diverged, converged = f.outcome == Outcome.DIVERGED, f.outcome == Outcome.OK
    found = N.outcomes.class_ratio(square, diverged, square, converged)
    sums = [(np.where(m, square, 0).sum(0), m.sum(0)) for m in (diverged, converged)]
    pick = rng.integers(300, size=(2000, 300))
    each = [np.sqrt(s[pick].sum(1) / n[pick].sum(1)) for s, n in sums]
    assert found.se == pytest.approx((each[0] / each[1]).std(), rel=0.15)
    assert found.value == pytest.approx(np.sqrt(square[diverged].mean() / square[converged].mean()))


def test_jackknife_of_the_median_covers(rng):
    """400 studies of 200 positions: 95 % intervals cover the median in 91 to 98 % (a jackknife of
    few groups is rough).
    """
    hits = 0
    for _ in range(400):
        error = np.exp(0.5 * rng.normal(size=200))[None] * np.exp(0.2 * rng.normal(size=(5, 200)))
        found = N.common.median(error, np.ones(error.shape, dtype=bool))
        hits += abs(found.value - 1) < 2.09 * found.se  # Student, 19 degrees of freedom
    assert 0.91 <= hits / 400 <= 0.985


def test_classes_count_everything_once(rng):
    f = made_up(rng)
    rows = N.outcomes.classes("ml_kcorr", 1.0, [f, f])
    assert sum(r["fixes"] for r in rows) == 2 * f.outcome.size
    assert sum(r["share"] for r in rows) == pytest.approx(1)
    assert next(r for r in rows if r["class"] == "oscillation")["iterations"] == 1000
    outcome = np.full(f.outcome.shape, Outcome.OK, dtype=np.int8)
    outcome[:, :3] = Outcome.DIVERGED  # three positions tell no standard error
    few = {
        r["class"]: r for r in N.outcomes.classes("ml_kcorr", 1.0, [replace(f, outcome=outcome)])
    }
    assert few["divergence"]["rmse_m"] > 0
    assert np.isnan(few["divergence"]["rmse_se"])
    assert "rmse_m" not in few["oscillation"]


def test_few_large_errors_do_not_decide_what_is_judged(rng):
    """One error of 1e8 m decides the RMSE; capped, kept and median errors hardly notice."""
    cell = cells("noise.sigma_deg=2")[0]
    R, P = 40, 60
    limit = N.curves.GROSS * np.sqrt(N.common.bound(cell)[0])
    plain = made_up(rng, R, P)
    plain = replace(plain, error_3d_m=plain.error_3d_m.astype(float))
    plain.error_3d_m[:3, :2] = 0.01
    worse = plain.error_3d_m.copy()
    worse[0, 0] = 1e8
    worse[1:3, 1] = 2 * limit[1]
    fixes = {"other": replace(plain, error_3d_m=worse), "ml_kcorr": plain}
    other, mine = N.curves.tails(cell, fixes)
    assert other["gross_percent"] == pytest.approx(100 * 3 / (R * P))
    square, capped = plain.error_3d_m.astype(float) ** 2, worse.astype(float) ** 2
    capped[0, 0] = 1000**2
    expected = 100 * (np.sqrt(capped.mean() / square.mean()) - 1)
    assert other["capped_percent"] == pytest.approx(expected)
    good = worse <= limit
    expected = 100 * (np.sqrt(square[good].mean() / square.mean()) - 1)
    assert other["kept_percent"] == pytest.approx(expected)
    assert other["median_percent"] == pytest.approx(
        100 * (np.median(worse) / np.median(plain.error_3d_m) - 1)
    )
    assert {mine[f"{word}_percent"] for word in ("gross", "capped", "kept", "median")} == {0.0}


def test_fewer_converging_iterations_are_counted_in_pairs():
    outcome = np.zeros((4, 10), dtype=np.int8)
    worse = outcome.copy()
    worse[:, 0] = Outcome.DIVERGED
    worse[0, 1] = Outcome.OSCILLATED
    base = made_up(np.random.default_rng(1), 4, 10)
    mine, other = (replace(base, outcome=o) for o in (outcome, worse))
    row = N.curves.updates(other, mine)
    assert row["fewer_converged"] == pytest.approx(100 * 5 / 40)
    each = 100 * (worse != Outcome.OK).mean(axis=0)
    assert row["fewer_se"] == pytest.approx(each.std(ddof=1) / np.sqrt(10))
    assert N.curves.updates(mine, mine)["fewer_converged"] == 0


def test_capped_errors_of_converged_fixes_bound_the_ratio(rng):
    """An error above the cap can only lower the true ratio: the capped one is at least that."""
    f = made_up(rng, 20)
    error = f.error_3d_m.copy()
    error[0, f.outcome[0] == Outcome.OK] = 1e7
    rows = {r["class"]: r for r in N.outcomes.classes("x", 1.0, [replace(f, error_3d_m=error)])}
    row = rows["divergence"]
    converged = np.minimum(error[f.outcome == Outcome.OK].astype(float), 1000)
    square = error[f.outcome == Outcome.DIVERGED].astype(float) ** 2
    assert row["over_capped"] == pytest.approx(np.sqrt(square.mean() / (converged**2).mean()))
    assert row["over_converged"] < row["over_capped"]
    assert row["over_median"] == pytest.approx(np.sqrt(np.median(square)) / np.median(converged))
    assert row["most_iterations"] == f.iterations[f.outcome == Outcome.DIVERGED].max()


def test_the_pole_runs_every_estimator_that_fits():
    """So that a sentence on all estimators is one on all that ship."""
    cell = compose_cells(["experiment=le2021_pole"])[0]
    found = catalogue.fitting_estimators(cell.scenario, cell.noise)
    fitting = {name for names in found.values() for name in names}
    assert set(cell.estimators) == fitting


def test_beside_a_base_station_two_estimators_alone_stay_near_the_bound():
    """What the first finding says of all estimators."""
    item = next(i for i in LE.items if i.name == "pole")
    values = stored.read(LE, item, RESULTS).values
    near = {
        sigma: {
            key.split("/")[3]
            for key, (estimate, _) in values.items()
            if key.startswith(f"pole/{sigma}/0.1/") and key.endswith("/xy") and estimate.value < 3
        }
        for sigma in ("0.5", "4")
    }
    assert near == {"0.5": {"vmf_ml", "robust_ml"}, "4": {"vmf_ml", "robust_ml"}}


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
    assert N.curves.bias(both, "constant", 4).value == pytest.approx(100)
    share = N.curves.bias(both, "ml_kcorr", 40)
    assert abs(share.value) < 4 * share.se  # false alarm below 1e-3
    assert share.se < 3


@pytest.fixture(scope="module")
def tables():
    """The table of each item, from made-up fixes of the cells of its experiment."""
    rng, found = np.random.default_rng(5), {"fig5": N.fig5("quick")}
    for item in LE.items:
        if item.experiment:
            runs = []
            for whole in compose_cells([f"experiment={item.experiment}"]):
                cell = replace(whole, scenario=replace(whole.scenario, positions=60))
                runs.append((cell, {name: made_up(rng, 3) for name in cell.estimators}))
            found[item.name] = getattr(N, item.name)(runs)
    return found


def test_every_claim_and_effect_is_found_and_every_figure_draws(tables):
    import matplotlib.pyplot as plt

    found: set[str] = set()
    for item in LE.items:
        found |= set(getattr(LE.figures, f"{item.name}_values")(tables[item.name]))
        figure = getattr(LE.figures, item.name)(tables[item.name])
        assert all(axis.get_xlabel() or figure.get_supxlabel() for axis in figure.axes)
        plt.close(figure)
    for claim in LE.claims:
        for r in claim.readings:
            assert r.ids(found), claim.id
    assert {e["effect"]["id"] for e in LE.errata if "effect" in e} <= found
    text = (LE.folder / "study.yaml").read_text(encoding="utf-8")
    finding = " ".join(yaml.safe_load(text)["finding"])
    named = re.findall(r"\{([^:}]+)(?::[^}]*)?\}", finding)
    assert named
    assert {name.removesuffix(".low").removesuffix(".high") for name in named} <= found


def test_a_claim_on_all_deviations_has_all_eight(tables):
    values = LE.figures.fig6_values(tables["fig6"])
    numbers = {c.id: len(c.readings[0].ids(values)) for c in LE.claims if c.item == "fig6"}
    assert numbers["fig6/efficient"] == numbers["fig6/much_smaller"] == 8
    assert numbers["fig6/lowest"] == 16


def test_what_few_errors_decide_is_never_judged():
    """No judged claim rests on a mean without a variance."""
    for claim in LE.claims:
        for r in claim.readings if claim.judged else ():
            for pattern in r.of:
                heavy = "ml_arctan" in pattern or "ml_atan2" in pattern
                assert not (heavy and pattern.endswith(("/rmse", "/above"))), claim.id
                assert pattern.count("*") < 2 or not pattern.endswith(("/rmse", "/above")), claim.id


def test_figure_5_counts_stations_positions_and_elevation():
    frame = pd.DataFrame(
        [("base station", 0, 0, 10), ("position", 30, 40, 0), ("position", 100, 0, 10)],
        columns=["kind", "x_m", "y_m", "z_m"],
    )
    values = {key: e.value for key, e in LE.figures.fig5_values(frame).items()}
    assert (values["fig5/base_stations"], values["fig5/positions"]) == (1, 2)
    assert values["fig5/largest_elevation"] == pytest.approx(np.degrees(np.arctan(10 / 50)))


def test_medians_leave_out_groups_of_positions(rng):
    """Equal to numpy's median of what is left, with ties, and with positions without errors."""
    error = np.round(rng.gamma(1.0, 5.0, (7, 45)), 1)
    member, other = rng.random((2, *error.shape)) < 0.4
    member[:, :3] = False
    found = N.common.median(error, member)
    ratio = N.common.median_ratio(np.where(member, error, np.nan), np.where(other, error, np.nan))
    group = np.arange(45) % N.common.GROUPS
    left = [np.median(error[:, group != g][member[:, group != g]]) for g in range(N.common.GROUPS)]
    below = [np.median(error[:, group != g][other[:, group != g]]) for g in range(N.common.GROUPS)]
    factor = (N.common.GROUPS - 1) / N.common.GROUPS
    assert found.value == np.median(error[member])
    assert found.se == pytest.approx(np.sqrt(factor * np.sum((left - np.mean(left)) ** 2)))
    over = np.divide(left, below)
    assert ratio.value == np.median(error[member]) / np.median(error[other])
    assert ratio.se == pytest.approx(np.sqrt(factor * np.sum((over - over.mean()) ** 2)))
    assert np.isnan(N.common.median(error, member & False).value)
