"""Leaderboards against the stored replications: RMSE, reference, bound, coverage, figure."""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest

from aoabench.config import catalogue
from aoabench.config.compose import compose_cells
from aoabench.engine import runner
from aoabench.engine.draws import Draws
from aoabench.maths.estimate import Estimate
from aoabench.report.text import interval_text
from aoabench.store import recorded, tables
from aoabench.store.fixes import fixes, steps
from aoabench.studies import study
from aoabench.types import Outcome

SMALL = {
    "ble_room": ["reps=3", "scenario.packets=2"],
    "square_track": ["reps=3", "scenario.steps=4", "noise=vmf", "filter=[ekf_vmf,ekf_aoa]", "estimator=[ls,ml_atan2]"],
}  # fmt: skip


@pytest.fixture(scope="module", params=list(SMALL))
def board(request, tmp_path_factory):
    """Name of an item, its cell, its replications and its table on a small run."""
    name, out = request.param, tmp_path_factory.mktemp("out") / "run"
    words = [f"experiment=leaderboard_{name}", *SMALL[name], "runner.n_jobs=1"]
    (cell,) = compose_cells([*words, f"runner.out={out}"])
    runner.run([cell], progress=False)
    read = {"ble_room": fixes, "square_track": steps}[name]
    found = {estimator: read(out, cell.id, estimator) for estimator in cell.estimators}
    frame = getattr(study.load("leaderboard").numbers, name)([(cell, found)])
    return name, cell, found, tables.load(out), frame.set_index("estimator")


def test_rmse_and_ok_are_those_of_the_stored_replications(board):
    name, _, _, rows, frame = board
    column = {"ble_room": "rmse_xy_m", "square_track": "rmse_3d_m"}[name]
    for estimator, part in rows.groupby("estimator"):
        mine = frame.loc[estimator]
        assert mine["rmse_m"] == pytest.approx(part[column].mean(), rel=1e-5), estimator
        assert mine["share_ok"] == part["n_ok"].sum() / part["n_fixes"].sum()
        assert mine["error_q50_m"] <= mine["error_q95_m"]


def test_the_reference_does_not_see_the_truth_and_has_rank_1(board):
    name, _, _, _, frame = board
    methods = frame[frame["kind"] != "limit"]
    assert frame["rmse_m"].is_monotonic_increasing
    assert set(frame["best"]) == {methods.index[0]}
    assert list(methods["rank"]) == list(range(1, len(methods) + 1))
    assert methods.iloc[0]["above_percent"] == 0
    limits = list(frame.index[frame["kind"] == "limit"])
    assert limits == {"ble_room": ["best_anchor"], "square_track": []}[name]
    assert (frame.loc[limits, "rank"] == 0).all()
    assert "discrepancy" in frame.index or name != "ble_room"
    filters = {"ble_room": set(), "square_track": {"ekf_vmf", "ekf_aoa"}}[name]
    assert set(frame.index[frame["kind"] == "filter"]) == filters


def test_the_bound_is_that_of_independent_fixes_alone(board):
    _, cell, _, _, frame = board
    assert frame["bound_m"].isna().all(), "no bound for a track or for multipath"
    numbers = study.load("leaderboard").numbers
    (grid,) = compose_cells(["experiment=leaderboard_bs_grid", "noise.sigma_deg=2"])
    (half,) = compose_cells(["experiment=leaderboard_bs_grid", "noise.sigma_deg=1"])
    assert numbers.bound_m(grid) == pytest.approx(2 * numbers.bound_m(half), rel=1e-12)
    truth = Draws(grid.scenario, grid.noise, grid.seed).tile(0, 1)[0][0]
    covariance = np.linalg.inv(grid.noise.information(truth, grid.scenario.true_anchors))
    mean_square = covariance[:, [0, 1, 2], [0, 1, 2]].sum(axis=1).mean()
    assert numbers.bound_m(grid) == pytest.approx(np.sqrt(mean_square), rel=1e-9)


