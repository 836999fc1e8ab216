"""Running until a precision is reached: what is reached depends on the replications alone."""

import numpy as np
import pandas as pd
import pytest

import aoabench
from aoabench.cell import Until
from aoabench.config.compose import compose_cells
from aoabench.engine import runner
from aoabench.maths import statistics

WORDS = ["noise=vmf", "noise.sigma_deg=5,10", "filter=[ekf_vmf,ukf_vmf]", "until.metric=rmse_3d_m", "until.se=0.007",
         "until.min_reps=50", "until.max_reps=2000"]  # fmt: skip


def run(out, *words):
    return runner.run(compose_cells([*WORDS, *words, f"runner.out={out}"]), progress=False)


def se(rows):
    return statistics.mean(rows["rmse_3d_m"]).se


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    out = tmp_path_factory.mktemp("until")
    return run(out, "runner.n_jobs=1"), out


def test_counts_are_fixed():
    assert Until("nees", se=1, min_reps=50, max_reps=100).counts == [50, 63, 79, 99, 100]
    assert Until("nees", se=1, min_reps=50, max_reps=50).counts == [50]


def test_each_cell_stops_at_the_first_count_at_which_all_its_estimators_are_precise(reference):
    _, out = reference
    frame = aoabench.load(out)
    counts = Until("rmse_3d_m", se=0.007, min_reps=50, max_reps=2000).counts
    reached = {}
    for cell, rows in frame.groupby("cell"):
        n = rows.groupby("estimator").size()
        assert n.nunique() == 1
        reached[rows["noise.sigma_deg"].iloc[0]] = n.iloc[0]
        i = counts.index(n.iloc[0])
        estimators = [group.sort_values("replication") for _, group in rows.groupby("estimator")]
        assert all(se(group) <= 0.007 for group in estimators)
        for earlier in counts[:i]:
            assert any(se(group[group["replication"] < earlier]) > 0.007 for group in estimators), (
                cell,
                earlier,
            )
    assert reached[5] < reached[10] < 2000


def test_what_was_reached_is_told(reference):
    done, out = reference
    told = pd.read_parquet(out / "precision.parquet")
    assert len(told) == len(done.precision) == 4
    summary = pd.read_parquet(out / "summary.parquet").merge(told, on=["cell", "estimator"])
    assert np.allclose(summary["rmse_mean_3d_m_se"], summary["se"])
    assert (summary["replications_x"] == summary["replications_y"]).all()
    assert told["reached"].all()
    assert (told["se"] <= 0.007).all()


@pytest.mark.parametrize(
    "how", [["runner.n_jobs=2", "runner.chunk=7"], ["runner.n_jobs=2", "runner.backend=threading"]]
)
def test_the_outcome_does_not_depend_on_how_it_is_run_nor_on_what_was_there(
    how, reference, tmp_path
):
    """One cell is there with fewer, the other one with more replications than it needs."""
    for sigma, reps in ((5, 200), (10, 30)):
        words = [
            *WORDS[:1],
            f"noise.sigma_deg={sigma}",
            WORDS[2],
            f"reps={reps}",
            f"runner.out={tmp_path}",
        ]
        runner.run(compose_cells(words), progress=False)
    done = run(tmp_path, *how)
    assert done.reused > 0
    a, b = (aoabench.load(out).sort_values(["cell", "estimator", "replication"], ignore_index=True)
            for out in (tmp_path, reference[1]))  # fmt: skip
    pd.testing.assert_frame_equal(a, b, check_exact=True)


def test_again_computes_nothing_and_more_precision_only_what_is_missing(reference, tmp_path):
    first = run(tmp_path, "until.se=0.02")
    assert run(tmp_path, "until.se=0.02").computed == 0
    second = run(tmp_path)
    assert second.reused == first.computed + first.reused
    assert second.computed + second.reused == reference[0].computed


def test_max_reps_ends_it_and_is_told(tmp_path, capsys):
    from aoabench.cli.main import dispatch

    words = [
        "filter=[ekf_vmf]",
        "until.metric=rmse_3d_m",
        "until.relative_se=0.001",
        "until.min_reps=20",
        "until.max_reps=60",
    ]
    assert dispatch(["run", *words, f"runner.out={tmp_path}"]) == 0
    said = capsys.readouterr().out
    assert "at most 0.001 of the mean: reached by 0 of 1" in said
    assert "after 60 replications" in said
    told = pd.read_parquet(tmp_path / "precision.parquet")
    assert not told["reached"].any()
    assert (told["replications"] == 60).all()
    assert told["relative_se"][0] == pytest.approx(told["se"][0] / told["mean"][0])


@pytest.mark.parametrize(
    ("goals", "reaches"),
    [
        (["until.relative_se=0.02"], lambda m: m.se <= 0.02 * m.value),
        (["until.relative_se=0.02", "until.se=0.06"], lambda m: m.se <= 0.02 * m.value <= 0.06),
        (["until.relative_se=0.03", "until.se=0.04"], lambda m: m.se <= 0.04 < 0.03 * m.value),
    ],
)
def test_a_relative_error_is_reached_at_the_first_count_that_has_it(goals, reaches, tmp_path):
    """Of the two errors both have to be reached where both are asked for."""
    words = ["filter=[ekf_vmf]", "noise.sigma_deg=30", "until.metric=rmse_3d_m", "until.min_reps=8"]
    cells = compose_cells([*words, *goals, "runner.n_jobs=1", f"runner.out={tmp_path}"])
    done = runner.run(cells, progress=False)
    values = aoabench.load(tmp_path).sort_values("replication")["rmse_3d_m"]
    counts = cells[0].runner.until.counts
    reached = counts.index(len(values))
    assert 0 < reached < len(counts) - 1
    assert [reaches(statistics.mean(values[:n])) for n in counts[: reached + 1]] == (
        [False] * reached + [True]
    )
    assert done.precision[0]["reached"]


def test_an_estimator_without_the_metric_does_not_hold_the_cell_up(tmp_path):
    """Kalman filters count no iterations."""
    words = ["filter=[ekf_vmf]", "until.metric=iterations", "until.se=1", "until.min_reps=20"]
    done = runner.run(compose_cells([*words, f"runner.out={tmp_path}"]), progress=False)
    assert done.computed == 20
    assert not done.precision[0]["reached"]


def test_a_run_by_reps_tells_no_precision(tmp_path):
    run(tmp_path, "until.max_reps=50")
    assert len(pd.read_parquet(tmp_path / "precision.parquet")) == 4
    cells = compose_cells([*WORDS[:3], "reps=10", f"runner.out={tmp_path}"])
    assert not runner.run(cells, progress=False).precision
    assert pd.read_parquet(tmp_path / "precision.parquet").empty