def test_the_figure_draws_each_bar_or_cuts_and_labels_it(board):
    _, _, _, _, frame = board
    rows = frame.reset_index()
    rows.loc[rows.index[-1], "rmse_m"] = 1e6
    figure = study.load("leaderboard").figures.board(rows)
    axis = figure.axes[0]
    widths = [patch.get_width() for patch in axis.patches][::-1]  # the best on top
    end = axis.get_xlim()[1]
    assert widths == pytest.approx(np.minimum(rows["rmse_m"], end))
    texts = [text.get_text() for text in axis.texts]
    assert texts.count("1000000 m \u2192") == 1
    assert sum(text.endswith(" %") for text in texts) == len(rows)
    plt.close(figure)


def test_rmse_that_few_errors_decide_is_marked_beside_its_interval(board):
    name, _, found, _, frame = board
    for estimator, fixes_of in found.items():
        error = fixes_of.error_xy_m if name == "ble_room" else fixes_of.error_3d_m
        given = ~np.isin(fixes_of.outcome, [Outcome.FAILED, Outcome.REJECTED])
        squares = [np.mean(e[g].astype(float) ** 2) for e, g in zip(error, given) if g.any()]
        share = max(squares) / sum(squares)
        assert frame.loc[estimator, "largest_share"] == pytest.approx(share, rel=1e-6)
        n = len(squares)
        exceeds = n > 1 and n * (1 - share) ** (n - 1) < 0.05
        assert frame.loc[estimator, "heavy_tail"] == exceeds
    figures = study.load("leaderboard").figures
    rows = frame.reset_index().assign(heavy_tail=False)
    rows.loc[1, "heavy_tail"] = True
    texts = figures.board_table(rows)["RMSE [m], 95 % interval"]
    assert [t.endswith("heavy tail") for t in texts] == list(rows["heavy_tail"])
    low, high = Estimate(*rows.loc[1, ["rmse_m", "rmse_se", "rmse_skew", "rmse_units"]]).interval()
    assert texts[1] == f"{interval_text(rows.loc[1, 'rmse_m'], low, high)}, heavy tail"
    figure = figures.board(rows)
    hatched = [bool(patch.get_hatch()) for patch in figure.axes[0].patches][::-1]
    assert hatched == list(rows["heavy_tail"])
    assert figures.HEAVY in [t.get_text() for t in figure.legends[0].get_texts()]
    plt.close(figure)
    older = figures.board(rows.drop(columns=["heavy_tail", "largest_share"]))
    assert figures.HEAVY not in [t.get_text() for t in older.legends[0].get_texts()]
    plt.close(older)


def test_the_first_replications_are_taken_alone(board):
    name, cell, found, _, _ = board
    read = {"ble_room": recorded.fixes, "square_track": recorded.steps}[name]
    estimator, one = next(iter(found.items()))
    two = read(Path(cell.runner.out), cell.id, estimator, 2)
    assert len(two.error_3d_m) == len(two.outcome) == 2
    assert np.array_equal(two.error_3d_m, one.error_3d_m[:2], equal_nan=True)


@pytest.mark.parametrize(
    ("item", "setting"),
    [
        ("square_track", "noise=vmf"),
        ("bs_grid", "noise.sigma_deg=1"),
        ("indoor_map", "noise.an_sigma_m=0"),
        ("ble_room", "seed=1"),
    ],
)
def test_every_estimator_that_fits_takes_part_or_is_named_as_left_out(item, setting):
    """So that "best" says of which; smoothers, which are not causal, never take part."""
    text = (study.load("leaderboard").folder / "README.md").read_text(encoding="utf-8")
    part = text[text.index("**Who takes part:**") : text.index("**RMSE**")]
    (cell,) = compose_cells([f"experiment=leaderboard_{item}", setting])
    fits = catalogue.fitting_estimators(cell.scenario, cell.noise)
    causal = catalogue.causal_estimators()
    assert set(cell.estimators) <= causal
    fitting = causal & {name for names in fits.values() for name in names}
    left_out = fitting - set(cell.estimators)
    assert {name for name in left_out if f"`{name}`" not in part} == set()
    assert bool(left_out) == (item in ("indoor_map", "ble_room"))
